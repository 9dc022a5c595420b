"""Error that remains after the findings of a trace, and hints on its cause."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.diagnostics.approach_memory import memory_of_play
from robacc.diagnostics.rounded_joints import Rounding
from robacc.diagnostics.row_loads import unlogged_loads
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.effects.base import Effect
from robacc.error_model.estimate import ACCEPTED
from robacc.error_model.structure import ErrorStructure, Repeatability
from robacc.error_model.terms import Part
from robacc.fitting.fit_result import Fit
from robacc.fitting.noise import LackOfFit
from robacc.fitting.outlier_pattern import outlier_pattern
from robacc.geometry import rms_length
from robacc.measurements import Measurements
from robacc.tracing.search import SearchResult

_CHANCE = 0.002
"""Probability below which a structure of the remaining error is no chance: some five tests share one in a hundred."""
_OF_EVERY_ARM = ("joint_offset", "link_geometry")
"""Effects by which every nominal model deviates."""
_MOST_REPEATABILITY = 1e-4
"""Largest plausible repeatability at the target, m (data sheets: 0.02 to 0.1 mm)."""
_MOST_PRESUMED = 1.2e-4
"""Remaining error, m rms, up to which noise that nothing confirms may be presumed: a laser tracker at some metres
(0.03 to 0.05 mm along each axis) and a data sheet's repeatability together."""
_UNCERTAIN = 1.2
"""Factor by which an estimate of scatter from some hundred rows exceeds the rounding that causes it."""
_SMALL_POSE_ERROR = 1e-5
"""Error common to all visits of a pose that no instrument resolves, m."""
_LOOKS_LIKE: Mapping[Part, tuple[str, tuple[str, ...]]] = {
    "scatter": ("scatters from visit to visit", ("backlash", "friction_windup", "approach_lag")),
    "wander": ("wanders over time", ("thermal_expansion", "joint_warmup", "frame_drift")),
}
"""Parts of the error, what they look like, and effects that look so where their columns are missing."""
_MANY_OUTLIERS = 0.05
"""Share of the rows from which outliers are not accidental."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Remaining error after the findings."""

    rms: float
    """Root mean square of the fitted residual's length, m."""
    noise_rms: float | None
    """Root mean square of the measurement noise's length, m; None if neither file nor repeats give it."""
    structured: bool
    """Whether the error has a structure; each structure has a hint."""
    p_value: float
    hints: tuple[str, ...]
    parts: Mapping[Part, float]
    """Root mean square of each part at the target, m."""


def _scatter_hints(repeatability: Repeatability | None, rounding: Rounding | None) -> Iterator[str]:
    """Yield hints on scatter of the joints that is too large, or too repeatable, for repeatability and rounding."""
    if repeatability is None:
        return
    most = math.hypot(_MOST_REPEATABILITY, 0.0 if rounding is None else _UNCERTAIN * rounding.position)
    if repeatability.source == "residual" and repeatability.position > most:
        yield (
            f"the joints scatter by {1e3 * repeatability.position:.3g} mm rms at the target, more than an arm's "
            "repeatability: an effect outside the catalogue, or a payload or load that was not recorded; "
            "measure some poses repeatedly to distinguish these"
        )
    if repeatability.pose_position > max(repeatability.position, _SMALL_POSE_ERROR):
        yield (
            "visits of a pose, or of poses close together, share an error of "
            f"{1e3 * repeatability.pose_position:.3g} mm rms that no candidate explains"
        )


def _process_hints(found: SearchResult, structure: ErrorStructure) -> Iterator[str]:
    """Yield a hint on an error that depends on the pose and that no named effect describes."""
    parameters = found.noise.terms.get("smooth")
    if parameters is None or "smooth" in structure.noise.terms:
        return
    size = math.sqrt(3.0) * math.exp(parameters[0]) * float(np.sqrt(np.mean(np.square(found.state.linear.reach))))
    yield (
        f"an error of about {1e3 * size:.2g} mm rms depends smoothly on the pose, and no effect of the catalogue "
        "describes it better than chance: no cause is named"
    )
    absent = [name for name in _OF_EVERY_ARM if all(effect.name != name for effect in found.model.free)]
    if absent:
        yield (
            f"every arm deviates in {' and '.join(absent)} too, which were not declared: add "
            f"{','.join(absent)} to the effects of `declared`"
        )


