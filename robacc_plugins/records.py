"""Reader of the records of JSON, JSON Lines and YAML documents, and of arrays that NumPy or MATLAB saved by name.

A folder may hold one record in each file, such as ``pose_00/data.json``, or a 4 x 4 matrix, such as ``pose_000.txt``,
and joints in a file of their own, such as ``000_joints.txt``.
"""

from __future__ import annotations

import ast
import contextlib
import csv
import hashlib
import io
import itertools
import json
import re
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from robacc.errors import InputError, Problem, refuse
from robacc.io.column_table import ColumnTable
from robacc.io.dialect import number_of
from robacc.io.files import bytes_of, decode
from robacc.io.table import Table, TableOptions, TextTable

_SOCKET = re.compile(r"(?i)(hole|socket|cone|nest)s?[_ -]?\w*$")
"""Names of lists of the joints at which the tip was in one socket."""
_YAML = (".yaml", ".yml")
_MATLAB = b"MATLAB"
"""First bytes of a file of MATLAB's variables."""
_CELL = re.compile(r'(?m)(^|[,;\t])"\[[\s\[]*[-+.\d]')
"""Beginning of a cell of a CSV that is a list."""
_PART = re.compile(r"(?:[Rt]|rot|trans)_(?=[A-Za-z]{3})")
"""Beginning of the names of the two parts of a pose, as OpenCV has them: ``R_gripper2base`` and ``t_gripper2base``."""
_VECTOR = re.compile(r"(?i)(.*?)(?:rvec|rot(?:ation)?_?vec(?:tor)?)")
"""Name of a list of three numbers that are a rotation vector."""
_POSE = re.compile(r"(?i)(.*_)?(pose|coords?|coordinates)")
"""Name of a list of the position and three angles of a pose."""
_JOINTS = re.compile(r"(?i)(^|[\W_\d])(joints?|q|angles?|jpos)([\W_\d]|$)")
"""Name of a file of the joints of one pose."""
_OPENCV = re.compile(r"\A%YAML:1\.0.*\n|!!opencv-(?:nd-)?matrix")
"""What only the YAML of OpenCV has."""
_SIZE = 16
"""Numbers of a matrix."""
_FILES = 10_000
_LARGEST = 1 << 20
"""Largest file of one record, bytes."""
_FEWEST = 6
"""Numbers of a pose."""
_FEWEST_RECORDS = 2
_SHORTEST = 3
"""Numbers of a position."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is such a document, by its name or its first bytes, or a folder has a record a file.

    A CSV whose cells are lists, as pandas writes them, is a document of records too: ``"[0.1, 0.2, 0.3]"``.
    """
    if not first:
        return Path(path).is_dir() and bool(_records_of(path))
    text, name = first.removeprefix(b"\xef\xbb\xbf").lstrip(), path.lower()
    is_document = re.match(rb"(?s)\{|\[\s*[\[{]|(---\s+)?header:|.*[\n,;\t]\"\[[\s\[]*[-+.\d]", text)
    return bool(is_document) or name.endswith(_YAML) or _are_arrays(name, first)


