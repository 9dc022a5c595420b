"""Gates, their criteria and the keys that these may test, and the reader of a gate file."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Literal, cast

from robacc.quantities import UNITS, Dimension, parse_quantity

if TYPE_CHECKING:
    from robacc.io.yaml_nodes import YamlSection


# Keys of results that a criterion may test, in their short form: ``position.p95`` for ``position.p95_m``.

Kind = Literal["length", "angle", "number", "grade", "word"]
"""Kind of a key's value: a quantity in m or rad, a bare number, a grade of a scale, or a word."""

_STATISTICS = ("rms", "mean_error", "p95", "max")
_STAGES = tuple(".".join(stage) + "." for stage in product(("nominal", "before", "after"), ("fitted", "held_out")))
_QUANTITIES: tuple[tuple[str, Kind], ...] = (("position", "length"), ("orientation", "angle"))

_KEYS_OF_QUANTITY: tuple[tuple[str, Kind | None], ...] = (
    *((f"{place}*.{name}", None) for name in _STATISTICS for place in ("", "unaligned.", *_STAGES)),
    *((f"*.{name}", None) for name in ("radius95.zero_mean.radius", "radius95.fitted_mean.radius", "max_radius95")),
    ("*.n_commanded_poses", "number"),
    *((key, None) for key in ("*.worst.rms", "*.worst.radius95", "against.measured.*_rms", "noise.*")),
    ("coverage.*.share", "number"),
    *((f"correction.*.{name}", None) for name in ("rms", "max")),
    *(
        (f"expected.{stage}.*.{name}", None)
        for stage, name in product(("before", "after"), ("rms", "max", "expected_rms", "largest_bound95"))
    ),
)
"""Keys of position and orientation, which take the place of the star; None is the kind of the quantity."""
KEYS: dict[str, Kind] = {
    **{"grade": "grade", "gain": "length", "n_poses": "number"},
    **{key.replace("*", name): kind or own for name, own in _QUANTITIES for key, kind in _KEYS_OF_QUANTITY},
    **dict.fromkeys(("n_targets", "n_corrected", "n_refused"), "number"),
    **dict.fromkeys(("verdict", "against.verdict", "grade.demonstrated", "unexplained.structured"), "word"),
    **dict.fromkeys(("unexplained.rms", "unexplained.noise_rms"), "length"),
    **dict.fromkeys(("unexplained.p_value", "noise.residual_over_noise", "identifiability.condition_number"), "number"),
}
"""Kind of every key except those of ISO 9283 results, whose unit the result states."""
LARGER_IS_BETTER = frozenset(
    {"gain", "n_poses", "n_corrected"}
    | {f"{q}.n_commanded_poses" for q, _ in _QUANTITIES}
    | {f"coverage.{q}.share" for q, _ in _QUANTITIES}
)


def is_known(key: str) -> bool:
    """Return whether the result of a command can have the key."""
    # Keys of an ISO 9283 result, which depend on the criteria that its data support.
    return key in KEYS or re.fullmatch(r"iso9283(\.[A-Za-z]\w*)+", key) is not None


def nearest_key(key: str) -> str:
    """Return a hint with the known key most similar to an unknown key, or with examples of keys."""
    known = [*KEYS, "iso9283.AP.max", "iso9283.RP.max"]
    similar = [name for name in known if name.startswith(key)] or difflib.get_close_matches(key, known, 1, 0.5)
    examples = "for example position.p95, orientation.max, after.held_out.position.rms, gain, grade, verdict"
    return f"did you mean {similar[0]}?" if similar else examples


# Gates and their criteria: a limit, a decision rule and the reason for the limit.

Rule = Literal["bound", "simple", "guard_band", "guarded_rejection"]
RULES: dict[Rule, str] = {
    "bound": (
        "ISO 14253-1: pass if the confidence bound meets the limit, fail if the opposite bound is beyond the limit, "
        "otherwise inconclusive"
    ),
    "simple": (
        "JCGM 106, 8.2: pass if the value itself meets the limit; at the limit, the decision is wrong half of the time"
    ),
    "guard_band": (
        "JCGM 106, 8.3.2, guarded acceptance: pass if the risk of a false accept is at most the stated risk, "
        "otherwise fail"
    ),
    "guarded_rejection": (
        "JCGM 106, 8.3.3: fail only if the risk of a false reject is at most the stated risk, otherwise pass"
    ),
}