def _outlier_hints(final: Fit, data: Measurements) -> Iterator[str]:
    """Yield hints on outliers that are not accidental."""
    pattern = outlier_pattern(data, ~final.inliers, final.model.arm.names)
    if pattern is not None:
        yield pattern.text
    share = final.outliers.size / data.n
    if share > _MANY_OUTLIERS:
        yield f"{final.outliers.size} of {data.n} rows ({100 * share:.0f} %) are outliers: too many for chance"


def _size_hints(
    effects: Sequence[Effect],
    noise: LackOfFit,
    repeatability: Repeatability | None,
    rounding: Rounding | None,
    rms: float,
) -> Iterator[str]:
    """Yield a hint if findings leave more than usual noise and nothing confirms that it is noise."""
    unconfirmed = noise.p_value is None and (repeatability is None or repeatability.source == "residual")
    most = math.hypot(_MOST_PRESUMED, 0.0 if rounding is None else _UNCERTAIN * rounding.position)
    if unconfirmed and effects and rms > most:
        yield (
            f"the remaining error, {1e3 * rms:.3g} mm rms, is larger than usual instrument noise and repeatability, "
            "and neither sigma columns nor repeated poses show that it is noise: part of it may have a cause outside "
            "the model"
        )


def _memory_hints(effects: Sequence[Effect], final: Fit, data: Measurements) -> Iterator[tuple[float, str]]:
    """Yield p-value and hint on each joint whose play remembers the previous visit."""
    playing = {joint: effect for effect in effects if effect.follows_approach for joint in effect.joints}
    p_values = memory_of_play(final, data, tuple(playing))
    for joint, p_value in p_values.items():
        if p_value * len(p_values) <= _CHANCE:
            yield (
                p_value * len(p_values),
                f"in addition to {playing[joint]}, the errors of {joint} follow the change of its torque since the "
                "previous visit: its play has a memory (hysteresis), which the direction of approach alone does not "
                "describe",
            )


def _columns_to_record(parts: Mapping[Part, float], missing: Mapping[str, str]) -> Iterator[str]:
    """Yield which columns would show whether a part of the error that is no noise has a cause."""
    for part, (looks, names) in _LOOKS_LIKE.items():
        untested = [f"{name} ({missing[name]})" for name in names if name in missing]
        if untested and (size := parts.get(part, 0.0)) > parts["noise"]:
            yield (
                f"{1e3 * size:.2g} mm rms {looks}: it may be {' or '.join(untested)}, which were not tested; record "
                "what they need and trace again"
            )


def remaining_error(
    found: SearchResult,
    effects: Sequence[Effect],
    final: Fit,
    noise: LackOfFit,
    data: Measurements,
    structure: ErrorStructure,
    rounding: Rounding | None = None,
) -> Unexplained:
    """Return the error that remains after the findings, whether it has a structure, and hints on its cause."""
    hints = [*structure.warnings, *_process_hints(found, structure)]
    p_values = [0.0] if hints else [found.next[0].p_value] if found.next else [1.0]
    for p_value, hint in _memory_hints(effects, final, data):
        p_values.append(p_value)
        hints.append(hint)
    if hints and (loads := unlogged_loads(final, data)) is not None:
        hints.insert(0, loads.text)
    residual = final.residual[:3, final.inliers]
    rms = rms_length(residual)
    hints.extend(_scatter_hints(structure.repeatability, rounding))
    hints.extend(suspected_mistakes(final))
    hints.extend(_outlier_hints(final, data))
    hints.extend(_size_hints(effects, noise, structure.repeatability, rounding, rms))
    if noise.p_value is not None and noise.p_value <= _CHANCE:
        p_values.append(noise.p_value)
        source = "repeats" if noise.noise.source == "repeats" else "the file"
        hints.append(f"the residual is {noise.ratio:.3g} times the measurement noise (known from {source})")
        if not found.next or found.next[0].log_odds < ACCEPTED:
            hints.append("no candidate explains this error: it is repeatability, or an effect outside the catalogue")
    if hints:
        hints.extend(_columns_to_record(structure.parts, found.pool.missing))
    return Unexplained(
        rms=rms,
        noise_rms=None if noise.p_value is None else math.sqrt(3) * noise.noise.position,
        structured=bool(hints),
        p_value=min(p_values),
        hints=tuple(hints),
        parts=structure.parts,
    )