def _are_arrays(file: str, first: bytes) -> bool:
    is_zipped = file.lower().endswith(".npz") and first.startswith(b"PK")
    return first.startswith((b"\x93NUMPY", _MATLAB)) or is_zipped


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the records of the files of a folder as a table; the files give the poses their names."""
    records = _records_of(path)
    names = [name for name, _, _ in records]
    digest = hashlib.sha256(b"".join(content for _, _, content in records)).hexdigest()
    remark = f"each file is a pose: {len(names)} files, {names[0]} to {names[-1]}"
    columns = _columns([row for _, row, _ in records])
    return ColumnTable([("pose", np.array(names)), *columns], path, options.skip_gaps, digest, remark)


def holds_poses(path: str) -> bool:
    """Return whether the files of a folder give a position each, beside what else they say."""
    names = (name.lower() for _, row, _ in _records_of(path)[:1] for name in row)
    return any(re.match(r"(.*_)?(tx|x|px)$|(.*_)?(pose|position|translation)_|.*_0_3$", name) for name in names)


def _records_of(path: str) -> list[tuple[str, dict[str, Any], bytes]]:
    """Return the name, values and content of the files of a folder, and of those below it, with the same names.

    They are empty unless these are most of its files.
    """
    files = itertools.islice(
        (f for f in Path(path).rglob("*") if f.suffix in (".json", ".yaml", ".yml", ".txt", ".csv")), _FILES
    )
    found = []
    for file in sorted(files, key=_counted):
        content = file.read_bytes() if file.is_file() and file.stat().st_size <= _LARGEST else b""
        if row := _record(content, str(file)):
            place = file.relative_to(path).with_suffix("")
            found.append((place, row, content))
    found = _joined(found)
    forms = Counter(tuple(row) for _, row, _ in found)
    form, count = max(forms.items(), key=lambda item: item[1], default=((), 0))
    if count < 2 or 2 * count < len(found):
        return []
    places = [place for place, row, _ in found if tuple(row) == form]
    is_same = len({place.name for place in places}) == 1 and len(places[0].parts) > 1
    rows = ((row, content) for _, row, content in found if tuple(row) == form)
    return [(str(place.parent if is_same else place), *row) for place, row in zip(places, rows, strict=True)]


def _joined(found: list[tuple[Path, dict[str, Any], bytes]]) -> list[tuple[Path, dict[str, Any], bytes]]:
    """Return the records of a folder; those of ``3_robotpose.txt`` and ``3_markerpose.txt`` are one."""
    parts = [re.fullmatch(r"(\d+)(?:[_-]?(\D+))?|(\D+?)[_-]?(\d+)", place.name) for place, _, _ in found]
    numbers = [part and (part[1] or part[4]) for part in parts]
    words = [part and re.sub(r"[_-]?pose$", "", part[2] or part[3] or "") for part in parts]
    if None in parts or len({*words}) != 2 or {*Counter(numbers).values()} != {2}:
        return found
    by_number: dict[str | None, tuple[Path, dict[str, Any], bytes]] = {}
    for number, word, (place, row, content) in zip(numbers, words, found, strict=True):
        _, values, before = by_number.get(number, (place, {}, b""))
        is_named = not word or _JOINTS.search(word)
        values |= {name if is_named else f"{word}_{name}": value for name, value in row.items()}
        by_number[number] = place.with_name(str(number)), values, before + content
    return list(by_number.values())


def _counted(file: Path) -> list[int | str]:
    """Return a name whose numbers count: 10 is behind 9."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", str(file))]


def _record(content: bytes, file: str) -> dict[str, Any] | None:
    """Return the values of a file of one record by their names; None for another file, such as one of several."""
    try:
        if file.endswith((".txt", ".csv")):
            rows = [re.sub(r"[\[\],;]", " ", line).split() for line in content.decode().splitlines() if line.strip()]
            values: Any = {"pose": [[float(cell) for cell in row] for row in rows]}
            is_matrix = [len(row) for row in rows] == [4] * 4 and values["pose"][3] == [0, 0, 0, 1]
            numbers = list(itertools.chain(*values["pose"]))
            if _JOINTS.search(Path(file).stem) and {1} & {len(rows), *map(len, rows)} and len(numbers) < _SIZE:
                record = {f"joint_{i}": number for i, number in enumerate(numbers, 1)}
            else:
                record = dict(_leaves(values, ())) if is_matrix else {}
        else:
            document = _document(content, file)
            parts = document.values() if isinstance(document, dict) else [[{}]]
            are_several = any(isinstance(part, list) and any(isinstance(each, dict) for each in part) for part in parts)
            record = {} if are_several else dict(_leaves(document, ()))
    except (ValueError, InputError, RecursionError):
        return None
    numbers = [value for value in record.values() if isinstance(value, int | float)]
    return record if len(numbers) >= _FEWEST else None


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    """Return the records of a document, which are its longest list, as a table.

    A record gives one row. Its columns are named by its keys, then the place in a list, then a unit at a key's end.

    Raises:
        InputError: The text is no such document, or has no records.
    """
    data = bytes_of(stream, file)
    fix = "give a list of records, such as {joints: [...], position: [x, y, z]}, or export the poses as CSV"
    if _are_arrays(file, data[:6]):
        fix = "save arrays by name with a row for each pose, as numpy.savez(file, joints=…, position=…) does"
    document = _document(data, file)
    values: list[Any] = list(document.values()) if isinstance(document, dict) else []
    columns = {key: items for key, items in document.items() if isinstance(items, list)} if values else {}
    if values and all(isinstance(items, list) for items in values) and all(map(_SOCKET.match, map(str, document))):
        document = [{"socket": name, "joints": joints} for name, rows in document.items() for joints in rows]
    elif len(columns) > 1 and len(set(map(len, columns.values()))) == 1:
        document = [dict(zip(columns, items, strict=True)) for items in zip(*columns.values(), strict=True)]
    for keys, items in itertools.permutations((each for each in values if isinstance(each, list) and each), 2):
        # A list of names and one of rows, as MoveIt's joint states.
        if all(isinstance(n, str) for n in keys) and all(isinstance(r, list) and len(r) == len(keys) for r in items):
            values = [[dict(zip(keys, row, strict=True)) for row in items]]
    lists = [items for items in ([document] if isinstance(document, list) else values) if isinstance(items, list)]
    longest = max(lists, key=len, default=[])
    if longest is document and all(isinstance(row, list) and _are_numbers(row) for row in longest):
        # Without names, as in a text: the motion of the arm shows which columns are which.
        text = "".join(" ".join(map(repr, row)) + "\n" for row in longest)
        return TextTable(io.BytesIO(text.encode()), file, options)
    if longest is document and all(np.shape(_plain(row)) == (4, 4) for row in longest if isinstance(row, list)):
        longest = [{"pose": row} if isinstance(row, list) else row for row in longest]
    rows = _with_axes([dict(_leaves(record, ())) for record in longest if isinstance(record, dict)])
    no_list = Problem("has no list of records, expected a table of poses", file, fix=fix)
    refuse((not rows or len(rows) < len(longest), no_list))
    return ColumnTable(_columns(rows), file, options.skip_gaps, hashlib.sha256(data).hexdigest())


