"""What a reader of a comparison must know: where results were made differently, and what the figures do not say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from robacc.accuracy.grade_scale import Scale
from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.grade_status import Standing

_CONSEQUENCES = {
    "frame": "lengths can be compared, components cannot, and are left out",
    "alignment": "an alignment takes out part of the error that the other result still has",
    "held out": "figures of poses fitted are better than those of poses held out",
    "robot file": "errors of the poses that it was fitted to are smaller than those of others",
    "confidence": "their intervals are not alike",
}


class Match(Protocol):
    """How the poses of two results go together."""

    @property
    def paired(self) -> bool:
        """In pairs."""

    @property
    def shared(self) -> int:
        """Commanded poses in common."""

    @property
    def n_first(self) -> int:
        """Commanded poses of the first."""

    @property
    def n_second(self) -> int:
        """Commanded poses of the second."""


def made_differently(subjects: Sequence[ComparedResult], matches: Sequence[tuple[str, str, Match]]) -> tuple[str, ...]:
    """A line for each aspect in which the results are not alike."""
    lines = []
    for aspect in dict.fromkeys(aspect for subject in subjects for aspect in subject.made):
        ways: dict[str, list[str]] = {}
        for subject in subjects:
            if aspect in subject.made:
                ways.setdefault(subject.made[aspect], []).append(subject.name)
        if len(ways) > 1:
            listed = "; ".join(f"{', '.join(names)}: {way}" for way, names in ways.items())
            consequence = _CONSEQUENCES.get(aspect)
            lines.append(f"made differently, {aspect}: {listed}" + (f" ({consequence})" if consequence else ""))
    return (*lines, *_about_poses(subjects, matches))


def _about_poses(subjects: Sequence[ComparedResult], matches: Sequence[tuple[str, str, Match]]) -> Iterator[str]:
    with_errors = {subject.name for subject in subjects if "position" in subject.errors}
    for first, second, match in matches:
        if first not in with_errors or second not in with_errors:
            continue
        if not match.paired:
            yield f"made differently, poses: {first} and {second} are not of the same poses, so nothing cancels"
        elif match.shared < max(match.n_first, match.n_second):
            most = max(match.n_first, match.n_second)
            yield (
                f"made differently, poses: {first} and {second} share {match.shared} of {most} poses; "
                "their differences are over those alone"
            )


def notes(
    subjects: Sequence[ComparedResult], tested: bool, found: Sequence[Standing], scale: Scale | None
) -> tuple[str, ...]:
    """What holds of the whole comparison; ``tested`` says whether any difference has a p-value."""
    lines = []
    if tested:
        lines.append(
            "each difference is tested by itself; the ranking's p-values are corrected for the number of pairs (Holm)"
        )
        lines.append("all poses of a result are of one robot: the tests speak of other poses of these robots")
    if any(subject.command in ("calibrate", "trace") for subject in subjects):
        lines.append("position and orientation of calibrate and trace are those after the fit, on poses held out")
    if scale is not None and sum(one.verdict == "demonstrated" for one in found) > 1:
        lines.append(
            f"each grade is demonstrated by itself with {100 * scale.confidence:g} %, not all of them together"
        )
    return tuple(lines)
