"""Members that every result of a call has."""

from __future__ import annotations

import io
import json
import os
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

from robacc.documents.envelope import (
    GATE_RESULT,
    MODULES,
    Provenance,
    own_keys,
    pose_columns,
    read_gate,
    read_identity,
    result_kind,
    schema_version,
    significant_document,
)
from robacc.errors import UsageError, refuse
from robacc.io.files import write_file
from robacc.io.json_text import json_text

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame

    from robacc.render.text import Section


@dataclass(frozen=True, kw_only=True, repr=False)
class Result:
    """Result of a command; another base has the fields of what was computed."""

    __slots__ = ()
    command: ClassVar[str]
    """Name of the command and of its schema."""
    made: Provenance
    warnings: tuple[str, ...] = field(default_factory=tuple)  # a default would hide the field of the other base
    """Doubts about the data or the result; the command writes them to standard error."""

    def __init_subclass__(cls, command: str = "") -> None:
        """Name the command of a class of results; a copy of the class, as ``dataclass`` makes of one, keeps it."""
        cls.command = command or getattr(cls, "command", "")

    def __repr__(self) -> str:
        """Return the type and the input files; the figures are too many to show."""
        return f"<robacc.{type(self).__name__} of {', '.join(file.name for file in self.made.inputs)}>"

    def __str__(self) -> str:
        """Return the first screen of the command as text, with the warnings below it."""
        from robacc.render.text import draw

        page = io.StringIO()
        draw(self.view(), page)
        return "\n".join((page.getvalue().rstrip(), *(f"warning: {text}" for text in self.warnings)))

    def view(self) -> Iterable[Section]:
        """Return what the command shows without options, else the headline and the key figures."""
        from robacc.render.page import notebook_view

        return notebook_view(self._plain())

    def named(self, kind: str) -> str:
        """Return the name of the input of a kind; empty without any."""
        return next((file.name for file in self.made.inputs if file.kind == kind), "")

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        return own_keys(self.command).write(self)

    def document(self, *, gate: str | os.PathLike[str] | None = None) -> dict[str, Any]:
        """Return the JSON document that the command writes, as Python objects and arrays.

        Args:
            gate: Gate file to check the result against; the outcome stands under the key ``gate``.

        Raises:
            InputError: The gate cannot be read.
        """
        if gate is None:
            return self.made.document(self.command, self.payload())
        from robacc.gates import evaluate_gate

        criteria, baselines, records = read_gate(os.fspath(gate))
        made = self.made._replace(inputs=(*self.made.inputs, *records))
        document = made.document(self.command, self.payload())
        return {
            **document,
            "gate": significant_document(GATE_RESULT.write(evaluate_gate(criteria, document, baselines))),
        }

    def to_json(self, *, gate: str | os.PathLike[str] | None = None) -> str:
        """Return the document as text: the output of the command with ``--format json``, byte for byte.

        Raises:
            InputError: The gate cannot be read.
        """
        return json_text(self.document(gate=gate))

    def save(self, path: str | os.PathLike[str], *, gate: str | os.PathLike[str] | None = None) -> None:
        """Write :meth:`to_json` to a file that other commands read; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written, or the gate cannot be read.
        """
        write_file(path, self.to_json(gate=gate))

    def _repr_html_(self) -> str:
        """Return the headline and key figures for a notebook."""
        from robacc.render.page import notebook_html

        return notebook_html(self._plain())

    def report(self, path: str | os.PathLike[str], *, identity: str | Mapping[str, str] | None = None) -> None:
        """Write the result as an HTML page with charts and tables; a failure leaves no partial file.

        Args:
            path: File to write.
            identity: What was tested: a YAML file, or texts by the keys of such a file (``serial_number`` …). They
                replace those under ``identity`` of the robot file.

        Raises:
            InputError: A file cannot be read or written.
            UsageError: The extra ``report`` is not installed, or a key of the identity is unknown.
        """
        from robacc.render.page import render

        texts = identity.items() if isinstance(identity, Mapping) else ()
        pairs = [identity] if isinstance(identity, str) else [f"{key}={text}" for key, text in texts]
        write_file(path, render([self._plain()], [self.command], read_identity(pairs)))

    def plot(self, kind: str | None = None, number: int = 1, *, path: str | os.PathLike[str] | None = None) -> Figure:
        """Return a chart of the report as a matplotlib figure, and write it if ``path`` is given.

        Args:
            kind: Kind of chart, as ``robacc report --chart`` lists them; None for the first chart.
            number: Number of the chart among several of its kind.
            path: File to write, with the suffix .svg, .png or .pdf.

        Raises:
            UsageError: The result has no such chart, or the extra ``report`` is not installed.
        """
        from robacc.render.plots.canvas import as_figure, need
        from robacc.render.plots.results import chart_of

        need("matplotlib")
        figure = as_figure(chart_of(self._plain(), kind or "", number))
        if path is not None:
            figure.savefig(path)
        return figure

    def to_numpy(self) -> dict[str, NDArray[Any]]:
        """Return the poses as arrays ``(N,)`` by name: ids, joints, positions and errors in m and rad.

        The names are those of the columns of :meth:`to_pandas`. A result without poses gives an empty dictionary.
        """
        return pose_columns(self._plain())

    def to_pandas(self) -> DataFrame:
        """Return the poses as a pandas DataFrame with one row for each pose; see :meth:`to_numpy`.

        Raises:
            UsageError: pandas is not installed, or the result has no poses.
        """
        try:
            import pandas
        except ImportError as error:
            raise UsageError("to_pandas needs pandas, which is not installed; run pip install pandas") from error
        columns = self.to_numpy()
        refuse((not columns, f"a result of robacc {self.command} has no table of poses; see document()"))
        return pandas.DataFrame(columns)

    def _plain(self) -> dict[str, Any]:
        """Return the document as its JSON file would be read, with lists in place of arrays."""
        document: dict[str, Any] = json.loads(self.to_json())
        return document


