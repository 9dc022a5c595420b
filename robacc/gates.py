"""Gates: named criteria for the figures of a result, the reader of their file, and their evaluation on a result.

Each criterion has an outcome, which the uncertainty of the figure decides, and so has the gate. A result may have
baselines, stored results that it is compared with.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, product
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from robacc.accuracy.error_statistics import Statistic, length_intervals
from robacc.comparison.stored_results import (
    LENGTHS,
    NoValueError,
    difference,
    errors_behind,
    finite_number,
    number_at,
    pair_poses,
    value_at,
)
from robacc.errors import applying, refuse
from robacc.io.yaml_nodes import YamlSection, top_section
from robacc.quantities import UNITS, Dimension, parse_quantity
from robacc.statistics.intervals import (
    ASSURANCE,
    ConfidenceCurve,
    Interval,
    largest_known,
    normal_cdf,
    normal_quantile,
    smallest_sufficient,
    tails,
)

# Keys of results that a criterion may test, in their short form: ``position.p95`` for ``position.p95_m``.

Kind = Literal["length", "angle", "number", "grade", "word"]
"""Kind of a key's value: a quantity in m or rad, a bare number, a grade of a scale, or a word."""

_STAGES = tuple(".".join(stage) + "." for stage in product(("nominal", "before", "after"), ("fitted", "held_out")))
_QUANTITIES: tuple[tuple[str, Kind], ...] = (("position", "length"), ("orientation", "angle"))

