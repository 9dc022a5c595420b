"""Results as files: the envelope with what made it, the schema, numbers rounded so that all processors agree, CSV text.

A stored result is read back with a check of its values by the declarations of its keys, and its poses as columns. The
outcome of a gate is a part of any result; a gate file is read with the baselines that it names, which are results.
"""

import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.documents.keys import (
    INPUT,
    LEFT_OUT,
    Document,
    Key,
    Kind,
    anything,
    array,
    choice,
    constant,
    count,
    flag,
    number,
    part,
    parts,
    share,
    shortened,
    size,
    table,
    text,
)
from robacc.errors import InputError, Problem, given, refuse
from robacc.io.dialect import cell
from robacc.io.files import read_text, sha256_of
from robacc.poses.reading import PoseFile
from robacc.quantities import SIGNIFICANT_DIGITS, number_text, significant
from robacc.robots.description import IDENTITY
from robacc.statistics.intervals import ASSURANCE
from robacc.version import __version__

if TYPE_CHECKING:
    from robacc.gates import Gate
    from robacc.modelling.validity import OutsideValidity

# Rounding of a document's numbers to significant digits, so that documents agree on all processors.

_LARGEST_EXACT_POWER = 22
"""10^22 is the largest power of ten that a double holds exactly."""
_POWERS = 10.0 ** np.arange(_LARGEST_EXACT_POWER + 1)


def significant_document(value: Any) -> Any:
    """Return the document with every float rounded to :data:`SIGNIFICANT_DIGITS` significant digits."""
    # The types of most values come first, since the test of others is slow.
    if isinstance(value, float | np.floating):
        return significant(float(value))
    if isinstance(value, str | int | None):
        return value
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        with np.errstate(divide="ignore"):
            places = SIGNIFICANT_DIGITS - 1 - np.floor(np.log10(np.abs(value, dtype=float)))
        exact = (places >= 0) & (places <= _LARGEST_EXACT_POWER)
        power = _POWERS[np.where(exact, places, 0.0).astype(np.int64)]
        rounded = np.where(exact, np.rint(value * power) / power, value) + 0.0
        inexact = ~exact & np.isfinite(value) & (value != 0.0)
        rounded[inexact] = [*map(significant, rounded[inexact].tolist())]
        return rounded
    if isinstance(value, Mapping):
        return {key: significant_document(item) for key, item in value.items()}
    return [significant_document(item) for item in value] if isinstance(value, Sequence) else value


# CSV text from columns.


def csv_text(columns: Mapping[str, Iterable[Any] | None]) -> str:
    """Return a header and a line for each row of columns by name; a column that is None is left out."""
    present = {
        name: [number_text(float(value)) if isinstance(value, float) else cell(str(value)) for value in column]
        for name, column in columns.items()
        if column is not None
    }
    return "".join(f"{','.join(row)}\n" for row in (present, *zip(*present.values(), strict=True)))


class InputFile(NamedTuple):
    """One input file of a result."""

    name: str
    """File name without its folder, so that a result does not depend on the folder; ``-`` for a pipe."""
    sha256: str
    """Digest of the file's bytes, hexadecimal."""
    kind: str
    """``poses``, ``robot``, ``scale`` …"""
    reading: Mapping[str, Any] | None = None
    """Statements of the user on names of the file, such as units."""
    identity: Mapping[str, str] | None = None
    """Identity of the arm that a robot file states."""

    @classmethod
    def at(cls, path: str, sha256: str, kind: str, identity: Mapping[str, str] | None = None) -> "InputFile":
        """Return the record of the file at ``path``."""
        reading = path.reading.document() if isinstance(path, PoseFile) else None
        return cls(str(path) if path == "-" else PurePath(path).name, sha256, kind, reading, identity)


def schema_version(command: str) -> int:
    """Return the version of the schema that results of ``command`` follow.

    A version goes up when a key changes its name or meaning, not when keys are added.
    """
    return {"calibrate": 2, "trace": 2}.get(command, 1)


