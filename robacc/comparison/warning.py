"""Warnings of a comparison, where results were made differently, and notes on what its figures do not say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robacc.accuracy.grade_scale import Scale
from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.grade_status import GradeStatus
from robacc.comparison.pairing import PoseMatch

_CONSEQUENCES = {
    "frame": "lengths are compared; components are not, because their axes differ",
    "alignment": "a registration removes a part of the error that the other result still contains",
    "held out": "errors of calibration poses are smaller than errors of held-out poses",
    "robot file": "errors of the poses that it was fitted to are smaller than errors of other poses",
    "confidence": "the intervals are not comparable",
}


def provenance_warnings(results: Sequence[ComparedResult], pairing: Sequence[PoseMatch]) -> tuple[str, ...]:
    """Return a line for each aspect in which the results were made differently, and for poses that differ."""
    lines = []
    for aspect in dict.fromkeys(aspect for result in results for aspect in result.provenance):
        names_by_value: dict[str, list[str]] = {}
        for result in results:
            if aspect in result.provenance:
                names_by_value.setdefault(result.provenance[aspect], []).append(result.name)
        if len(names_by_value) > 1:
            listed = "; ".join(f"{', '.join(names)}: {value}" for value, names in names_by_value.items())
            consequence = _CONSEQUENCES.get(aspect)
            lines.append(f"made differently, {aspect}: {listed}" + (f" ({consequence})" if consequence else ""))
    return (*lines, *_pose_warnings(results, pairing))


def _pose_warnings(results: Sequence[ComparedResult], pairing: Sequence[PoseMatch]) -> Iterator[str]:
    with_errors = {result.name for result in results if "position" in result.errors}
    for match in pairing:
        if match.first not in with_errors or match.second not in with_errors:
            continue
        names, most = f"{match.first} and {match.second}", max(match.n_first, match.n_second)
        if not match.paired:
            yield f"made differently, poses: {names} have different poses, so their difference cannot be paired"
        elif match.shared < most:
            yield f"made differently, poses: {names} share {match.shared} of {most} poses; only these are compared"


def notes(
    results: Sequence[ComparedResult], tested: bool, statuses: Sequence[GradeStatus], scale: Scale | None
) -> tuple[str, ...]:
    """Return the limitations of the comparison; ``tested`` is true if any difference has a p-value."""
    lines = []
    if tested:
        lines.append(
            "each difference is tested by itself; the ranking's p-values are corrected for the number of pairs (Holm)"
        )
        lines.append("the tests apply to other poses of the same robots, not to other robots")
    if any(result.command in ("calibrate", "trace") for result in results):
        lines.append("position and orientation of calibrate and trace are those after the fit, on held-out poses")
    if scale is not None and sum(status.verdict == "demonstrated" for status in statuses) > 1:
        lines.append(f"each grade by itself is confirmed at {100 * scale.confidence:g} % confidence, not all together")
    return tuple(lines)
