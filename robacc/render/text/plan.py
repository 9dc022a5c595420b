"""Plan of a measurement as a table, and the comments of its CSV."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.planning.campaign import CampaignPlan
from robacc.planning.collisions import LinkCollisions
from robacc.planning.expected import ExpectedAccuracy, ExpectedCoefficient, Sufficiency
from robacc.planning.power import Detectability, ExpectedLimit, ExpectedPower, InseparablePair
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import (
    BLANK,
    IN_MM,
    TextLine,
    columns,
    fixed,
    heading,
    items,
    table_unit,
    three_digits,
    wrapped,
)

_LISTED_PAIRS = 8
PURPOSES = {
    "calibrate": "calibration",
    "trace": "trace of causes",
    "acceptance": "acceptance",
    "health": "health check",
}


def plan_comments(plan: CampaignPlan) -> list[str]:
    """Return the comment lines above the columns of the visits."""
    comments = [
        f"Planned by robacc plan for {PURPOSES[plan.settings.purpose]} of {plan.robot.name}: "
        f"{plan.chosen.size} poses, {len(plan.route.roles)} visits in this order; nothing was measured.",
        "Drive straight from row to row, and add x, y, z (and orientation) as measured; dir_ and speed_ are those of "
        "the moves from row to row.",
        "Check every pose for collisions before you send it.",
    ]
    if plan.payload_blocks:
        comments.insert(1, f"Payloads, each mounted once: {_payloads(plan)}.")
    return comments


def validation_comments(plan: CampaignPlan) -> list[str]:
    """Return the comment lines above the columns of the validation poses."""
    return [
        f"Validation poses planned by robacc plan for {plan.robot.name}; nothing was measured.",
        "Use them only to check a fit (`holdout`), never in the fit.",
    ]


def draw_plan(plan: CampaignPlan, stream: TextIO) -> None:
    """Write the plan's tables to ``stream``."""
    write_lines(plan_lines(plan, width_of(stream)), stream)


def plan_lines(plan: CampaignPlan, width: int) -> Iterator[TextLine]:
    """Yield the lines of the report."""
    count, visits = plan.chosen.size, len(plan.route.roles)
    title = f"Plan for the {PURPOSES[plan.settings.purpose]} of {plan.robot.name}: {count} poses, {visits} visits"
    yield heading(title)
    yield from items(_facts(plan), width)
    if plan.sufficiency is not None:
        verdict = "Enough" if plan.sufficiency.enough else f"Not enough: measure the next {plan.chosen.size}"
        yield from (BLANK, heading(verdict), *items(_sufficiency(plan.sufficiency), width))
    if plan.candidates.excluded:
        rows = [(entry.reason, str(entry.count), str(entry.alone)) for entry in plan.candidates.excluded]
        yield from (BLANK, *columns(("candidates excluded by", "count", "by this alone"), rows))
    if plan.needed:
        yield from (BLANK, *_needed(plan))
    if plan.accuracy is not None:
        yield from (BLANK, *_accuracy(plan.accuracy, plan.sufficiency is not None, width))
    if plan.worth is not None and plan.worth.new_poses is not None:
        yield from items((f"for the same number of measurements: {plan.worth.verdict}",), width)
    if plan.settings.purpose in ("calibrate", "health"):
        yield from (BLANK, *_coefficients(plan.coefficients, width))
    if plan.correlations and plan.settings.purpose == "calibrate":
        pairs = [f"{pair.first} and {pair.second} ({pair.value:+.2f})" for pair in plan.correlations[:_LISTED_PAIRS]]
        yield from (BLANK, heading("Estimates that stay strongly correlated"), *items(pairs, width))
    if plan.detectability is not None:
        yield from (BLANK, *_detectability(plan.detectability, plan.power, plan.random_power, width))


def _sufficiency(sufficiency: Sufficiency) -> list[str]:
    texts = [sufficiency.why]
    if sufficiency.now is not None and sufficiency.later is not None:
        now, later = (three_digits(value * IN_MM) for value in (sufficiency.now, sufficiency.later))
        texts.append(f"predicted error with repeatability: {now} mm now, {later} mm with the next poses")
    if sufficiency.of_model:
        texts.append(f"this counts the {sufficiency.n} poses of the model's fit: fit them together with the new poses")
    else:
        texts.append(f"this counts the {sufficiency.n} rows measured already: fit them together with the new rows")
    return texts