@dataclass(frozen=True, slots=True)
class GateCriterion:
    """One condition on one figure of a result."""

    name: str
    key: str
    """Short form, as in :data:`robacc.gates.gate_file.KEYS`."""
    kind: Kind
    limit: float | None
    """In m, rad or as a bare number; limit of the difference if there is a baseline. None if ``accepted`` applies."""
    accepted: tuple[str, ...]
    """The words that pass, or the one grade to meet."""
    at_least: bool
    """The limit is a minimum, not a maximum."""
    rule: Rule
    confidence: float
    """Confidence of each one-sided bound; one minus the stated risk for the guarded rules."""
    share: float
    """Share of all poses that must lie within the limit of a largest error."""
    baseline: str | None
    """A stored result to compare with, by its path from the gate file."""
    paired: bool | None
    """Whether both results list the same poses in the same order; None: only if the results show it."""
    reason: str
    """Reason for the limit, in the words of the gate's author."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Named criteria, all of which a result must meet."""

    name: str
    criteria: tuple[GateCriterion, ...]

    @property
    def baselines(self) -> tuple[str, ...]:
        """Return the paths of the stored results to compare with, without repetitions, from the gate file."""
        return tuple(dict.fromkeys(criterion.baseline for criterion in self.criteria if criterion.baseline is not None))


VERSION = "1"
_KEYS = (
    *("name", "key", "limit", "at_least", "rule", "confidence", "false_accept_risk", "false_reject_risk"),
    *("share", "baseline", "paired", "reason"),
)
_SETTING: dict[Rule, str] = {
    "bound": "confidence",
    "guard_band": "false_accept_risk",
    "guarded_rejection": "false_reject_risk",
}
"""Key that sets the confidence or the risk of each rule."""


def load_gate(text: str, file: str) -> Gate:
    """Read a gate.

    Args:
        text: Content of the YAML file.
        file: Its name, for messages.

    Raises:
        InputError: Every problem, each with its line and key.
    """
    from robacc.io.yaml_nodes import top_section

    top = top_section(text, file, ("robacc_gate", "name", "confidence", "criteria"))
    top.text("robacc_gate", (VERSION,), needed=True)
    name, confidence = top.text("name", needed=True), _between(top, "confidence", 0.95)
    criteria: list[GateCriterion] = []
    for section in top.sections(
        "criteria", "criteria", _KEYS, "the list is empty; a gate needs at least one criterion"
    ):
        criterion = _criterion(section, confidence)
        if criterion is None:
            continue
        if criterion.name in [earlier.name for earlier in criteria]:
            section.report("name", f"two criteria have the name {criterion.name!r}")
        criteria.append(criterion)
    top.source.finish()
    return Gate(name or "", tuple(criteria))


