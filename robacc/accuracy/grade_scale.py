"""Scales of accuracy grades: the record, and its reader from YAML, which reports every problem with its line."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast, get_args

from robacc.errors import InputError, Problem
from robacc.statistics.records import Statistic

if TYPE_CHECKING:
    import yaml

Quantity = Literal["position", "orientation"]

VERSION = "1"
STATISTICS: tuple[str, ...] = get_args(Statistic)
_KEYS = ("robacc", "name", "statistic", "confidence", "units", "steps", "otherwise")
_STEP_KEYS = ("grade", "position", "orientation")
_UNITS = {"length": {"m": 1.0, "mm": 1e-3}, "angle": {"rad": 1.0, "deg": math.pi / 180.0}}


@dataclass(frozen=True, slots=True)
class GradeStep:
    """Grade and the limits that the statistic must meet."""

    grade: str
    position: float
    """m"""
    orientation: float | None
    """rad; None: no limit of orientation"""

    def limit(self, quantity: Quantity) -> float | None:
        """Return the limit of a quantity in m or rad; None where there is none."""
        return self.position if quantity == "position" else self.orientation


@dataclass(frozen=True, slots=True)
class Scale:
    """Grades from the best to the widest, and the statistic of the error's length that decides."""

    name: str
    statistic: Statistic
    confidence: float
    """Confidence of the upper bound that confirms a grade."""
    steps: tuple[GradeStep, ...]
    otherwise: str
    """Name for errors that meet no step."""

    def name_of(self, rank: int) -> str:
        """Return the grade of step ``rank``, 0 for the best; beyond the last step, the name for errors outside all."""
        return self.steps[rank].grade if rank < len(self.steps) else self.otherwise


def default_scale() -> Scale:
    """Return the built-in scale: A within 0.1 mm and 0.1 degree, the CAD/CAM requirement of the paper."""
    import yaml

    # importlib.resources loads zipfile and more: 3 ms of the 150 that an estimate may take. libyaml, where available,
    # takes a tenth of the time; a user's file is not read by it, because deep nesting makes it end the process.
    path = Path(__file__).parents[1] / "data" / "grades" / "default.yaml"
    text = path.read_text(encoding="utf-8")
    return _scale_of(yaml.compose(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)), path.name)


def load_scale(text: str, file: str) -> Scale:
    """Read a scale.

    Args:
        text: Content of the YAML file.
        file: Name of the file, for messages.

    Raises:
        InputError: With every problem, its line and key.
    """
    from robacc.io.yaml_nodes import compose

    return _scale_of(compose(text, file), file)


def _scale_of(root: yaml.Node | None, file: str) -> Scale:
    reader = _GradeScaleReader(file)
    scale = _read(reader, root)
    if scale is None or reader.problems:
        raise InputError(reader.problems)
    return scale