def _facts(plan: CampaignPlan) -> list[str]:
    route, noise = plan.route, plan.noise
    with_each = " with each payload" if plan.candidates.n_payloads > 1 else ""
    facts = [f"chosen from {plan.candidates.n_poses} feasible poses of {plan.candidates.source}{with_each}"]
    orientation = "" if noise.orientation is None else f", {math.degrees(noise.orientation):.3g}° about each axis"
    facts.append(
        f"instrument {three_digits(noise.position * IN_MM)} mm along each axis{orientation}, repeatability "
        f"{three_digits(plan.repeatability * IN_MM)} mm ({noise.source})"
    )
    least = min(route.direction_share.tolist(), default=0.0)
    repeats = route.roles.count("repeat")
    extra = [
        f"{repeats} repeat{'s' * (repeats > 1)}" if repeats else "",
        f"{route.roles.count('check')} visits of the drift check pose" if route.roles.count("check") else "",
    ]
    facts.append(
        f"route of {route.length:.1f} joint ranges ({route.random_length:.1f} in a random order), "
        f"{route.passes} pass{'es' * (route.passes > 1)}; "
        + "".join(f"{text}; " for text in extra if text)
        + f"each joint is approached from its rarer direction in at least {100 * least:.0f} % of its moves"
    )
    facts.append(collisions_text(plan.settings.constraints.collisions))
    if plan.payload_blocks:
        facts.append(f"payloads: {_payloads(plan)}")
    if plan.validation is not None:
        facts.append(f"{plan.validation.shape[1]} more poses for validation only")
    return facts


def collisions_text(collisions: LinkCollisions | None) -> str:
    """Return what was checked for collisions."""
    if collisions is None:
        return "collisions of the links not checked"
    checked = f"{len(collisions.pairs)} pairs of links checked for collisions"
    if not collisions.overlapping:
        return checked
    pairs = ", ".join(f"{first} and {second}" for first, second in collisions.overlapping)
    return f"{checked}; not checked, as they touch at nearly all poses: {pairs}"


def _payloads(plan: CampaignPlan) -> str:
    """Return ``0 kg (visits 1 to 18, 15 poses), 5 kg (…)``, and the payloads that no pose has."""
    used = {block.payload for block in plan.payload_blocks}
    idle = [f"none with {payload:g} kg" for payload in plan.settings.payloads if payload not in used]
    texts = [
        f"{block.payload:g} kg (visits {block.first} to {block.first + block.n_visits - 1}, {block.n_poses} poses)"
        for block in plan.payload_blocks
    ]
    return ", ".join([*texts, *idle])


def _needed(plan: CampaignPlan) -> Iterator[TextLine]:
    ratios = [ratio for ratio, _ in plan.needed[0].by_ratio]
    yield heading("Poses that decide with probability 0.9, by the true value over the limit")
    header = ("limit", "mm", *(f"{ratio:g}" for ratio in ratios), "planned for", "poses")
    rows = [
        (
            f"{entry.demand.label} ({entry.demand.statistic})",
            three_digits(entry.demand.limit * IN_MM),
            *("–" if number is None else str(number) for _, number in entry.by_ratio),
            f"{entry.ratio:.2g}",
            "–" if entry.poses is None else str(entry.poses),
        )
        for entry in plan.needed
    ]
    yield from columns(header, rows)


def _accuracy(accuracy: ExpectedAccuracy, is_addition: bool, width: int) -> Iterator[TextLine]:
    """Yield the error over the number of poses, which are added to earlier ones if ``is_addition``."""
    yield heading("Predicted error after the fit over the task's region, mm")
    knee = accuracy.knee
    beyond = [] if knee is None else [point.n for point in accuracy.points if point.n >= knee]
    rows = []
    for point in accuracy.points:
        marks = [
            "planned" if accuracy.planned is not None and point.n == accuracy.planned.n else "",
            "past the knee" if point.n in beyond[:1] else "",
        ]
        values = (point.rms, point.random_rms, point.worst, point.total)
        cells = ["–" if value is None else three_digits(value * IN_MM) for value in values]
        rows.append((str(point.n), *cells, ", ".join(mark for mark in marks if mark)))
    yield from columns(
        ("more poses" if is_addition else "poses", "rms", "random poses", "worst", "with repeatability", ""), rows
    )
    if accuracy.planned is None:
        yield from items(("the planned poses do not identify all coefficients; plan more poses or fit less",), width)
    if knee is not None:
        more = " more" if is_addition else ""
        yield from items((f"knee at {knee}{more} poses: ten more reduce the error by less than 10 %",), width)
    elif accuracy.points:
        yield from items(("no knee: ten more poses still reduce the error by more than 10 %",), width)


