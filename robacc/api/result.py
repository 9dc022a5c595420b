"""What every result of a call can do: become the document that the command writes, byte for byte."""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

from robacc.documents.envelope import InputFile, envelope
from robacc.errors import UsageError

if TYPE_CHECKING:
    from robacc.documents.gate_files import LoadedGate
    from robacc.gates.evaluate import GateOutcome


@dataclass(frozen=True, slots=True)
class Made:
    """How a result was made."""

    options: Mapping[str, Any]
    """Those that the figures depend on, by their names on the command line with ``_`` for ``-``."""
    inputs: tuple[InputFile, ...]
    """Every file that was read, and what stood in for one."""
    seed: int | None
    """Of everything drawn at random; None where nothing is."""


class Result(ABC):
    """A result of one of the commands."""

    __slots__ = ()
    command: ClassVar[str]
    """The command's name, which is its schema's too."""
    made: Made

    if TYPE_CHECKING:  # to a type checker only: where it is a field, a property here would stand in its way

        @property
        def warnings(self) -> tuple[str, ...]:
            """What looks wrong; the command says it on standard error."""

    def __repr__(self) -> str:
        """What it is and of what; the figures are too many to be shown."""
        of = ", ".join(file.name for file in self.made.inputs)
        return f"<robacc.{type(self).__name__} of {of}>"

    @abstractmethod
    def payload(self) -> dict[str, Any]:
        """The result's own keys; arrays stay arrays."""

    def document(self, *, gate: str | os.PathLike[str] | None = None) -> dict[str, Any]:
        """The JSON document that the command writes, as Python objects and arrays.

        Args:
            gate: Gate file to judge the result by; what comes of it stands under ``gate``.

        Raises:
            InputError: The gate cannot be read.
        """
        if gate is None:
            return envelope(
                self.command,
                self.payload(),
                options=self.made.options,
                inputs=self.made.inputs,
                seed=self.made.seed,
            )
        from robacc.documents.gate_files import read_gate

        return self.gated(read_gate(os.fspath(gate)))[0]

    def gated(self, gate: LoadedGate) -> tuple[dict[str, Any], GateOutcome]:
        """The document with what a gate says of it under ``gate``, and that by itself."""
        from robacc.documents.gate import gate_document
        from robacc.gates.evaluate import judge

        inputs = (*self.made.inputs, *gate.records)
        document = envelope(self.command, self.payload(), options=self.made.options, inputs=inputs, seed=self.made.seed)
        outcome = judge(gate.gate, document, gate.baselines)
        return {**document, "gate": gate_document(outcome)}, outcome

    def to_json(self, *, gate: str | os.PathLike[str] | None = None) -> str:
        """The same as text: what the command writes with ``--format json``, byte for byte.

        Raises:
            InputError: The gate cannot be read.
        """
        from robacc.io.json_text import json_text

        return json_text(self.document(gate=gate))

    def save(self, path: str | os.PathLike[str], *, gate: str | os.PathLike[str] | None = None) -> None:
        """Write :meth:`to_json` to a file, whole or not at all; the other commands read it from there.

        Raises:
            InputError: The file cannot be written, or the gate cannot be read.
        """
        from robacc.io.files import write_text

        write_text(path, self.to_json(gate=gate))


def parts(record: Any) -> dict[str, Any]:
    """The fields of a dataclass by name, as they are."""
    return {field.name: getattr(record, field.name) for field in fields(record)}


def names(listed: str | Sequence[str] | None) -> tuple[str, ...]:
    """The names of a list, or of text with commas between them, in their order, each once."""
    several = listed.split(",") if isinstance(listed, str) else listed or ()
    return tuple(dict.fromkeys(name.strip() for name in several if name.strip()))


def one_of(option: str, value: object, allowed: Sequence[object]) -> None:
    """Refuse a value that an option does not have.

    Raises:
        UsageError: it is not one of ``allowed``.
    """
    if value not in allowed:
        raise UsageError(f"`{option}`: expected one of {', '.join(map(repr, allowed))}, found {value!r}")


def within(option: str, value: float, low: float, high: float = math.inf) -> None:
    """Refuse a number that an option does not take.

    Raises:
        UsageError: it is below ``low`` or above ``high``.
    """
    if not low <= value <= high:
        limits = f"of at least {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
        raise UsageError(f"`{option}`: expected a number {limits}, found {value!r}")