class Provenance(NamedTuple):
    """Options, input files and seed that a result was computed with."""

    options: Mapping[str, Any]
    """Options that the figures depend on, by parameter name."""
    inputs: tuple[InputFile, ...]
    """Every file that was read, and every object that replaced one."""
    seed: int | None = None
    """Seed of the random numbers; None without any."""
    outside: "OutsideValidity | None" = None
    """Poses outside the validity ranges of the robot's model; None without a robot."""
    warnings: tuple[str, ...] = ()
    """Warnings about the use of the model on the poses."""

    def document(self, command: str, payload: Mapping[str, Any]) -> dict[str, Any]:
        """Return the document of a result of ``command``: its envelope, then its own keys.

        The document has no time and no path. On one machine, the same call on the same files gives the same bytes.
        """
        return {
            "schema": f"robacc.{command}/{schema_version(command)}",
            "robacc": __version__,
            "command": command,
            "options": dict(self.options),
            "inputs": [INPUT.write(file) for file in self.inputs],
            "seed": self.seed,
            **significant_document(payload),
        }


# The JSON Schema of a result, made from the declarations of its keys.

MODULES = {
    "calibrate": "fit",
    "check": "envelope",
    "compare": "compare",
    "compare-paired": "compare",
    "correct": "compare",
    "effects": "descriptions",
    "estimate": "accuracy",
    "estimate-many": "accuracy",
    "export": "descriptions",
    "fleet": "history",
    "health": "history",
    "history-add": "history",
    "history-changes": "history",
    "history-show": "history",
    "history-trend": "history",
    "iso9283": "accuracy",
    "iso9283-poses": "accuracy",
    "plan": "expected",
    "predict": "expected",
    "robots": "descriptions",
    "show": "descriptions",
    "simulate": "descriptions",
    "trace": "fit",
}
"""Module of :mod:`robacc.documents` that declares a result, by the result's name, which is the declaration's too."""


def own_keys(name: str) -> Kind:
    """Return the declaration of a result's own keys."""
    kind: Kind = getattr(import_module(f"robacc.documents.{MODULES[name]}"), name.upper().replace("-", "_"))
    return kind


def result_kind(name: str) -> Kind:
    """Return the declaration of a result: its envelope, then its own keys, of which an unknown command has none."""
    own = own_keys(name) if name in MODULES else part()
    envelope = {
        "schema": Key(constant(f"robacc.{name}/{schema_version(name)}"), "Name and version of this schema."),
        "robacc": Key(text, "Version of robacc that made the result."),
        "command": Key(constant(name), "Command that made the result."),
        "options": Key(table(), "Options that the figures depend on, by their names on the command line with _ for -."),
        "inputs": Key(array(INPUT), "Every input file."),
        "seed": Key(count | None, "Seed of all random numbers; null if there are none."),
    }
    return part(**envelope, **(own.keys or {})).named(about=own.about)


# Read a stored result.

RESULT_LIMIT = 256 * 2**20
"""Largest result in bytes: enough for an estimate of half a million poses at some 480 bytes each."""


class StoredResult(NamedTuple):
    """A stored result."""

    document: Mapping[str, Any]
    command: str
    """Command that made the result."""
    sha256: str
    """Digest of the file's bytes, hexadecimal."""
    name: str
    """Path of the file as given; ``-`` is standard input."""

    @property
    def record(self) -> InputFile:
        """Return the record of the file, for results computed from it."""
        return InputFile.at(self.name, self.sha256, "result")


def read_result(path: str | os.PathLike[str]) -> StoredResult:
    """Read a result that a command or :meth:`~robacc.api.result.Result.save` stored as JSON.

    Args:
        path: File to read; ``-`` is standard input.

    Returns:
        ``document``, the JSON document, and ``command``, the name of its command.

    Raises:
        InputError: The file cannot be read, is larger than :data:`RESULT_LIMIT`, is not JSON or is truncated, has a
            repeated key or a number that is not finite, is not a result of robacc, has another schema version, or has
            values that are not of the declared kinds.
    """
    name = "<stdin>" if path == "-" else os.fspath(path)
    document = _parsed(read_text(path, RESULT_LIMIT), name)
    return StoredResult(document, _checked(document, name), sha256_of(path), os.fspath(path))


