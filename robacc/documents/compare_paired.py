"""Keys of ``robacc.compare-paired/1`` in m."""

from __future__ import annotations

from typing import Any

from robacc.comparison.paired_targets import PairedTargets
from robacc.documents.poses import rounded
from robacc.documents.statistics import figures_document

Document = dict[str, Any]


def payload(result: PairedTargets) -> Document:
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
