"""Members that every result of a call has, and checks that calls share."""

from __future__ import annotations

import inspect
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

from robacc.documents.envelope import InputFile, envelope
from robacc.errors import UsageError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from robacc.documents.gate_files import LoadedGate
    from robacc.gates.evaluate import GateOutcome

_RECORDED_APART = frozenset({"poses", "robot", "scale", "tolerances", "against", "results", "seed", "progress"})
"""Parameters that are not among the options: files stand among the inputs, the seed has a key of its own."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Options, input files and seed that a result was computed with."""

    options: Mapping[str, Any]
    """Options that the figures depend on, by parameter name."""
    inputs: tuple[InputFile, ...]
    """Every file that was read, and every object that replaced one."""
    seed: int | None
    """Seed of the random numbers; None without any."""


class Result(ABC):
    """Result of a command."""

    __slots__ = ()
    command: ClassVar[str]
    """Name of the command and of its schema."""
    made: Provenance

    if TYPE_CHECKING:  # for the type checker only: a property here would hide the field of a subclass

        @property
        def warnings(self) -> tuple[str, ...]:
            """Doubts about the data or the result; the command writes them to standard error."""

    def __repr__(self) -> str:
        """Return the type and the input files; the figures are too many to show."""
        files = ", ".join(file.name for file in self.made.inputs)
        return f"<robacc.{type(self).__name__} of {files}>"

    @abstractmethod
    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""

    def document(self, *, gate: str | os.PathLike[str] | None = None) -> dict[str, Any]:
        """Return the JSON document that the command writes, as Python objects and arrays.

        Args:
            gate: Gate file to check the result against; the outcome stands under the key ``gate``.

        Raises:
            InputError: The gate cannot be read.
        """
        if gate is None:
            return self._document(self.made.inputs)
        from robacc.documents.gate_files import read_gate

        return self.gated(read_gate(os.fspath(gate)))[0]

    def gated(self, gate: LoadedGate) -> tuple[dict[str, Any], GateOutcome]:
        """Return the document with the outcome of ``gate`` under the key ``gate``, and the outcome itself."""
        from robacc.documents.gate import gate_document
        from robacc.gates.evaluate import evaluate_gate

        document = self._document((*self.made.inputs, *gate.records))
        outcome = evaluate_gate(gate.gate, document, gate.baselines)
        return {**document, "gate": gate_document(outcome)}, outcome

    def to_json(self, *, gate: str | os.PathLike[str] | None = None) -> str:
        """Return the document as text: the output of the command with ``--format json``, byte for byte.

        Raises:
            InputError: The gate cannot be read.
        """
        from robacc.io.json_text import json_text

        return json_text(self.document(gate=gate))

    def save(self, path: str | os.PathLike[str], *, gate: str | os.PathLike[str] | None = None) -> None:
        """Write :meth:`to_json` to a file that other commands read; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written, or the gate cannot be read.
        """
        from robacc.io.files import write_text

        write_text(path, self.to_json(gate=gate))

    def _document(self, inputs: Sequence[InputFile]) -> dict[str, Any]:
        return envelope(self.command, self.payload(), options=self.made.options, inputs=inputs, seed=self.made.seed)


def fields_of(body: DataclassInstance) -> dict[str, Any]:
    """Return the fields of a dataclass by name, not copied."""
    return {field.name: getattr(body, field.name) for field in fields(body)}


def options_of(call: Callable[..., Result], arguments: Mapping[str, object], **resolved: object) -> dict[str, Any]:
    """Return the options of a call in the order of its signature.

    Args:
        call: The function that was called.
        arguments: Its arguments, as ``locals()`` gives them before the first assignment.
        resolved: Values that replace the arguments as given; a parameter named here is recorded in any case.
    """
    parameters = inspect.signature(call).parameters
    if unknown := resolved.keys() - parameters.keys():
        raise TypeError(f"{call.__name__} has no parameter {', '.join(sorted(unknown))}")
    values = {**arguments, **resolved}
    return {name: values[name] for name in parameters if name in resolved or name not in _RECORDED_APART}


def effect_names(effects: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the names in a list, or in text separated by commas, in their order and without repetitions."""
    names = effects.split(",") if isinstance(effects, str) else effects or ()
    return tuple(dict.fromkeys(name.strip() for name in names if name.strip()))


def check_choice(parameter: str, value: object, choices: Sequence[object]) -> None:
    """Raise UsageError unless ``value`` is one of ``choices``."""
    if value not in choices:
        raise UsageError(f"`{parameter}`: expected one of {', '.join(map(repr, choices))}, found {value!r}")


def check_range(parameter: str, value: float, low: float, high: float = math.inf) -> None:
    """Raise UsageError unless ``low <= value <= high``."""
    if not low <= value <= high:
        limits = f"of at least {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
        raise UsageError(f"`{parameter}`: expected a number {limits}, found {value!r}")