def _coefficients(entries: Sequence[ExpectedCoefficient], width: int) -> Iterator[TextLine]:
    yield heading("Predicted standard errors")
    rows = []
    for entry in entries:
        if entry.std is not None:
            factor, unit = table_unit(entry.unit)
            rows.append((entry.name, three_digits(factor * entry.std), unit))
    yield from columns(("coefficient", "standard error", "unit"), rows)
    missing = [entry.name for entry in entries if entry.std is None]
    if missing:
        yield from (TextLine(line.text, "dim") for line in wrapped(f"not identifiable: {', '.join(missing)}", width))


def _detectability(
    detectability: Detectability, power: ExpectedPower | None, random_power: ExpectedPower | None, width: int
) -> Iterator[TextLine]:
    yield heading("Effects that a trace of these poses can find")
    families: dict[str, list[ExpectedLimit]] = {}
    for limit in detectability.limits:
        families.setdefault(limit.effect, []).append(limit)
    rows, hidden = [], []
    for name, family in families.items():
        known = sorted((limit for limit in family if limit.limit is not None), key=lambda limit: limit.limit or 0.0)
        shown = {limit.joints for limit in known}
        hidden += [limit.where for limit in family if limit.limit is None and limit.joints not in shown]
        if known:
            mean_power = statistics.mean(limit.power for limit in family)
            factor, unit = table_unit(known[0].unit)
            sizes = [factor * (limit.limit or 0.0) for limit in (known[0], known[-1])]
            limits = (f"{sizes[0]:.1e}", f"{sizes[1]:.1e}" if len(known) > 1 else "")
            rows.append((name, *limits, unit, f"{factor * known[0].usual:.1e}", fixed(mean_power, 2)))
    yield from columns(("effect", "lowest limit", "highest", "unit", "usual size", "mean power"), rows)
    notes = ["limit: size found with probability 1/2; power: probability that the usual size is found"]
    if power is not None and random_power is not None:
        notes.insert(
            0,
            f"mean over the catalogue at the usual sizes: found with probability {fixed(power.detected, 2)} "
            f"({fixed(random_power.detected, 2)} on random poses), found and distinguished from the most similar "
            f"effect with {fixed(power.separated, 2)} ({fixed(random_power.separated, 2)})",
        )
    hidden = list(dict.fromkeys(hidden))
    if hidden:
        more = f" and {len(hidden) - _LISTED_PAIRS} more" if len(hidden) > _LISTED_PAIRS else ""
        notes.append(f"never found on these poses: {', '.join(hidden[:_LISTED_PAIRS])}{more}")
    if detectability.missing:
        by_reason: dict[str, list[str]] = {}
        for name, reason in detectability.missing.items():
            by_reason.setdefault(reason, []).append(name)
        notes += [f"not tested ({reason}): {', '.join(names)}" for reason, names in by_reason.items()]
    yield from (TextLine(line.text, "dim") for line in items(notes, width))
    if detectability.pairs:
        yield from (BLANK, heading("Pairs that are not distinguishable at the usual size"))
        texts = pair_texts(detectability.pairs)
        yield from items(texts[:_LISTED_PAIRS], width)
        if len(texts) > _LISTED_PAIRS:
            yield TextLine(f"… and {len(texts) - _LISTED_PAIRS} more pairs", "dim")


def pair_texts(pairs: Sequence[InseparablePair]) -> list[str]:
    """Return a text for each pair; a pair that is inseparable both ways has one."""
    ways = {(pair.first, pair.second) for pair in pairs}
    texts = []
    for pair in pairs:
        if (pair.second, pair.first) not in ways:
            texts.append(f"{pair.second} explains {pair.first} (similarity {pair.similarity:.2f})")
        elif pair.first < pair.second:
            texts.append(f"{pair.first} and {pair.second} explain each other (similarity {pair.similarity:.2f})")
    return texts