_KEYS_OF_QUANTITY: tuple[tuple[str, Kind | None], ...] = (
    *((f"{place}*.{name}", None) for name in LENGTHS for place in ("", "unaligned.", *_STAGES)),
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
    # Keys of an ISO 9283 result depend on the criteria that its data support, those of a history on its coefficients.
    return key in KEYS or re.fullmatch(r"(iso9283|history)(\.[A-Za-z]\w*)+", key) is not None


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


class GateCriterion(NamedTuple):
    """One condition on one figure of a result."""

    name: str
    key: str
    """Short form, as in :data:`robacc.gates.KEYS`."""
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


class Gate(NamedTuple):
    """Named criteria, all of which a result must meet."""

    name: str
    criteria: tuple[GateCriterion, ...]

    @property
    def baselines(self) -> tuple[str, ...]:
        """Return the paths of the stored results to compare with, without repetitions, from the gate file."""
        return tuple(dict.fromkeys(criterion.baseline for criterion in self.criteria if criterion.baseline is not None))


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
    top = top_section(text, file, ("robacc_gate", "name", "confidence", "criteria"))
    top.text("robacc_gate", ("1",), needed=True)
    name, confidence = top.text("name", needed=True), _between(top, "confidence", 0.95)
    criteria: list[GateCriterion] = []
    for section in top.sections(
        "criteria", "criteria", _KEYS, "the list is empty; a gate needs at least one criterion"
    ):
        if (criterion := _criterion(section, confidence)) is not None:
            is_repeated = criterion.name in [earlier.name for earlier in criteria]
            section.report_if((is_repeated, "name", f"two criteria have the name {criterion.name!r}", None))
            criteria.append(criterion)
    top.source.raise_if_any()
    return Gate(name or "", tuple(criteria))


def _criterion(section: YamlSection, default_confidence: float) -> GateCriterion | None:
    """Return a criterion; report its problems and return None if it cannot be read."""
    from yaml import ScalarNode, SequenceNode

    source, n_problems = section.source, len(section.source.problems)
    key, reason = section.text("key", needed=True), section.require("reason")
    if reason is not None and not isinstance(reason, ScalarNode):
        section.report("reason", "expected text: the reason for the limit")
    if key is not None and not is_known(key):
        known = [*KEYS, "iso9283.AP.max", "iso9283.RP.max"]
        similar = [name for name in known if name.startswith(key)] or difflib.get_close_matches(key, known, 1, 0.5)
        examples = "for example position.p95, orientation.max, after.held_out.position.rms, gain, grade, verdict"
        section.report("key", f"no result has the key {key!r}", f"did you mean {similar[0]}?" if similar else examples)
    if key is None or not is_known(key):
        return None
    baseline, kind = section.text("baseline"), KEYS.get(key)
    given = [name for name in ("limit", "at_least", *_SETTING.values(), "share", "paired") if section.get(name)]
    limits = [name for name in given if name in ("limit", "at_least")]
    is_word = kind in ("word", "grade")
    nodes = [section.values["limit"]] if is_word and limits == ["limit"] else []
    is_list = any(isinstance(node, SequenceNode) for node in nodes)
    texts = [source.text(item, section.at("limit")) for node in nodes for item in (node.value if is_list else [node])]
    accepted = tuple(text for text in texts if text is not None)
    # With a baseline, the default question is whether the figure got worse at all.
    limit = None if is_word else 0.0
    if not is_word and limits:
        limit, kind = _limit(section, limits[0], key, baseline)
    kind = kind or "number"
    default = "guarded_rejection" if baseline is not None else "simple" if kind in ("word", "number") else "bound"
    rule = cast("Rule", section.text("rule", RULES) or default)
    setting = _SETTING.get(rule, "")
    words = "the grade to meet" if kind == "grade" else "a list of the words that pass"
    section.report_if(
        (
            len(limits) == 2,
            "at_least",
            "limit (a maximum) and at_least (a minimum) exclude each other",
            "give only one",
        ),
        (
            not is_word and not limits and baseline is None,
            "limit",
            "is missing; give a maximum (limit) or a minimum (at_least)",
            None,
        ),
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
    units = ", ".join(UNITS[expected] if expected else (*UNITS["length"], *UNITS["angle"]))
    wanted = "a number without a unit" if kind == "number" else f"a number with its unit ({units})"
    example = None if kind == "number" else "as in 0.1 deg" if kind == "angle" else "as in 0.2 mm"
    is_other = kind is not None and dimension != expected and (limit, dimension) != (0, None)
    is_signed = baseline is not None or expected is None or key == "gain"
    section.report_if(
        (limit is None or is_other, name, f"expected {wanted}, found {text!r}", example),
        (
            (limit or 0.0) < 0.0 and not (is_other or is_signed),
            name,
            f"{key} is never negative, so no result can meet {text!r}",
            None,
        ),
    )
    return limit, kind or dimension


def _between(section: YamlSection, key: str, default: float, low: float = 0.5, high: float = 1.0) -> float:
    """Return a number in the open interval from ``low`` to ``high``; ``default`` if the key is missing."""
    return section.number(key, lambda value: low < value < high, f"a number between {low:g} and {high:g}", default)


# Bound curve of a figure: for each level, the bound below which the true value lies with that confidence.
#
# Read in the other direction, the curve gives the confidence that the true value lies below a limit: the conformity
# probability of JCGM 106, 7, with the interval's method in place of a prior. The curve passes through the bounds of
# the interval that a result carries, so that a decision by the curve and a decision by the interval agree. Between
# the bounds it is linear in the normal quantile of the level; for a positive figure, its logarithm is.

LEVELS = (0.3, 0.9, 0.99)
"""Confidences of the intervals behind a curve where the errors of every pose are available."""
_EXTRAPOLATION_QUANTILE = 1.2
"""Normal quantile, about 88 %: a curve whose outermost bound lies beyond it may be extrapolated."""
_STEPS = 20


class BoundCurve(NamedTuple):
    """Bounds of a figure, from the lowest level to the highest; empty if no interval exists."""

    z: tuple[float, ...]
    """Normal quantile of each bound's level."""
    bounds: tuple[float, ...]
    """In the figure's unit, non-decreasing."""
    method: str
    why: str | None = None
    """Reason for missing bounds."""
    exact: ConfidenceCurve | None = None
    """Confidence curve of the interval's own method, if known; it takes precedence over interpolation."""

    @classmethod
    def through(cls, intervals: Iterable[Interval], centre: float | None = None) -> "BoundCurve":
        """Return the curve through one-sided and two-sided bounds; ``centre`` is the bound at level 1/2, if known."""
        points: dict[float, float] = {} if centre is None else {0.0: centre}
        method, why, exact = "none", None, None
        for interval in intervals:
            ends = zip(tails(interval.confidence), (interval.lower, interval.upper, interval.upper_bound), strict=True)
            points |= {round(normal_quantile(level), 9): bound for level, bound in ends if bound is not None}
            method, why, exact = interval.method, why or interval.why, interval.curve
        z = sorted(points) if any(points) else []
        # Resampled bounds at neighbouring levels may cross by chance.
        return cls(tuple(z), tuple(accumulate((points[at] for at in z), max)), method, why, exact)

    @property
    def reaches(self) -> tuple[bool, bool]:
        """Return whether the curve has a bound from below, and whether it has one from above."""
        ends = self.z[:1] + self.z[-1:] or (0.0, 0.0)
        return ends[0] <= -_EXTRAPOLATION_QUANTILE, ends[1] >= _EXTRAPOLATION_QUANTILE

    @property
    def positive(self) -> bool:
        """Return whether all bounds are above zero, so that the figure is treated in its logarithm."""
        return bool(self.bounds) and self.bounds[0] > 0.0

    def scale(self, value: float) -> float:
        """Return ``value`` on the scale on which the curve is close to normal."""
        return (math.log(value) if value > 0.0 else -math.inf) if self.positive else value

    def bound(self, level: float) -> float | None:
        """Return the upper bound of the true value at confidence ``level``; None outside the known bounds."""
        z = round(normal_quantile(level), 9)
        if not self.z or not self.z[0] <= z <= self.z[-1]:
            return None
        between = float(np.interp(z, self.z, [*map(self.scale, self.bounds)]))
        return math.exp(between) if self.positive else between

    def below(self, limit: float) -> float | None:
        """Return the confidence that the true value is at or below ``limit``; None if no bound reaches that far."""
        if not self.z:
            return None
        if self.bounds[0] == self.bounds[-1]:
            return float(self.bounds[0] <= limit)
        if self.exact is not None:
            return self.exact.below(limit)
        at, scaled = self.scale(limit), [*map(self.scale, self.bounds)]
        beyond = at - min(max(at, scaled[0]), scaled[-1])
        z = float(np.interp(at, scaled, self.z)) + beyond * (self.z[-1] - self.z[0]) / (scaled[-1] - scaled[0])
        return normal_cdf(z) if beyond == 0.0 or self.reaches[int(beyond > 0.0)] else None

    def standard_error(self, level: float) -> float | None:
        """Return half the distance between the bounds at 1 - ``level`` and ``level`` per normal quantile, scaled.

        If a bound is missing, the distance of the other bound from the median takes its place.
        """
        low, median, high = (self.bound(probability) for probability in (1.0 - level, 0.5, level))
        known = [self.scale(bound) for bound in (low, median, high) if bound is not None]
        quantiles = 1.0 if low is None or high is None else 2.0
        return None if len(known) < 2 else (known[-1] - known[0]) / (quantiles * normal_quantile(level))


def difference_curve(value: float, curve: BoundCurve, baseline: float, baseline_curve: BoundCurve) -> BoundCurve:
    """Return the curve of ``value`` - ``baseline`` for two independent samples.

    Each bound combines the bounds of the two samples by the method of variance estimates recovery, as
    :func:`robacc.statistics.intervals.difference_limits` does.
    """
    points = {
        z: value - baseline + float(np.sign(z)) * math.hypot(bound - value, opposite - baseline)
        for z in (-2.33, -1.96, -1.645, -1.28, -0.67, 0.0, 0.67, 1.28, 1.645, 1.96, 2.33)
        if (bound := curve.bound(normal_cdf(z))) is not None
        and (opposite := baseline_curve.bound(1.0 - normal_cdf(z))) is not None
    }
    why = curve.why or baseline_curve.why
    if not any(points):
        return BoundCurve((), (), "none", why or "the result or the baseline has no interval for this key")
    method = "two independent samples, bounds by the method of variance estimates recovery"
    return BoundCurve(tuple(points), tuple(sorted(points.values())), method, why)


def operating_curve(criterion: GateCriterion, curve: BoundCurve, error: float) -> tuple[tuple[float, float], ...]:
    """Return the probability to pass over the true value, for the same number of poses.

    Args:
        criterion: The criterion, with a limit.
        curve: Bounds of the figure; they set the scale on which the figure is close to normal.
        error: Standard error of the figure on that scale.
    """
    centre = curve.scale(cast("float", criterion.limit))
    if not math.isfinite(centre) or error <= 0.0:
        return ()
    z, sign = normal_quantile(criterion.confidence), -1.0 if criterion.at_least else 1.0
    shift = {"bound": z, "guard_band": z, "simple": 0.0, "guarded_rejection": -z}[criterion.rule]
    # Distances of the true value above the limit, in standard errors.
    return tuple(
        (math.exp(place) if curve.positive else place, normal_cdf(-sign * distance - shift))
        for k in range(_STEPS + 1)
        for distance in [5.0 * (2.0 * k / _STEPS - 1.0)]
        for place in [centre + distance * error]
    )


Outcome = Literal["pass", "fail", "inconclusive", "not_evaluated"]

MOST_POSES = 10_000_000


Evaluation = dict[str, Any]
"""Outcome of a criterion with its figure, bounds, margin and probability, with the keys of the result."""


def evaluated(criterion: GateCriterion, dimension: str | None = None, **known: Any) -> Evaluation:
    """Return an evaluation with all keys of the result; ``known`` are the values of some of them.

    ``dimension`` is that of the value, its bounds and its limit: length (m), angle (rad), number, grade or word. The
    bounds are one-sided, each at the criterion's confidence. The margin is the distance from the bound or value that
    the rule tests to the limit, negative beyond the limit. The operating curve has true values and the probability to
    pass at each, for the same number of poses.
    """
    grades = criterion.accepted[:1] if criterion.kind == "grade" else ()
    return {
        "name": criterion.name,
        "key": criterion.key,
        "outcome": "not_evaluated",
        "why": None,
        "unit": {"length": "m", "angle": "rad"}.get(dimension or criterion.kind, "1"),
        "value": None,
        "limit": next(iter(grades), list(criterion.accepted) or criterion.limit),
        "at_least": criterion.at_least,
        "rule": criterion.rule,
        "rule_text": RULES[criterion.rule],
        "confidence": None if criterion.rule == "simple" else criterion.confidence,
        "share": None,
        "lower_bound": None,
        "upper_bound": None,
        "margin": None,
        "conformity_probability": None,
        "method": None,
        "n_poses": None,
        "poses_to_decide": None,
        "poses_to_decide_if_value_is_true": None,
        "baseline": None if criterion.baseline is None else {"file": criterion.baseline, "value": None},
        "instrument_uncertainty_over_limit": None,
        "reason": criterion.reason,
        "warnings": (),
        "operating_curve_over": "value",
        "operating_curve": (),
        **known,
    }


def decide(criterion: GateCriterion, value: float, curve: BoundCurve | None, n: int | None) -> Evaluation:
    """Decide on a figure by its bounds; return what is found.

    Args:
        criterion: The criterion, with a limit.
        value: Value of the figure.
        curve: Bounds of the figure; None if the result has no interval for it.
        n: Number of poses behind the figure.
    """
    limit, sign, rule = cast("float", criterion.limit), -1.0 if criterion.at_least else 1.0, criterion.rule

    def margin(number: float) -> float:
        return sign * (limit - number)

    outcome: Outcome = "pass" if margin(value) >= 0.0 else "fail"
    if curve is None:
        lacks = (
            None if rule == "simple" else f"the result has no interval for {criterion.key}, which rule: {rule} needs"
        )
        return {
            "outcome": "not_evaluated" if lacks else outcome,
            "why": lacks,
            "margin": None if lacks else margin(value),
        }
    low, high = curve.bound(1.0 - criterion.confidence), curve.bound(criterion.confidence)
    # Bounds at a low confidence may exclude a biased value, such as a sample's percentile. Nothing passes with a value
    # beyond the limit, and nothing fails with a value within it.
    low, high = None if low is None else min(low, value), None if high is None else max(high, value)
    adverse, favourable = (low, high) if criterion.at_least else (high, low)
    tested = {"simple": value, "guarded_rejection": favourable}.get(rule, adverse)
    is_met, why = tested is not None and margin(tested) >= 0.0, None
    outcome = "pass" if is_met else "inconclusive"
    if tested is not None and not is_met and rule != "bound":
        outcome = "fail"
        if rule == "guard_band" and margin(value) >= 0.0:
            why = "the value meets the limit but lies within the guard band"
    elif not is_met and favourable is not None and margin(favourable) < 0.0:
        outcome, tested = "fail", favourable if tested is None else tested
    elif tested is None:
        percent = f"{100 * criterion.confidence:g} %"
        unreached = f"the result's interval does not reach {percent}; compute the result again at {percent} confidence"
        why = curve.why or (unreached if any(curve.reaches) else "there are too few poses for an interval")
    error, below = curve.standard_error(criterion.confidence if criterion.confidence > 0.6 else 0.9), curve.below(limit)
    assured = if_true = None
    if outcome == "inconclusive" and n is not None and error is not None and error > 0.0 and below is not None:
        z = normal_quantile(criterion.confidence)
        # With fewer poses, no order statistic bounds a 95th percentile.
        of_percentile = math.ceil(math.log(1.0 - criterion.confidence) / math.log(0.95))
        fewest = max(n + 1, of_percentile if criterion.key.endswith(".p95") else 0)
        # The confidence at the limit has the estimate's bias, and its standard error on the side of the limit.
        if 0.0 < below < 1.0 and (assured := poses_to_decide(abs(normal_quantile(below)), z, n)) is not None:
            assured = max(assured, fewest)
        # The bound lies z standard errors from the estimate, and the estimate scatters by one standard error. The
        # distance from the value to the limit is on the scale on which the figure is close to normal.
        scaled = abs(curve.scale(limit) - curve.scale(value))
        needed = math.inf if scaled == 0.0 else n * ((z + normal_quantile(ASSURANCE)) * error / scaled) ** 2
        if_true = None if needed > MOST_POSES else max(math.ceil(needed), fewest)
    return {
        "outcome": outcome,
        "why": why,
        "lower_bound": low,
        "upper_bound": high,
        "margin": None if tested is None else margin(tested),
        "conformity_probability": None if below is None else 1.0 - below if criterion.at_least else below,
        "method": curve.method,
        "poses_to_decide": assured,
        "poses_to_decide_if_value_is_true": if_true,
        "operating_curve": () if error is None else operating_curve(criterion, curve, error),
    }


def poses_to_decide(distance: float, z: float, n: int) -> int | None:
    """Return the smallest number of poses, including the ``n`` measured, that decides with :data:`ASSURANCE`.

    The estimate from m n poses scatters about the present estimate with (1 - 1/m) of the present variance: the poses
    to come add scatter, and the truth is as uncertain as the present interval says. It decides if it is more than
    z / sqrt(m) from the limit (all in present standard errors). The mean of the power over the distribution of the
    truth is called assurance (A. O'Hagan, J. W. Stevens, M. J. Campbell, "Assurance in clinical trial design",
    Pharmaceutical Statistics 4, 2005).

    Args:
        distance: Distance from the estimate to the limit, in present standard errors.
        z: Normal quantile of the bounds' confidence.
        n: Number of poses measured.
    """

    def decides(poses: int) -> bool:
        if poses <= n:
            return False
        ratio = poses / n
        scatter_std, reach = math.sqrt(1.0 - 1.0 / ratio), z / math.sqrt(ratio)
        probability = normal_cdf((distance - reach) / scatter_std) + normal_cdf((-distance - reach) / scatter_std)
        return probability >= ASSURANCE

    return smallest_sufficient(decides, 2.0 * n, most=MOST_POSES)


# Decision on a largest error, which no sample bounds from above: by the share of all poses within the limit.
#
# If a share s of all poses lies within the limit, all of n poses do so with probability s^n. If none of n poses is
# beyond the limit, s is therefore at least (1 - c)^(1/n) with confidence c: Wilks' one-sided tolerance limit (S. S.
# Wilks, "Determination of sample sizes for setting tolerance limits", Annals of Mathematical Statistics 12, 1941). One
# pose beyond the limit shows that the largest error is beyond it.


def decide_largest(criterion: GateCriterion, value: float, n: int) -> Evaluation:
    """Decide on the largest error of ``n`` poses against an upper limit; return what is found."""
    share, margin = criterion.share, cast("float", criterion.limit) - value
    n_needed = math.ceil(math.log(1.0 - criterion.confidence) / math.log(share))
    claim = f"that {100 * share:g} % of all poses are within the limit"
    curve = tuple((1.0 - k * 0.01, (1.0 - k * 0.01) ** n if n >= n_needed else 0.0) for k in range(_STEPS + 1))
    # The rules differ in their demands on poses that were not measured; one pose beyond the limit decides.
    probability = 0.0 if margin < 0.0 else 1.0 - share**n
    outcome: Outcome = "fail" if margin < 0.0 else "pass"
    why = n_to_decide = None
    if margin >= 0.0 and n < n_needed and criterion.rule != "guarded_rejection":
        outcome = "fail" if criterion.rule == "guard_band" else "inconclusive"
        why = f"{n} poses within the limit show {claim} with a confidence of only {100 * probability:.3g} %"
        n_to_decide = n_needed if outcome == "inconclusive" else None
    return {
        "outcome": outcome,
        "why": why,
        "share": share,
        "lower_bound": value,
        "margin": margin,
        "conformity_probability": probability,
        "method": f"confidence {claim} (Wilks)",
        "poses_to_decide": n_to_decide,
        "poses_to_decide_if_value_is_true": n_to_decide,
        "operating_curve_over": "share_within_limit",
        "operating_curve": curve,
    }


# Figures of a result: the value, its dimension, and the bounds that the result or its poses give.


class GateFigure(NamedTuple):
    """One number of a result."""

    value: float
    dimension: str
    """length (m), angle (rad) or number."""
    curve: BoundCurve | None
    """None if the result has no interval for the figure."""
    n: int | None
    """Number of commanded poses."""


def figure_at(document: Mapping[str, Any], key: str, confidence: float) -> GateFigure:
    """Return the number of a key, with its curve; ``confidence`` is the level that a recomputed curve includes.

    Raises:
        NoValueError: The result has no number there.
    """
    (number, interval), holder, name = number_at(document, key)
    statistic = key.rpartition(".")[2]
    counts = [holder.get("n_commanded_poses"), holder.get("n_poses"), document.get("n_poses")]
    n = next((int(count) for count in map(finite_number, counts) if count is not None), None)
    # The 95th percentile of a small sample is biased low: two bounds locate the median better than the value.
    ends = () if interval is None or interval.lower is None else (interval.upper_bound, interval.upper)
    is_bounded = any(end is not None for end in ends)
    centre = None if is_bounded and statistic == "p95" else number
    curve = None if interval is None else BoundCurve.through([interval], centre)
    errors = errors_behind(document, key.rpartition(".")[0]) if statistic in ("rms", "mean_error", "p95") else None
    # With more poses, the stored interval is as good as a recomputed one and costs nothing.
    if errors is not None and errors.groups.size <= 20_000:
        n, seed = errors.n_groups, document.get("seed") or 0
        statistics = length_intervals(
            errors.vectors, _levels(confidence), groups=errors.groups, share=errors.share, seed=seed
        )
        curve = BoundCurve.through(by_name[cast("Statistic", statistic)] for by_name in statistics)
    return GateFigure(number, {"m": "length", "rad": "angle"}.get(name.rpartition("_")[2], "number"), curve, n)


def _levels(confidence: float) -> list[float]:
    """Return the confidences of the intervals behind a curve that has bounds at ``confidence``."""
    return sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})


