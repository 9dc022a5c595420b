"""Common parts of the calibrate and trace reports: before and after side by side, the deflection model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robacc.accuracy.metrics import PoseMetrics
from robacc.accuracy.stages import Gain, Stage
from robacc.error_model.structure import Repeatability
from robacc.fitting.deflection_model import BETTER, DeflectionChoice
from robacc.render.text.layout import TextLine, columns
from robacc.render.text.numbers import three_digits
from robacc.render.text.units import IN_DEGREES, IN_MM
from robacc.robots.arm import Arm

NOISE_SOURCES = {
    "file": "from the file's sigma columns",
    "file and misfit": "from the file's sigma columns and what the remaining error adds to them",
    "repeats": "from repeated poses",
}
"""Where a known measurement noise comes from; any other source is the remaining error alone."""


def stage_tables(stages: Sequence[tuple[str, Stage]]) -> Iterator[TextLine]:
    """Return the errors of each stage, held-out poses first."""
    kinds = (
        ("held_out", "held-out poses"),
        ("held_out_inliers", "held-out poses without outliers"),
        ("fitted", "calibration poses"),
        ("fitted_inliers", "calibration poses without outliers"),
    )
    for kind, title in kinds:
        figures = [(name, getattr(stage, kind)) for name, stage in stages]
        if any(metrics is None for _, metrics in figures):
            continue
        for quantity, unit, factor in (("position", "mm", IN_MM), ("orientation", "°", IN_DEGREES)):
            if getattr(figures[0][1], quantity) is not None:
                yield from _table(f"{quantity}, {unit}, {title}", quantity, factor, figures)


def gain_line(gain: Gain | None) -> Iterator[TextLine]:
    """Return the gain with its interval, nothing without an interval."""
    if gain is None or gain.low != gain.low:
        return
    value, low, high = (three_digits(number * IN_MM) for number in (gain.value, gain.low, gain.high))
    percent = f"{100 * gain.confidence:.0f} %"
    yield TextLine(f"rms reduction on held-out poses: {value} mm ({percent} interval {low} to {high} mm)")


def repeatability_items(repeatability: Repeatability | None, arm: Arm) -> Iterator[str]:
    """Return the intrinsic repeatability joint by joint, and its limitation; nothing if it is not significant."""
    if repeatability is None:
        return
    joints = ", ".join(
        f"{name} {three_digits(std * (IN_DEGREES if arm.is_revolute(name) else IN_MM))}"
        f"{'°' if arm.is_revolute(name) else ' mm'}"
        for name, std in repeatability.joints
        if std is not None
    )
    size = three_digits(repeatability.position * IN_MM)
    yield f"intrinsic repeatability: {size} mm rms at the target ({joints or 'not identifiable joint by joint'})"
    if repeatability.source == "residual":
        yield "without repeated visits, repeatability is not distinguishable from effects outside the catalogue"


def _table(title: str, quantity: str, factor: float, figures: Sequence[tuple[str, PoseMetrics]]) -> list[TextLine]:
    rows = []
    for name, stage in figures:
        metrics = getattr(stage, quantity)
        rows.append(
            [name, *(three_digits(value * factor) for value in (metrics.rms, metrics.mean, metrics.p95, metrics.max))]
        )
    return columns([title, "rms", "mean", "95th pct.", "max"], rows)


def deflection(choice: DeflectionChoice | None) -> Iterator[str]:
    """Return the deflection model used by elastic effects and the reason for it."""
    if choice is None:
        return
    size = f"{three_digits(choice.difference * IN_MM)} mm rms"
    if choice.gain is None:
        yield (
            f"deflection model: equilibrium; torques at the undeflected pose change the prediction by {size}, too "
            "little to distinguish the two models"
        )
        return
    comparison = (
        f"torques at the undeflected pose change the prediction by {size} and twice the log-likelihood by "
        f"{choice.gain:+.3g}; threshold +{BETTER:g}"
    )
    yield f"deflection model: {'equilibrium' if choice.form == 'equilibrium' else 'undeflected pose'}; {comparison}"
