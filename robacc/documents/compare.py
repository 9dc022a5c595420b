"""Keys of ``robacc.compare/1`` and ``robacc.compare-paired/1``, in m and rad."""

from __future__ import annotations

from typing import Any

from robacc.comparison.comparing import ComparedRow, GradeStatus, RankedPair, Ranking, ResultComparison
from robacc.comparison.differences import Difference
from robacc.comparison.paired_targets import PairedTargets
from robacc.comparison.reading import ComparedResult
from robacc.documents.parts import figures_document, rounded
from robacc.statistics.intervals import EstimatedValue

Document = dict[str, Any]


def payload(comparison: ResultComparison) -> Document:
    """Return the keys of the comparison."""
    names = [result.name for result in comparison.results]
    return {
        "results": [_result(result) for result in comparison.results],
        "baseline": comparison.baseline,
        "confidence": comparison.confidence,
        "pairing": [
            {
                "first": match.first,
                "second": match.second,
                "paired": match.paired,
                "n_shared": match.shared,
                "n_first": match.n_first,
                "n_second": match.n_second,
            }
            for match in comparison.pairing
        ],
        "statistics": [_row(row, names) for row in comparison.rows],
        "ranking": _ranking(comparison.ranking),
        "grade": _grade(comparison),
        "notes": comparison.notes,
        "warnings": comparison.warnings,
    }


def _result(result: ComparedResult) -> Document:
    return {
        "name": result.name,
        "command": result.command,
        "robacc": result.version,
        "sha256": result.digest,
        "n_poses": result.n_poses,
        "robot": result.robot,
        "grade": result.grade,
        "made": dict(result.provenance),
    }


def _row(row: ComparedRow, names: list[str]) -> Document:
    return {
        "key": row.key,
        "unit": row.unit,
        "values": [
            {
                "name": name,
                "value": figure.value,
                "lower": figure.interval and figure.interval.lower,
                "upper": figure.interval and figure.interval.upper,
                "confidence": figure.interval and figure.interval.confidence,
            }
            for name, figure in zip(names, row.figures, strict=True)
        ],
        "differences": [
            {"name": name, **_difference(difference)}
            for name, difference in zip(names, row.differences, strict=True)
            if difference is not None
        ],
    }


def _difference(difference: Difference) -> Document:
    return {
        "value": difference.value,
        "lower": difference.interval.lower,
        "upper": difference.interval.upper,
        "confidence": difference.interval.confidence,
        "p_value": difference.p_value,
        "paired": difference.paired,
        "n_poses": difference.n_poses,
        "method": difference.interval.method,
        "why": difference.interval.why,
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


def _pair(pair: RankedPair) -> Document:
    return {
        "better": pair.better,
        "worse": pair.worse,
        "different": pair.different,
        "p_corrected": pair.p_corrected,
        "difference": _difference(pair.difference),
    }


def _grade(comparison: ResultComparison) -> Document | None:
    scale = comparison.scale
    if scale is None:
        return None
    return {
        "wanted": comparison.required_grade,
        "scale": scale.name,
        "statistic": scale.statistic,
        "confidence": scale.confidence,
        "demonstrated_by": [status.name for status in comparison.grade_statuses if status.verdict == "demonstrated"],
        "results": [_grade_status(status) for status in comparison.grade_statuses],
    }


def _grade_status(status: GradeStatus) -> Document:
    return {
        "name": status.name,
        "verdict": status.verdict,
        "demonstrated": status.verdict == "demonstrated",
        "grade": status.grade,
        "probability": status.probability,
        "position_m": status.position.value,
        "position_upper_bound_m": _upper_bound(status.position),
        "orientation_rad": None if status.orientation is None else status.orientation.value,
        "orientation_upper_bound_rad": _upper_bound(status.orientation),
        "poses_to_demonstrate": status.poses_to_demonstrate,
        "why": status.why,
    }


def _upper_bound(estimate: EstimatedValue | None) -> float | None:
    return None if estimate is None or estimate.interval is None else estimate.interval.upper_bound


# Keys of ``robacc.compare-paired/1`` in m.


def paired_payload(result: PairedTargets) -> Document:
    """Return the keys of the comparison; arrays stay arrays, with targets first."""
    promise = result.promise
    return {
        "n_targets": len(result.names),
        "before": figures_document(result.metrics_before, "m"),
        "after": figures_document(result.metrics_after, "m"),
        "gain": {
            "value_m": result.gain.value,
            "lower_m": result.gain.low,
            "upper_m": result.gain.high,
            "confidence": result.gain.confidence,
        },
        "loaded": {
            "verdict": result.loaded.verdict.replace(" ", "_"),
            "slope": result.loaded.slope,
            "lower": result.loaded.low,
            "upper": result.loaded.high,
            "planned_rms_m": result.loaded.planned_rms,
        },
        "promise": None
        if promise is None
        else {
            "kept": promise.kept,
            "chi_square": promise.chi_square,
            "degrees_of_freedom": promise.degrees_of_freedom,
            "p_value": promise.p_value,
            "promised_rms_m": promise.promised_rms,
            "noise": {
                "position_m": promise.noise.position,
                "source": promise.noise.source,
                "treatment": promise.noise.treatment,
            },
        },
        "targets": {
            "name": list(result.names),
            "error_before_m": rounded(result.before),
            "error_after_m": rounded(result.after),
        },
        "notes": list(result.notes),
    }