# Difference between a figure of a result and the same figure of a baseline: paired where the poses are the same.


def difference_to_baseline(
    document: Mapping[str, Any], baseline: Mapping[str, Any], criterion: GateCriterion
) -> tuple[GateFigure, float]:
    """Return the difference, result minus baseline, and the baseline's value.

    Raises:
        NoValueError: The result or the baseline has no such number, or their poses cannot be paired as required.
    """
    key, confidence = criterion.key, criterion.confidence
    figure = figure_at(document, key, confidence)
    try:
        reference = figure_at(baseline, key, confidence)
    except NoValueError as error:
        raise NoValueError(f"in the baseline, {error}") from None
    (place, _, statistic), paired = key.rpartition("."), criterion.paired
    sets = [errors_behind(each, place) if statistic in LENGTHS else None for each in (baseline, document)]
    listed = [errors for errors in sets if errors is not None]
    missing = "paired: true needs the error of every pose, which the result or the baseline does not list"
    refuse(
        (figure.dimension != reference.dimension, f"{key} has different units in the result and in the baseline"),
        (paired and len(listed) < 2, missing),
        error=NoValueError,
    )
    if len(listed) == 2 and paired is not False:
        before, after = listed
        sizes, pair = (after.groups.size, before.groups.size), pair_poses(before, after)
        is_whole = pair is not None and pair[0].n_groups == before.n_groups == after.n_groups
        other = "paired: true needs the same poses, but the result has {} and the baseline has {}".format(*sizes)
        refuse((paired and not is_whole and sizes[0] != sizes[1], other), error=NoValueError)
        if is_whole or paired:
            pair = pair if pair is not None and is_whole else (before, replace(after, groups=before.groups))
            seed, levels = document.get("seed") or 0, _levels(confidence)
            changes = [difference(statistic, *pair, paired=True, confidence=level, seed=seed) for level in levels]
            curve = BoundCurve.through(each.interval for each in changes)
            return GateFigure(changes[0].value, figure.dimension, curve, after.n_groups), reference.value
    change = (
        None
        if figure.curve is None or reference.curve is None
        else difference_curve(figure.value, figure.curve, reference.value, reference.curve)
    )
    return GateFigure(figure.value - reference.value, figure.dimension, change, figure.n), reference.value