@dataclass(frozen=True, slots=True)
class _GradeScaleReader:
    """Reader of values from YAML nodes, which know their lines; it collects the problems."""

    file: str
    problems: list[Problem] = field(default_factory=list)

    def report(self, node: yaml.Node | None, key: str, message: str, fix: str | None = None) -> None:
        """Record a problem at a node's line."""
        line = 1 if node is None else node.start_mark.line + 1
        self.problems.append(Problem(message, self.file, line, key or None, fix))

    def mapping(self, node: yaml.Node | None, key: str, known: tuple[str, ...]) -> dict[str, yaml.Node]:
        """Return the children of a mapping by name; report unknown and repeated names."""
        from difflib import get_close_matches

        from yaml import MappingNode

        if not isinstance(node, MappingNode):
            self.report(node, key, f"expected a mapping with the keys {', '.join(known)}")
            return {}
        result: dict[str, yaml.Node] = {}
        for child, value in node.value:
            name = str(child.value)
            if name not in known:
                near = get_close_matches(name, known, n=1)
                fix = f"did you mean {near[0]}" if near else f"the keys are {', '.join(known)}"
                self.report(child, _join(key, name), "unknown key", fix)
            elif name in result:
                self.report(child, _join(key, name), "duplicate key", "remove one of them")
            result.setdefault(name, value)
        return result

    def text(self, node: yaml.Node | None, key: str, parent: yaml.Node | None) -> str | None:
        """Return a word or number as text; report any other node and return None."""
        from yaml import ScalarNode

        if node is None:
            self.report(parent, key, "missing key")
        elif not isinstance(node, ScalarNode) or not node.value.strip() or not node.value.isprintable():
            self.report(node, key, "expected a single word or number")
        else:
            return str(node.value).strip()
        return None

    def choice(
        self, node: yaml.Node | None, key: str, parent: yaml.Node | None, allowed: tuple[str, ...]
    ) -> str | None:
        """Return one of the ``allowed`` words; report any other."""
        value = self.text(node, key, parent)
        if value is not None and value not in allowed:
            self.report(node, key, f"found {value!r}, expected one of {', '.join(allowed)}")
            return None
        return value

    def positive(self, node: yaml.Node | None, key: str, parent: yaml.Node | None) -> float | None:
        """Return a finite number greater than zero; report any other."""
        value = self.text(node, key, parent)
        if value is None:
            return None
        try:
            # float() also takes 1_000 and digits of other scripts.
            number = float(value) if value.isascii() and "_" not in value else math.nan
        except ValueError:
            number = math.nan
        if not (math.isfinite(number) and number > 0.0):
            self.report(node, key, f"found {value!r}, expected a number greater than zero")
            return None
        return number


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _read(reader: _GradeScaleReader, root: yaml.Node | None) -> Scale | None:
    top = reader.mapping(root, "", _KEYS)
    if not top:
        return None
    reader.choice(top.get("robacc"), "robacc", root, (VERSION,))
    name = reader.text(top.get("name"), "name", root)
    statistic = reader.choice(top.get("statistic"), "statistic", root, STATISTICS)
    confidence = reader.positive(top.get("confidence"), "confidence", root)
    if confidence is not None and not 0.5 <= confidence < 1.0:
        reader.report(top["confidence"], "confidence", f"found {confidence:g}, expected at least 0.5 and less than 1")
    factors = _read_units(reader, top.get("units"), root)
    steps = _read_steps(reader, top.get("steps"), root, factors)
    otherwise = reader.text(top.get("otherwise"), "otherwise", root)
    if otherwise in [step.grade for step in steps]:
        reader.report(
            top["otherwise"], "otherwise", f"{otherwise!r} is also the grade of a step", "choose another name"
        )
    if name is None or statistic is None or confidence is None or otherwise is None:
        return None
    return Scale(name, cast("Statistic", statistic), confidence, tuple(steps), otherwise)


def _read_units(reader: _GradeScaleReader, node: yaml.Node | None, root: yaml.Node | None) -> tuple[float, float]:
    """Return metres and radians per unit of the file."""
    if node is None:
        reader.report(root, "units", "missing key", "add it, for example units: {length: mm, angle: deg}")
        return 1.0, 1.0
    units = reader.mapping(node, "units", tuple(_UNITS))
    length, angle = (
        _UNITS[kind].get(reader.choice(units.get(kind), f"units.{kind}", node, tuple(_UNITS[kind])) or "", 1.0)
        for kind in _UNITS
    )
    return length, angle


def _read_steps(
    reader: _GradeScaleReader, node: yaml.Node | None, root: yaml.Node | None, factors: tuple[float, float]
) -> list[GradeStep]:
    from yaml import SequenceNode

    if not isinstance(node, SequenceNode) or not node.value:
        reader.report(node or root, "steps", "expected a list of at least one step")
        return []
    steps: list[GradeStep] = []
    for index, item in enumerate(node.value):
        key = f"steps[{index}]"
        fields = reader.mapping(item, key, _STEP_KEYS)
        if not fields:
            continue
        letter = reader.text(fields.get("grade"), f"{key}.grade", item)
        position = reader.positive(fields.get("position"), f"{key}.position", item)
        orientation = None
        if "orientation" in fields:
            orientation = reader.positive(fields["orientation"], f"{key}.orientation", item)
        if letter is None or position is None:
            continue
        step = GradeStep(letter, position * factors[0], None if orientation is None else orientation * factors[1])
        _compare(reader, item, key, step, steps)
        steps.append(step)
    return steps


def _compare(reader: _GradeScaleReader, node: yaml.Node, key: str, step: GradeStep, before: list[GradeStep]) -> None:
    """Report a step that contradicts the steps ``before`` it."""
    if step.grade in [earlier.grade for earlier in before]:
        reader.report(node, f"{key}.grade", f"the grade {step.grade!r} is listed twice")
    if not before:
        return
    last = before[-1]
    if step.position <= last.position:
        reader.report(
            node,
            f"{key}.position",
            f"the limit is not wider than that of grade {last.grade}",
            "list the best grade first",
        )
    if last.orientation is None and step.orientation is not None:
        reader.report(node, f"{key}.orientation", f"the better grade {last.grade} has no limit of orientation")
    if last.orientation is not None and step.orientation is not None and step.orientation < last.orientation:
        reader.report(
            node,
            f"{key}.orientation",
            f"the limit is narrower than that of grade {last.grade}",
            "list the best grade first",
        )