@contextmanager
def understood(name: str, command: str) -> Iterator[None]:
    """Turn errors from missing or unexpected values of a document into an input error of its file.

    Raises:
        InputError: The document differs from what the command writes.
    """
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        defect = (
            f"has no key {error.args[0]!r}" if isinstance(error, KeyError) else f"has an unexpected value ({error})"
        )
        fix = "compute the result again with this version of robacc"
        raise InputError(Problem(f"is a result of robacc {command}, but {defect}", name, fix=fix)) from error


def _parsed(text: str, name: str) -> Any:
    """Return the document, of any JSON type."""
    refuse((not text.strip(), Problem("is empty", name, fix="save the result as JSON")))
    try:
        document = json.loads(
            text, object_pairs_hook=_unique_keys, parse_constant=_number, parse_float=_number, parse_int=_number
        )
        if "\\u" in text:
            # JSON can spell half of a surrogate pair, which is not a character and cannot be printed or written.
            json.dumps(document, ensure_ascii=False).encode()
    except json.JSONDecodeError as error:
        # A truncated file ends there, or with a part of a number or word.
        if text.lstrip()[0] in "{[" and (
            re.fullmatch(r"[-+.\w]*\s*", text[error.pos :]) or error.msg.startswith("Unterminated string")
        ):
            raise InputError(Problem("is incomplete; the file was truncated", name, error.lineno)) from None
        raise InputError(
            Problem(
                f"is not JSON: {error.msg} at character {error.colno}",
                name,
                error.lineno,
                fix=None if text.lstrip()[0] in "{[" else "save the result as JSON",
            )
        ) from None
    except RecursionError:
        raise InputError(Problem("is nested more deeply than any result", name)) from None
    except UnicodeEncodeError:
        raise InputError(Problem("contains half of a surrogate pair, which is not a character", name)) from None
    except ValueError as error:  # of the hooks
        raise InputError(Problem(f"is not a result: {error}", name)) from None
    return document


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        ((repeated, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"an object has the key {repeated[:60]!r} twice")
    return entries


def _number(text: str) -> float:
    """Return a number of JSON, whole or not; Python also takes the names of numbers that are not finite."""
    refuse(
        (text.lstrip("-")[0] in "NI", f"{text} is not a number of JSON"),
        (not math.isfinite(float(text)), f"the number {text[:40]} is too large"),
        error=ValueError,
    )
    return int(text) if text.lstrip("-").isdecimal() else float(text)


def _checked(document: Any, name: str) -> str:
    """Return the command of a result, after a check of its schema version and of every value that it declares.

    Raises:
        InputError: The document is not a result of this version of robacc; with every value that is not of its kind.
    """
    reason = "it has no key 'schema'" if isinstance(document, Mapping) else "it is not a JSON object"
    other = Problem(f"is not a result of robacc: {reason}", name, fix="save the result as JSON")
    refuse((not isinstance(document, Mapping) or "schema" not in document, other))
    message = f"found {shortened(document['schema'])}, expected robacc.COMMAND/VERSION"
    schema = document["schema"] if isinstance(document["schema"], str) else ""
    match = re.fullmatch(r"robacc\.([a-z0-9][a-z0-9-]*)/([0-9]{1,6})", schema)
    command, version = given(match, Problem(message, name, column="schema")).groups()
    message = (
        f"has version {int(version)} of the schema, from robacc {shortened(document.get('robacc', 'unknown'))}; this "
        f"robacc reads version {schema_version(command)}"
    )
    fix = "compute the result again with this robacc, or read it with the robacc that made it"
    refuse((int(version) != schema_version(command), Problem(message, name, column="schema", fix=fix)))
    # Readers need some keys of every result.
    problems = result_kind(command).problems({**dict.fromkeys(("robacc", "command", "options", "inputs")), **document})
    wrong = [Problem(message, name, column=path) for path, message in problems]
    refuse((wrong, wrong))
    return str(command)


# A result as columns with one entry for each row of the poses, for tables and arrays in a notebook.


def pose_columns(document: Document) -> dict[str, NDArray[Any]]:
    """Return the columns of the poses: ids, circumstances, joints, positions in m, errors in m and rad.

    Every column has as many entries as there are rows. A result without poses gives no column.
    """
    poses = document.get("poses")
    if not isinstance(poses, Mapping) or poses.get("line") is None:
        return {}
    names = ("line", "pose", "cycle", "target", "time_s", "temperature_c", "payload_kg", "used")
    columns = {name: np.asarray(poses[name]) for name in names if poses.get(name) is not None}
    columns |= {f"q{i + 1}": values for i, values in enumerate(np.asarray(poses.get("q") or [], dtype=float).T)}
    places, errors = {"cmd_{}_m": poses.get("commanded_m"), "{}_m": poses.get("attained_m")}, {}
    for unit, quantity, name in (("m", "position", "error"), ("rad", "orientation", "turn")):
        errors[f"{name}_{{}}_{unit}"] = (document.get(quantity) or {}).get(f"errors_{unit}")
        errors |= {f"{stage}_error_{{}}_{unit}": rows for stage, rows in (poses.get(f"errors_{unit}") or {}).items()}
    for pattern, rows in (places | errors).items():
        if rows is not None:
            vectors = np.asarray(rows, dtype=float).T
            columns |= {pattern.format(axis): values for axis, values in zip("xyz", vectors, strict=True)}
            if pattern in errors:
                columns[pattern.replace("_{}", "")] = np.linalg.norm(vectors, axis=0)
    return columns


# Identity of what was tested, for a report: the arm's serial number, the instrument, who measured where and when.


def read_identity(sources: Sequence[str]) -> dict[str, str]:
    """Return the identity of YAML files and of texts ``key=value``; a later source replaces a key of an earlier one.

    Raises:
        InputError: A file cannot be read, has an unknown key or a value that is not one line of text.
        UsageError: A text has an unknown key.
    """
    from robacc.io.yaml_nodes import nearest, top_section
    from robacc.robots.yaml_robot import IDENTITY_FIELDS, read_fields

    identity: dict[str, str] = {}
    for source in sources:
        key, sign, value = (word.strip() for word in source.partition("="))
        stated = {key: value}
        if not sign or os.path.isfile(source):
            top = top_section(read_text(source), source, tuple(IDENTITY))
            stated = read_fields(top, IDENTITY_FIELDS)
            top.source.raise_if_any()
            fix = f"write at least one of {', '.join(IDENTITY)}"
            refuse((not stated, Problem("names nothing of what was tested", source, fix=fix)))
        else:
            known = nearest(key, tuple(IDENTITY)) or f"known keys: {', '.join(IDENTITY)}"
            refuse(
                (key not in IDENTITY, f"`identity`: unknown key {key!r}; {known}"),
                (
                    not value.isprintable() or not value,
                    f"`identity`: expected one line of text for {key}, found {value!r}",
                ),
            )
        identity |= stated
    return {key: identity[key] for key in IDENTITY if key in identity}


OUTCOME = choice("pass", "fail", "inconclusive", "not_evaluated").named("outcome")

GATE_RESULT = part(
    name=Key(text, "Name of the gate.", "gate.name"),
    outcome=Key(OUTCOME, "Fail if one criterion fails, pass if all criteria pass."),
    exit_status=Key(choice(0, 4, 5), "Exit status of the command: 0 pass, 4 fail, 5 undecided."),
    assurance=Key(share, "Probability that poses_to_decide poses decide.", lambda _: ASSURANCE),
    criteria=Key(
        parts(
            name=Key(text, "Name of the criterion."),
            key=Key(text, "Key of the figure, as in position.p95."),
            outcome=Key(OUTCOME),
            why=Key(text | None, "Explanation of the outcome, if it needs one."),
            unit=Key(text, "Unit of value, limit, bounds and margin: m, rad or 1."),
            value=Key(Kind({"type": ["number", "string"]}) | None, "Value of the result: a number, a grade or a word."),
            limit=Key(anything, "Limit: a number, a grade, or the words that pass."),
            at_least=Key(flag, "True if the limit is a minimum, not a maximum."),
            rule=Key(choice("bound", "simple", "guard_band", "guarded_rejection"), "Decision rule."),
            rule_text=Key(text, "Description of the rule, with its source."),
            confidence=Key(share | None, "Confidence of each one-sided bound; null if the rule uses no bound."),
            share=Key(
                share | None, "Share of all poses that must lie within the limit of a largest error; otherwise null."
            ),
            lower_bound=Key(number | None, "One-sided lower bound at the confidence."),
            upper_bound=Key(number | None, "One-sided upper bound at the confidence."),
            margin=Key(number | None, "Distance to the limit; negative beyond the limit."),
            conformity_probability=Key(share | None, "Confidence that the true value meets the limit."),
            method=Key(text | None, "Method of the bounds."),
            n_poses=Key(count | None, "Number of commanded poses behind the value."),
            poses_to_decide=Key(
                count | None,
                "Total number of poses (of visits for ISO 9283) that would decide an inconclusive criterion.",
            ),
            poses_to_decide_if_value_is_true=Key(
                count | None, "The same number if the measured value is the true value."
            ),
            baseline=Key(
                part(
                    file=Key(text, "Path from the gate file."),
                    value=Key(number | None, "Value of the figure in the baseline."),
                )
                | None,
                "Stored result that the figure is compared with; otherwise null.",
            ),
            instrument_uncertainty_over_limit=Key(
                size | None, "The instrument's expanded uncertainty over the limit; null if unknown."
            ),
            reason=Key(text, "Reason for the limit, from the gate file."),
            warnings=Key(array(text), "Warnings about this criterion."),
            operating_curve_over=Key(choice("share_within_limit", "value"), "Abscissa of the operating curve."),
            operating_curve=Key(
                array(array(number, 2)), "Pairs of a true value and the probability to pass at that value."
            ),
        ),
        "Criteria in the order of the gate.",
        "evaluations",
    ),
    warnings=Key(array(text), "Warnings of all criteria, without repetitions."),
).named("gate_result", "Outcome of a gate.")

GATE_KEY = Key(GATE_RESULT, "Gate outcome; present only with a gate.", lambda _: LEFT_OUT, optional=True)
"""Key that a gate adds to a result."""

CHECK = part(
    result=Key(
        part(
            schema=Key(text, "Schema of the result."),
            robacc=Key(text, "Version of robacc that made the result."),
            command=Key(text, "Command that made the result."),
            inputs=Key(array(INPUT), "Input files of the result."),
        ),
        "Evaluated result.",
        lambda checked: {key: checked.result.document.get(key) for key in ("schema", "robacc", "command", "inputs")},
    ),
    gate=Key(GATE_RESULT, source=""),
).named(about="Evaluation of a gate on a stored result.")


# Read a gate file and the baselines that it names.


def read_gate(path: str) -> "tuple[Gate, Mapping[str, Mapping[str, Any]], list[InputFile]]":
    """Return the gate of a file, its baselines, and the records of all these files.

    Paths of baselines start from the folder of the gate file.

    Raises:
        InputError: One of the files cannot be read, is not a gate, or is not a result.
    """
    from robacc.gates import load_gate

    gate = load_gate(read_text(path), path)
    records = [InputFile.at(path, sha256_of(path), "gate")]
    baselines = {}
    problems: list[Problem] = []
    for name in gate.baselines:
        place = baseline_path(path, name)
        try:
            stored = read_result(place)
        except InputError as error:
            problems += error.problems
            continue
        baselines[name] = stored.document
        records.append(InputFile.at(place, stored.sha256, "baseline"))
    refuse((problems, problems))
    return gate, baselines, records


def baseline_path(gate: str, name: str) -> str:
    """Return the path of a baseline that the file ``gate`` names."""
    return os.fspath(Path(gate).parent / name)