def _with_axes(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return records in which the six numbers of a pose, as controllers give it, have the names of axes and angles.

    They have these beside another position alone, such as that of a marker: nothing else tells whose pose it is.
    """
    names = dict.fromkeys(name for row in rows for name in row)
    stems = [name[:-2] for name in names if name.endswith("_6") and f"{name[:-1]}7" not in names]
    stems = [stem for stem in stems if _POSE.fullmatch(stem) and {f"{stem}_{i}" for i in range(1, 7)} <= names.keys()]
    if len(stems) != 1 or not any(re.search(r"(^|_)t?x(_u?mm?)?$", name) for name in names):
        return rows
    new = {f"{stems[0]}_{i}": f"{stems[0]}_{axis}" for i, axis in enumerate(("x", "y", "z", "rx", "ry", "rz"), 1)}
    return [{new.get(name, name): value for name, value in row.items()} for row in rows]


def _are_numbers(row: list[Any]) -> bool:
    """Return whether a row holds a position, a pose or joints as numbers."""
    return len(row) >= _SHORTEST and all(isinstance(value, int | float) for value in row)


def _columns(rows: list[dict[str, Any]]) -> list[tuple[str, Any]]:
    """Return the columns of records."""
    names = dict.fromkeys(name for row in rows for name in row)
    return [(name, np.array([row.get(name) for row in rows], dtype=object)) for name in names]


def _document(data: bytes, file: str) -> Any:
    """Return the content of a document.

    Raises:
        InputError: The text is no such document.
    """
    import yaml

    document: Any
    is_of_arrays = _are_arrays(file, data[:6])
    text = "" if is_of_arrays else _OPENCV.sub("", decode(data, file))
    try:
        if is_of_arrays:
            return _arrays(data)
        if text.lstrip()[:1] not in ("{", "[", "-", "") and _CELL.search(text) and not file.lower().endswith(_YAML):
            return _of_cells(text)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        if len(lines) > 1 and all(line[0] + line[-1] == "{}" for line in lines):
            document = [json.loads(line) for line in lines]
        elif text.lstrip()[:1] in ("{", "[") and not file.lower().endswith(_YAML):
            document = _of_json(text)
        elif any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.CSafeLoader)):
            raise ValueError("it has aliases")  # they could stand for more records than the memory holds
        else:
            # Messages of ros2 topic echo are a document each.
            documents = [item for item in yaml.load_all(text, Loader=yaml.CSafeLoader) if item is not None]
            document = documents[0] if len(documents) == 1 else documents
    except (ValueError, RecursionError, yaml.YAMLError, zipfile.BadZipFile, EOFError, OSError) as error:
        kind, why = "arrays" if is_of_arrays else "JSON or YAML", " ".join(str(error).split())[:200]
        raise InputError(Problem(f"cannot be read as {kind} ({why})", file, fix="export it again")) from None
    return _by_number(document)


def _by_number(document: Any) -> Any:
    """Return the records of a document whose keys have their number, ``{pose_0: {…}, pose_1: …}``; others as it is."""
    keys = [re.fullmatch(r"(.*?)[_ ]?(\d+)", str(key)) for key in document] if isinstance(document, dict) else []
    records: dict[str, dict[str, Any]] = {}
    for match, value in zip(keys, document.values() if keys else (), strict=True):
        if match is None or not isinstance(value, dict):
            return document
        records.setdefault(match[2], {})[match[1]] = value
    rows = [*records.values()]
    if len(rows) < _FEWEST_RECORDS or any(row.keys() != rows[0].keys() for row in rows):
        return document
    return [next(iter(row.values())) if len(row) == 1 and not _is_matrix(*row.values()) else row for row in rows]


def _of_hand(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record in which the base seen from the hand, ``R_base2gripper`` of OpenCV, is the hand in the base."""
    hand = next((match[1] for key in record if (match := re.fullmatch(r"R_base2(\w+)", str(key)))), "")
    given = (f"R_base2{hand}", f"t_base2{hand}")
    if not hand or not record.keys() >= {*given, "R_target2cam"}:
        return record
    values = [record[key]["data"] if _is_matrix(record[key]) else record[key] for key in given]
    if [np.size(value) for value in values] != [9, 3]:
        return record
    back = np.reshape(values[0], (3, 3)).astype(float).T
    place = -back @ np.ravel(values[1]).astype(float)
    others = {key: value for key, value in record.items() if key not in given}
    return {f"R_{hand}2base": back.tolist(), f"t_{hand}2base": place.tolist(), **others}


def _is_matrix(value: Any) -> bool:
    """Return whether a value is a matrix as OpenCV stores it."""
    return isinstance(value, dict) and value.keys() >= {"rows", "cols", "data"}


def _of_json(text: str) -> Any:
    """Return the document of a text, or the list of those that stand one behind the other.

    A table by its columns, as pandas writes it, has the same rows in each: ``{"q1": {"0": 0.5, "1": 0.7}, …}``. A table
    by its rows has the same columns in each: ``{"0": {"q1": 0.5, …}, …}``.

    Raises:
        ValueError: The text is no such document.
    """
    decoder, documents = json.JSONDecoder(), []
    text = text.lstrip("\ufeff").strip()
    # A printed array of NumPy has blanks between its numbers, and no digit behind the point of 0.
    text = text if "," in text else _with_commas(re.sub(r"(?<=\d\.)(?!\d)", "0", text))
    while text:
        document, end = decoder.raw_decode(text)
        documents.append(document)
        text = text[end:].lstrip(", \t\r\n")
    document = documents[0] if len(documents) == 1 else documents
    parts = list(document.values()) if isinstance(document, dict) else []
    are_alike = len(parts) > 1 and all(isinstance(part, dict) and part.keys() == parts[0].keys() for part in parts)
    if are_alike and all(key.isdecimal() for key in parts[0]):
        return [dict(zip(document, row, strict=True)) for row in zip(*(part.values() for part in parts), strict=True)]
    return document


def _of_cells(text: str) -> list[dict[str, Any]]:
    """Return the rows of a CSV whose cells may be lists or matrices, as pandas and NumPy write them.

    Raises:
        ValueError: The text is no such table.
    """
    head = text.lstrip("\ufeff\n").partition("\n")[0]
    separator = max(",;\t", key=head.count)
    rows = csv.DictReader(io.StringIO(text.lstrip("\ufeff\n")), delimiter=separator, strict=True)
    try:
        return [{(name or "").strip(): _cell(cell or "") for name, cell in row.items() if name} for row in rows]
    except csv.Error as error:
        raise ValueError(str(error)) from None


def _with_commas(text: str) -> str:
    """Return lists with commas; NumPy separates numbers by blanks, and rows by the ends of lines."""
    return re.sub(r"(?<=[\d.\]])\s+(?=[-+.\d\[])", ",", text)


def _cell(text: str) -> Any:
    """Return the list, the number or the text in a cell."""
    text = text.strip()
    if text[:1] == "[":
        with contextlib.suppress(ValueError, SyntaxError, MemoryError, RecursionError):
            return ast.literal_eval(_with_commas(text))
    number = number_of(text, decimal_comma=False)
    return text if number is None else number


def _variables(data: bytes) -> Any:
    """Return the arrays of a file of MATLAB by their names, of an array of structures a record for each.

    Arrays may stand in a structure. Of arrays that have a column for each pose, the rows are those of the others.

    Raises:
        ValueError: The file has another format, such as that of version 7.3.
    """
    from scipy.io import loadmat

    try:
        variables = loadmat(io.BytesIO(data), simplify_cells=True)  # type: ignore[arg-type]
    except NotImplementedError:
        raise ValueError("it is of version 7.3; save it with -v7") from None
    except Exception as error:  # SciPy has no kind of its own for damage.
        raise ValueError(f"it is damaged: {error}") from None
    found = {name: value for name, value in variables.items() if not name.startswith("__")}
    while len(found) == 1 and isinstance(value := next(iter(found.values())), dict):
        found = value
    kinds = {name: getattr(getattr(value, "dtype", None), "kind", "") for name, value in found.items()}
    records = [value for name, value in found.items() if isinstance(value, list) or kinds[name] == "O"]
    if records:
        return [_plain(record) for record in max(records, key=len)]
    arrays = {name: np.squeeze(value) for name, value in found.items() if isinstance(value, np.ndarray)}
    sizes = Counter(size for array in arrays.values() for size in {*array.shape[:1], *array.shape[-1:]})
    length = max(sizes, key=lambda size: (sizes[size], size), default=0)
    rows = {name: array if array.shape[0] == length else array.T for name, array in arrays.items() if array.ndim}
    return {name: array.tolist() for name, array in rows.items() if array.shape[0] == length}


def _plain(value: Any) -> Any:
    """Return a record with lists in place of arrays."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def _arrays(data: bytes) -> Any:
    """Return the rows of each array of a ``.npz`` file, or of each field of a ``.npy`` file, by its name.

    A ``.npy`` file without fields gives its rows, or its matrices.

    Raises:
        ValueError: An array has Python objects.
    """
    if data.startswith(_MATLAB):
        return _variables(data)
    loaded = np.load(io.BytesIO(data), allow_pickle=False)
    if isinstance(loaded, np.ndarray) and loaded.dtype.names is None and loaded.ndim > 1:
        return loaded.tolist()
    names = loaded.dtype.names or () if isinstance(loaded, np.ndarray) else loaded.files
    arrays = {name: np.asarray(loaded[name]) for name in names}
    return {name: array.tolist() for name, array in arrays.items() if array.ndim}


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each number and text in a record."""
    if _is_matrix(value) and np.size(value["data"]) == value["rows"] * value["cols"]:
        value = np.reshape(value["data"], (value["rows"], value["cols"])).tolist()
    if isinstance(value, dict):
        value = _of_hand(value)
        listed = value.get("name")
        for key, item in value.items():
            if isinstance(listed, list) and isinstance(item, list) and item is not listed and len(item) == len(listed):
                # Lists beside one of names, as in joint states of ROS, have a value for each name.
                yield from ((f"{name}/{key}", entry) for name, entry in zip(listed, item, strict=True))
            else:
                yield from _leaves(item, (*path, str(key)))
    elif isinstance(value, list):
        if value and all(isinstance(item, list) and len(item) == 1 for item in value):  # a column, as of OpenCV
            value = [item[0] for item in value]
        if len(value) == 16 and not isinstance(value[0], list):  # a matrix, by rows or by columns
            rows = [[value[4 * row + column] for column in range(4)] for row in range(4)]
            by_columns = [row[3] for row in rows] == [0, 0, 0, 1] != rows[3]
            matrix = [list(column) for column in zip(*rows, strict=True)] if by_columns else rows
            value = matrix if matrix[3] == [0, 0, 0, 1] else value
        if path and np.shape(value) in ((3,), (3, 3), (9,)) and (match := _PART.match(path[-1])):
            path = (*path[:-1], path[-1][match.end() :])
            value = np.reshape(value, (3, 3)).tolist() if len(value) == 9 else value
        names: Sequence[str] = "xyz"
        if len(value) == 3 and path and (match := _VECTOR.fullmatch(path[-1])):
            path, names = (*path[:-1], f"{match[1]}rvec"), "123"
        if len(value) == 3 and path and path[-1].lower().endswith("tvec"):
            path, names = (*path[:-1], path[-1][:-4].rstrip("_")), ("tx", "ty", "tz")
        in_matrix = any(isinstance(item, list) for item in value) or (path and path[-1].isdecimal())
        for i, item in enumerate(value):
            yield from _leaves(item, (*path, str(i) if in_matrix else names[i] if len(value) == 3 else str(i + 1)))
    else:
        # A unit goes last.
        words = sorted(
            "_".join(filter(None, path)).split("_"), key={"m", "mm", "um", "rad", "mrad", "deg"}.__contains__
        )
        yield "_".join(words), value
