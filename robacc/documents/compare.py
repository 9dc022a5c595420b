"""A comparison as the keys of ``robacc.compare/1`` (m and rad)."""

from __future__ import annotations

from typing import Any

from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.comparing import Pair, Ranking, ResultComparison, Row
from robacc.comparison.differences import Difference
from robacc.comparison.grade_status import Standing

Document = dict[str, Any]


def payload(found: ResultComparison) -> Document:
    """The document's own keys."""
    names = [subject.name for subject in found.subjects]
    return {
        "results": [_subject(subject) for subject in found.subjects],
        "baseline": found.baseline,
        "confidence": found.confidence,
        "pairing": [
            {
                "first": one.first,
                "second": one.second,
                "paired": one.paired,
                "n_shared": one.shared,
                "n_first": one.n_first,
                "n_second": one.n_second,
            }
            for one in found.pairing
        ],
        "statistics": [_row(row, names) for row in found.rows],
        "ranking": _ranking(found.ranking),
        "grade": _grade(found),
        "notes": found.notes,
        "warnings": found.warnings,
    }


def _subject(subject: ComparedResult) -> Document:
    return {
        "name": subject.name,
        "command": subject.command,
        "robacc": subject.version,
        "sha256": subject.digest,
        "n_poses": subject.n_poses,
        "robot": subject.robot,
        "grade": subject.grade,
        "made": dict(subject.made),
    }


def _row(row: Row, names: list[str]) -> Document:
    return {
        "key": row.key,
        "unit": row.unit,
        "values": [
            {
                "name": name,
                "value": figure.value,
                "lower": figure.lower,
                "upper": figure.upper,
                "confidence": figure.confidence,
            }
            for name, figure in zip(names, row.figures, strict=True)
        ],
        "differences": [
            {"name": name, **_difference(one)}
            for name, one in zip(names, row.differences, strict=True)
            if one is not None
        ],
    }


def _difference(one: Difference) -> Document:
    return {
        "value": one.value,
        "lower": one.lower,
        "upper": one.upper,
        "confidence": one.confidence,
        "p_value": one.p_value,
        "paired": one.paired,
        "n_poses": one.n_poses,
        "method": one.method,
        "why": one.why,
    }


def _ranking(ranking: Ranking) -> Document:
    return {
        "by": ranking.key,
        "unit": ranking.unit,
        "level": ranking.level,
        "order": [
            {"name": name, "value": value, "letters": letters}
            for name, value, letters in zip(ranking.names, ranking.values, ranking.letters, strict=True)
        ],
        "indistinguishable": [list(group) for group in ranking.groups if len(group) > 1],
        "pairs": [_pair(pair) for pair in ranking.pairs],
        "text": ranking.sentences(),
    }


def _pair(pair: Pair) -> Document:
    return {
        "better": pair.better,
        "worse": pair.worse,
        "different": pair.different,
        "p_corrected": pair.p_corrected,
        "difference": _difference(pair.difference),
    }


def _grade(found: ResultComparison) -> Document | None:
    scale = found.scale
    if scale is None:
        return None
    return {
        "wanted": found.wanted,
        "scale": scale.name,
        "statistic": scale.statistic,
        "confidence": scale.confidence,
        "demonstrated_by": [one.name for one in found.standings if one.verdict == "demonstrated"],
        "results": [_standing(one) for one in found.standings],
    }


def _standing(one: Standing) -> Document:
    return {
        "name": one.name,
        "verdict": one.verdict.replace(", ", "_").replace(" ", "_"),
        "demonstrated": one.verdict == "demonstrated",
        "grade": one.grade,
        "probability": one.probability,
        "position_m": one.position,
        "position_upper_bound_m": one.position_bound,
        "orientation_rad": one.orientation,
        "orientation_upper_bound_rad": one.orientation_bound,
        "poses_to_demonstrate": one.poses_to_demonstrate,
        "why": one.why,
    }