MOST_OF_TOLERANCE = 0.25
"""Share of the limit above which the instrument's expanded uncertainty gives a warning: four to one, as ANSI/NCSL
Z540.3 and the practice of ISO 14253-2 ask."""
_WORST_FIRST: tuple[Outcome, ...] = ("fail", "not_evaluated", "inconclusive", "pass")


@dataclass(frozen=True, slots=True)
class GateOutcome:
    """Evaluation of every criterion of a gate on one result."""

    gate: Gate
    evaluations: Sequence[Evaluation]

    @property
    def outcome(self) -> Outcome:
        """Return fail if one criterion fails, pass if all criteria pass."""
        return min((evaluation["outcome"] for evaluation in self.evaluations), key=_WORST_FIRST.index)

    @property
    def exit_status(self) -> int:
        """Return the exit status of the command: 0 pass, 4 fail, 5 undecided."""
        return {"pass": 0, "fail": 4, "inconclusive": 5, "not_evaluated": 5}[self.outcome]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings of all criteria, without repetitions."""
        return tuple(dict.fromkeys(text for evaluation in self.evaluations for text in evaluation["warnings"]))


def evaluate_gate(gate: Gate, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]) -> GateOutcome:
    """Evaluate a gate on a result.

    Args:
        gate: The criteria.
        document: The JSON document of the result.
        baselines: The documents of ``gate.baselines``, by their paths in the gate.
    """
    evaluations = []
    for criterion in gate.criteria:
        try:
            evaluations.append(_evaluate(criterion, document, baselines))
        except NoValueError as error:
            evaluations.append(evaluated(criterion, why=str(error)))
    return GateOutcome(gate, evaluations)


def _evaluate(
    criterion: GateCriterion, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]
) -> Evaluation:
    if criterion.kind == "word":
        word = value_at(document, criterion.key)[0]
        word = str(word).lower() if isinstance(word, bool | np.bool_) else word
        refuse((not isinstance(word, str), f"the result's {criterion.key} is not a word"), error=NoValueError)
        after, noise = document.get("after"), document.get("noise") or {}
        # An accepted verdict of a trace is inconclusive without held-out poses to confirm it.
        is_verdict = criterion.key == "verdict" and word in criterion.accepted
        is_unconfirmed = is_verdict and isinstance(after, Mapping) and after.get("held_out") is None
        unknown = (
            "verdict: the measurement noise is unknown (no sigma columns, no repeated poses), so the verdict "
            "says that no structure remains, not how large the remaining error is; add a limit on "
            "after.held_out.position.p95",
        )
        return evaluated(
            criterion,
            outcome="inconclusive" if is_unconfirmed else "pass" if word in criterion.accepted else "fail",
            why="the result has no held-out poses to confirm the verdict" if is_unconfirmed else None,
            value=word,
            warnings=unknown if is_verdict and not is_unconfirmed and noise.get("source") == "residual" else (),
        )
    if criterion.kind == "grade":
        return _evaluate_grade(criterion, document)
    compared, ratio = None, None
    if criterion.baseline is not None:
        figure, value = difference_to_baseline(document, baselines[criterion.baseline], criterion)
        compared = {"file": criterion.baseline, "value": value}
    else:
        figure = figure_at(document, criterion.key, criterion.confidence)
        stated = document.get("noise")
        stated = stated if isinstance(stated, Mapping) and stated.get("source") != "residual" else {}
        noise_std = finite_number(stated.get({"length": "position_m", "angle": "orientation_rad"}.get(criterion.kind)))
        # Coverage factor of the instrument's expanded uncertainty (JCGM 100, 6.2).
        ratio = None if noise_std is None or not criterion.limit else 2.0 * noise_std / abs(criterion.limit)
    other = (
        f"the limit has the dimension {criterion.kind}, but {criterion.key} of the result has the dimension "
        f"{figure.dimension}"
    )
    refuse((criterion.limit != 0.0 and figure.dimension != criterion.kind, other), error=NoValueError)
    decision = _decide_figure(criterion, figure) | {"baseline": compared, "instrument_uncertainty_over_limit": ratio}
    return evaluated(criterion, figure.dimension, **decision, warnings=_warnings(criterion, ratio))


def _decide_figure(criterion: GateCriterion, figure: GateFigure) -> Evaluation:
    """Return the decision on a figure, of a largest error by the share of all poses within the limit."""
    has_bounds = figure.curve is not None and bool(figure.curve.bounds)
    # The largest value of an ISO 9283 criterion covers its few commanded poses, which are the whole population.
    is_largest = criterion.key.endswith(".max") and criterion.key in KEYS and criterion.baseline is None
    decision = (
        decide(criterion, figure.value, figure.curve, figure.n)
        if figure.n is None or has_bounds or not is_largest or criterion.at_least or criterion.rule == "simple"
        else decide_largest(criterion, figure.value, figure.n)
    )
    return {**decision, "value": figure.value, "n_poses": figure.n}


def _evaluate_grade(criterion: GateCriterion, document: Mapping[str, Any]) -> Evaluation:
    """Evaluate a grade: position and orientation must both meet its limits, each at the scale's own confidence.

    Each bound is within its limit at the full confidence, so both are together (an intersection-union test, R. L.
    Berger, Technometrics 24, 1982); the probability is the smaller of the two.
    """
    grade, required = value_at(document, "grade")[0], criterion.accepted[0]
    steps = {str(step.get("grade")): step for step in grade.get("steps") or ()}
    refuse(
        (not steps, "the result's grade does not list the steps of its scale"),
        (
            required not in steps,
            f"the scale {grade.get('scale')} has no grade {required}; its grades are {', '.join(steps)}",
        ),
        error=NoValueError,
    )
    confidence = grade.get("confidence") or criterion.confidence
    limits = {"position": steps[required].get("position_m"), "orientation": steps[required].get("orientation_rad")}
    criteria = [
        criterion._replace(key=f"{quantity}.{grade.get('statistic')}", limit=limit, confidence=confidence)
        for quantity, limit in limits.items()
        if limit is not None and document.get(quantity)
    ]
    own = [_decide_figure(each, figure_at(document, each.key, confidence)) for each in criteria]
    outcome: Outcome = min((each["outcome"] for each in own), key=_WORST_FIRST.index, default="pass")
    deciding = [each for each in own if each["outcome"] == outcome]
    reasons = "; ".join(dict.fromkeys(each["why"] for each in deciding if each.get("why"))) or None
    is_explained = outcome == "fail" and isinstance(grade.get("reason"), str)
    probabilities = [each["conformity_probability"] for each in own if each.get("conformity_probability") is not None]
    undecided = deciding if outcome == "inconclusive" else []
    return evaluated(
        criterion,
        outcome=outcome,
        why=grade["reason"].partition(". ")[0] if is_explained else reasons,
        conformity_probability=min(probabilities) if probabilities and len(probabilities) == len(own) else None,
        method=next((each["method"] for each in own if each.get("method")), None),
        poses_to_decide=largest_known([each["poses_to_decide"] for each in undecided]),
        poses_to_decide_if_value_is_true=largest_known(
            [each["poses_to_decide_if_value_is_true"] for each in undecided]
        ),
        value=str(grade.get("grade")),
        n_poses=own[0]["n_poses"] if own else None,
    )


def _warnings(criterion: GateCriterion, ratio: float | None) -> tuple[str, ...]:
    key, share = criterion.key, 0.0 if ratio is None else ratio
    texts = applying(
        (
            share > MOST_OF_TOLERANCE,
            f"the instrument's expanded uncertainty (k = 2) is {100 * share:.0f} % of the limit, more than the "
            f"recommended {100 * MOST_OF_TOLERANCE:.0f} %",
        ),
        (
            ".fitted." in key and not key.startswith("nominal."),
            f"{key} is computed on the calibration poses and is too optimistic; use "
            f"{key.replace('.fitted.', '.held_out.')}",
        ),
    )
    return tuple(f"{criterion.name}: {text}" for text in texts)