def _criterion(section: YamlSection, default_confidence: float) -> GateCriterion | None:
    """Return a criterion; report its problems and return None if it cannot be read."""
    from yaml import ScalarNode, SequenceNode

    source, n_problems = section.source, len(section.source.problems)
    key, reason = section.text("key", needed=True), section.require("reason")
    if reason is not None and not isinstance(reason, ScalarNode):
        section.report("reason", "expected text: the reason for the limit")
    if key is not None and not is_known(key):
        section.report("key", f"no result has the key {key!r}", nearest_key(key))
    if key is None or not is_known(key):
        return None
    baseline, kind = section.text("baseline"), KEYS.get(key)
    given = [name for name in ("limit", "at_least", *_SETTING.values(), "share", "paired") if section.get(name)]
    limits = [name for name in given if name in ("limit", "at_least")]
    accepted: tuple[str, ...] = ()
    limit, is_word, is_list = None, kind in ("word", "grade"), False
    if is_word and limits == ["limit"]:
        node = section.values["limit"]
        is_list = isinstance(node, SequenceNode)
        texts = [source.text(item, section.at("limit")) for item in (node.value if is_list else [node])]
        accepted = tuple(text for text in texts if text is not None)
    elif not is_word and limits:
        limit, kind = _limit(section, limits[0], key, baseline)
    elif not is_word:
        limit = 0.0  # with a baseline, the default question is whether the figure got worse at all
    kind = kind or "number"
    default: Rule = "simple" if kind in ("word", "number") else "bound"
    rule = cast("Rule", section.text("rule", RULES) or ("guarded_rejection" if baseline is not None else default))
    setting = _SETTING.get(rule, "")
    words = "the grade to meet" if kind == "grade" else "a list of the words that pass"
    missing = "is missing; give a maximum (limit) or a minimum (at_least)"
    mistakes: tuple[tuple[bool, str, str, str | None], ...] = (
        (
            len(limits) == 2,
            "at_least",
            "limit (a maximum) and at_least (a minimum) exclude each other",
            "give only one",
        ),
        (not is_word and not limits and baseline is None, "limit", missing, None),
        (
            is_word and baseline is not None,
            "baseline",
            "only numbers can be compared with a baseline; the value of this key is a word",
            None,
        ),
        (is_word and limits != ["limit"], "limit", f"expected {words}", None),
        (is_list and kind == "grade", "limit", "expected one grade (better grades meet it too), found a list", None),
        (is_list and kind == "word" and not accepted, "limit", "the list of words that pass is empty", None),
        (kind == "word" and rule != "simple", "rule", "a word has no uncertainty; use rule: simple", None),
        (
            kind == "grade" and rule in ("guard_band", "guarded_rejection"),
            "rule",
            "a grade takes rule: bound, at the confidence of its scale, or rule: simple",
            None,
        ),
        *(
            (name in given and name != setting, name, f"does not apply to rule: {rule}", f"it belongs to rule: {other}")
            for other, name in _SETTING.items()
        ),
        (
            kind == "grade" and "confidence" in given,
            "confidence",
            "the scale of the grade sets the confidence; remove this key",
            None,
        ),
        (
            rule == "guard_band" and setting not in given,
            setting,
            "is missing; give the accepted risk of a false accept, as in 0.05",
            None,
        ),
        (
            "share" in given and (not key.endswith(".max") or baseline is not None),
            "share",
            "applies only to a largest error (a key ending in .max) without a baseline",
            None,
        ),
        ("paired" in given and baseline is None, "paired", "applies only with a baseline", None),
    )
    for applies, name, message, fix in mistakes:
        if applies:
            section.report(name, message, fix)
    confidence = _between(section, "confidence", default_confidence) if rule == "bound" else default_confidence
    if rule in ("guard_band", "guarded_rejection"):
        confidence = 1.0 - _between(section, setting, 1.0 - default_confidence, 0.0, 0.5)
    # Share of all poses that must lie within the limit of a largest error.
    share, paired = _between(section, "share", 0.95), section.text("paired", ("true", "false"))
    if len(source.problems) > n_problems or reason is None:
        return None
    return GateCriterion(
        name=section.text("name") or key,
        key=key,
        kind=kind,
        limit=limit,
        accepted=accepted,
        at_least=not is_word and (limits == ["at_least"] or (not limits and key in LARGER_IS_BETTER)),
        rule=rule,
        confidence=confidence,
        share=share,
        baseline=baseline,
        paired=None if paired is None else paired == "true",
        reason=" ".join(reason.value.split()),
    )


def _limit(section: YamlSection, name: str, key: str, baseline: str | None) -> tuple[float | None, Kind | None]:
    """Return the limit under ``name`` in m, rad or as a bare number, and its kind; report one that does not fit."""
    text, kind = section.text(name), KEYS.get(key)
    if text is None:
        return None, kind
    expected: Dimension | None = kind if kind == "length" or kind == "angle" else None
    limit, dimension = parse_quantity(text) or (None, None)
    if limit is None or (kind is not None and dimension != expected and (limit, dimension) != (0, None)):
        units = ", ".join(UNITS[expected] if expected else (*UNITS["length"], *UNITS["angle"]))
        wanted = "a number without a unit" if kind == "number" else f"a number with its unit ({units})"
        example = None if kind == "number" else "as in 0.1 deg" if kind == "angle" else "as in 0.2 mm"
        section.report(name, f"expected {wanted}, found {text!r}", example)
    elif limit < 0 and baseline is None and expected is not None and key != "gain":
        section.report(name, f"{key} is never negative, so no result can meet {text!r}")
    return limit, kind or dimension


def _between(section: YamlSection, key: str, default: float, low: float = 0.5, high: float = 1.0) -> float:
    """Return a number in the open interval from ``low`` to ``high``; ``default`` if the key is missing."""
    return section.number(key, lambda value: low < value < high, f"a number between {low:g} and {high:g}", default)