class CsvResult(Result):
    """Result with a CSV of poses, which its command writes."""

    __slots__ = ()

    @abstractmethod
    def csv_pieces(self) -> Iterator[str]:
        """Yield the text of :meth:`csv` in pieces."""

    def csv(self) -> str:
        """Return the file that the command writes."""
        return "".join(self.csv_pieces())

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write :meth:`csv` to a file; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written.
        """
        write_file(path, self.csv_pieces())


def fields_of(body: DataclassInstance) -> dict[str, Any]:
    """Return the fields of a dataclass by name, not copied."""
    return {field.name: getattr(body, field.name) for field in fields(body)}


def effect_names(effects: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the names in a list, or in text separated by commas, in their order and once; none for ``"none"``."""
    names = () if effects == "none" else effects.split(",") if isinstance(effects, str) else effects or ()
    return tuple(dict.fromkeys(name.strip() for name in names if name.strip()))


# Schemas of the results, made from the declarations of their keys.


def schema_names() -> tuple[str, ...]:
    """Return the commands whose results have a schema."""
    return tuple(sorted(MODULES))


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a command's result.

    Args:
        name: Name of the command, such as ``estimate``.

    Raises:
        UsageError: No command of that name has a schema.

    Example:
        >>> import robacc
        >>> robacc.schema("estimate")["properties"]["n_poses"]["description"]
        'Measured poses (rows).'
    """
    refuse((name not in MODULES, f"no schema {name!r}; choose one of {', '.join(schema_names())}"))
    kind, version = result_kind(name), schema_version(name)
    shared: dict[str, Any] = {}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:robacc:schema:{name}:{version}",
        "title": f"robacc.{name}/{version}",
        "description": f"{kind.about} Lengths in m, angles in rad; missing numbers are null. Keys may be added.",
        **kind.schema(shared),
        "$defs": shared,
    }
