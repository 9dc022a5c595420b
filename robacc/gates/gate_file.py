"""A gate file (YAML) as a gate, every problem found at its line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from robacc.errors import InputError, Problem
from robacc.gates.criteria import RULES, Gate, GateCriterion, Rule
from robacc.gates.keys import LARGER_IS_BETTER, Kind, is_known, kind_of, nearest_key
from robacc.quantities import UNITS, Dimension, parse_quantity

if TYPE_CHECKING:
    import yaml

    from robacc.io.yaml_nodes import Source, YamlSection

VERSION = "1"
DEFAULT_CONFIDENCE = 0.95
DEFAULT_SHARE = 0.95
"""Of all poses that must lie within the limit of a largest error, which no sample shows whole."""
_TOP = ("robacc_gate", "name", "confidence", "criteria")
_KEYS = (
    *("name", "key", "limit", "at_least", "rule", "confidence", "false_accept_risk", "false_reject_risk"),
    *("share", "baseline", "paired", "reason"),
)
_SETTING: dict[Rule, str] = {
    "bound": "confidence",
    "guard_band": "false_accept_risk",
    "guarded_rejection": "false_reject_risk",
}
"""The key that says how sure each rule must be."""


def load_gate(text: str, file: str) -> Gate:
    """Read a gate.

    Args:
        text: Content of the YAML file.
        file: Its name, for messages.

    Raises:
        InputError: With every problem found, each with its line and key.
    """
    from robacc.io.yaml_nodes import Source, compose

    source = Source(file)
    top = source.section(compose(text, file), "", _TOP)
    if top is None:
        source.finish()
        raise InputError(Problem("expected a gate", file))
    if (version := top.require("robacc_gate")) is not None:
        source.choice(version, "robacc_gate", (VERSION,))
    name = top.require("name")
    gate_name = None if name is None else source.text(name, "name")
    confidence = _probability(top, "confidence", DEFAULT_CONFIDENCE)
    criteria: list[GateCriterion] = []
    nodes = top.require("criteria")
    items = () if nodes is None else source.items(nodes, "criteria", "criteria")
    if nodes is not None and not items and not source.problems:
        source.report(nodes, "criteria", "a gate without a criterion would let everything pass")
    for index, node in enumerate(items):
        section = source.section(node, f"criteria[{index}]", _KEYS)
        one = None if section is None else _GateFileReader(section, confidence).criterion()
        if one is None:
            continue
        if one.name in [other.name for other in criteria]:
            source.report(node, f"criteria[{index}].name", f"the name {one.name!r} stands here twice")
        criteria.append(one)
    source.finish()
    return Gate(gate_name or "", tuple(criteria))


@dataclass(frozen=True, slots=True)
class _GateFileReader:
    """Reads one criterion."""

    section: YamlSection
    confidence: float
    """Where the criterion states none."""

    @property
    def source(self) -> Source:
        return self.section.source

    def report(self, key: str, message: str, fix: str | None = None) -> None:
        node = self.section.values.get(key, self.section.node)
        self.source.report(node, self.section.at(key), message, fix)

    def text(self, key: str) -> str | None:
        node = self.section.get(key)
        return None if node is None else self.source.text(node, self.section.at(key))

    def criterion(self) -> GateCriterion | None:
        """The criterion; None, with complaints, where it cannot be read."""
        before = len(self.source.problems)
        node = self.section.require("key")
        key = None if node is None else self.source.text(node, self.section.at("key"))
        why = self._reason()
        if key is None:
            return None
        if not is_known(key):
            self.report("key", f"no result has a key {key!r}", nearest_key(key))
            return None
        baseline = self.text("baseline")
        kind, limit, words, at_least = self._limit(key, baseline)
        rule, confidence = self._rule(kind, baseline)
        share = self._share(key, baseline)
        paired = self._paired(baseline)
        if len(self.source.problems) > before:
            return None
        name = self.text("name") or key
        return GateCriterion(name, key, kind, limit, words, at_least, rule, confidence, share, baseline, paired, why)

    def _reason(self) -> str:
        """Why the limit is what it is; a text of several lines becomes one."""
        from yaml import ScalarNode

        node = self.section.require("reason")
        if node is None:
            return ""
        if not isinstance(node, ScalarNode):
            self.report("reason", "expected text: why the limit is what it is")
            return ""
        return " ".join(node.value.split())

    def _limit(self, key: str, baseline: str | None) -> tuple[Kind, float | None, tuple[str, ...], bool]:
        """Kind of the key, the limit or the words that pass, and whether the limit is the lowest value allowed."""
        kind = kind_of(key)
        given = [name for name in ("limit", "at_least") if self.section.get(name) is not None]
        if len(given) == 2:
            self.report("at_least", "limit (the most allowed) and at_least both stand here", "give one of them")
        if kind in ("word", "grade"):
            return kind, None, self._words(kind, given, baseline), False
        if not given:
            if baseline is None:
                self.report("limit", "is missing: the most allowed; or at_least, the least")
            # Beside a baseline the plain question is whether the figure got worse at all.
            return kind or "number", 0.0, (), key in LARGER_IS_BETTER
        name = given[0]
        text = self.text(name)
        found = None if text is None else parse_quantity(text)
        if text is None:
            return kind or "number", None, (), False
        wanted = _dimension(kind)
        if found is None or (kind is not None and found[1] != wanted and not (found[0] == 0 and found[1] is None)):
            units = "a bare number" if kind == "number" else f"a number with its unit ({_units(kind)})"
            self.report(name, f"expected {units}, found {text!r}", _example(kind))
            return kind or "number", None, (), False
        if found[0] < 0 and baseline is None and wanted is not None and key != "gain":
            self.report(name, f"{key} is never negative, so nothing could meet {text!r}")
        return kind or found[1] or "number", found[0], (), name == "at_least"

    def _words(self, kind: Kind, given: list[str], baseline: str | None) -> tuple[str, ...]:
        if baseline is not None:
            self.report("baseline", "a comparison is of numbers, and this key's value is a word")
        if given != ["limit"]:
            wanted = "the grade to be met" if kind == "grade" else "the words that pass, as a list"
            self.report("limit", f"expected here: {wanted}")
            return ()
        node = self.section.values["limit"]
        path = self.section.at("limit")
        from yaml import SequenceNode

        if kind == "grade" and isinstance(node, SequenceNode):
            self.report("limit", "expected one grade, which better ones meet too, found a list")
            return ()
        nodes = list(node.value) if isinstance(node, SequenceNode) else [node]
        words = [self.source.text(item, path) for item in nodes]
        if not words:
            self.report("limit", "the list of words that pass is empty")
        return tuple(word for word in words if word is not None)

    def _rule(self, kind: Kind, baseline: str | None) -> tuple[Rule, float]:
        """The rule and the confidence of its bounds."""
        default: Rule = "simple" if kind in ("word", "number") else "bound"
        rule = default if baseline is None else "guarded_rejection"
        if (node := self.section.get("rule")) is not None:
            rule = cast("Rule", self.source.choice(node, self.section.at("rule"), tuple(RULES)) or rule)
        if kind == "word" and rule != "simple":
            self.report("rule", "a word has no uncertainty, so only rule: simple fits it")
        if kind == "grade" and rule in ("guard_band", "guarded_rejection"):
            self.report("rule", "a grade is judged by rule: bound, at its scale's confidence, or rule: simple")
        own = _SETTING.get(rule)
        for key in _SETTING.values():
            if key != own and self.section.get(key) is not None:
                fits = f"it goes with rule: {next(name for name, value in _SETTING.items() if value == key)}"
                self.report(key, f"does not go with rule: {rule}", fits)
        if kind == "grade" and self.section.get("confidence") is not None:
            self.report("confidence", "the grade's scale states the confidence that demonstrates it")
        if own is None:
            return rule, self.confidence
        if own == "confidence":
            return rule, _probability(self.section, own, self.confidence)
        if rule == "guard_band" and self.section.get(own) is None:
            self.report(own, "is missing: the risk of a false accept that this guard band holds, as 0.05")
        return rule, 1.0 - _risk(self.section, own, 1.0 - self.confidence)

    def _share(self, key: str, baseline: str | None) -> float:
        if self.section.get("share") is not None and (not key.endswith(".max") or baseline is not None):
            self.report("share", "is the share of all poses within the limit of a largest error: of keys ending .max")
        return _probability(self.section, "share", DEFAULT_SHARE)

    def _paired(self, baseline: str | None) -> bool | None:
        node = self.section.get("paired")
        if node is None:
            return None
        if baseline is None:
            self.report("paired", "is about the poses of a baseline, and there is none")
        found = self.source.choice(node, self.section.at("paired"), ("true", "false"))
        return None if found is None else found == "true"


def _dimension(kind: Kind | None) -> Dimension | None:
    return "length" if kind == "length" else "angle" if kind == "angle" else None


def _units(kind: Kind | None) -> str:
    dimension = _dimension(kind)
    sizes = UNITS[dimension] if dimension is not None else {**UNITS["length"], **UNITS["angle"]}
    return ", ".join(sizes)


def _example(kind: Kind | None) -> str | None:
    return {"length": "as in 0.2 mm", "angle": "as in 0.1 deg", None: "as in 0.2 mm"}.get(kind)


def _probability(section: YamlSection, key: str, default: float) -> float:
    return _between(section, key, default, 0.5, 1.0)


def _risk(section: YamlSection, key: str, default: float) -> float:
    return _between(section, key, default, 0.0, 0.5)


def _between(section: YamlSection, key: str, default: float, low: float, high: float) -> float:
    """A number between two others, neither of them taken; ``default`` where there is none."""
    node: yaml.Node | None = section.get(key)
    if node is None:
        return default
    value = section.source.number(node, section.at(key))
    if value is not None and not low < value < high:
        section.source.report(node, section.at(key), f"found {value:g}, expected a number between {low:g} and {high:g}")
    return default if value is None else value
