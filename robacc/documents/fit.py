"""Documents of `robacc calibrate` and `robacc trace`: the keys that they share, and their own."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from robacc.accuracy.error_statistics import length_intervals
from robacc.documents.envelope import GATE_KEY
from robacc.documents.keys import (
    COVARIANCE,
    CURVE,
    CURVE_KEYS,
    FIGURES,
    FITTED_POSES,
    INTERVAL,
    METRICS,
    OUTSIDE_KEY,
    PARAMETER,
    QUANTITIES,
    ROBOT,
    WARNINGS,
    Document,
    Key,
    Kind,
    array,
    choice,
    count,
    flag,
    number,
    part,
    parts,
    pose_document,
    robot_document,
    share,
    size,
    table,
    text,
)
from robacc.fitting.priors import weak_kinds
from robacc.geometry import Array, NDArray
from robacc.measurements import different
from robacc.statistics.intervals import Interval

if TYPE_CHECKING:
    from robacc.accuracy.estimation import ErrorMetrics
    from robacc.tracing.calibrating import Stage

CONFIDENCE = 0.95
"""Confidence of the intervals of a stage."""
_WITH_INTERVALS = ("rms", "mean_error", "p95")


NOISE = part(
    position_m=Key(
        size | None, "Standard deviation along an axis, m; rms of the three if they differ.", "noise.position"
    ),
    rms_m=Key(size | None, "Root mean square length of the noise of a position, m.", "rms"),
    along_axes_m=Key(
        array(size, 3) | None,
        "Standard deviations along x, y, z of the measuring frame, m; null if they do not differ.",
        "noise.along_axes",
        optional=True,
    ),
    orientation_rad=Key(
        size | None, "Standard deviation about an axis, rad; null if no orientation was measured.", "noise.orientation"
    ),
    source=Key(
        choice("file", "file and misfit", "repeats", "residual"),
        "Source of the value; file and misfit: the file's sigma columns, and what the remaining error adds to them.",
        "noise.source",
    ),
    residual_over_noise=Key(size | None, "Rms of the residual over rms of the noise.", "ratio"),
    lack_of_fit_p_value=Key(
        share | None,
        "Probability of a residual as large by noise alone; null if the noise was estimated from the residual.",
        "p_value",
    ),
).named("noise", "Measurement noise that sets the weights of the fit.")

STAGE_FIGURES = part(
    **{
        name: Key(
            part(
                **METRICS[unit],
                n_poses=Key(count, "Number of rows behind the metrics."),
                n_commanded_poses=Key(count, "Number of commanded poses among the rows."),
                intervals=Key(
                    part(**{f"{metric}_{unit}": Key(INTERVAL) for metric in _WITH_INTERVALS}),
                    "Intervals of the metrics, by their keys.",
                ),
            )
            | None,
            f"Metrics of {name}; null if none was measured.",
        )
        for unit, name in QUANTITIES
    }
).named("stage_figures", "Metrics on one set of poses.")
STAGE = part(
    fitted=Key(STAGE_FIGURES, "Metrics of all calibration poses, outliers included."),
    fitted_inliers=Key(
        STAGE_FIGURES | None, "Metrics of the calibration poses without the outliers; null if there are none."
    ),
    held_out=Key(
        STAGE_FIGURES | None,
        "Metrics of all held-out poses, outliers included, which are not used for fitting; validation poses are not "
        "used for choosing effects either. Null if there are too few poses.",
    ),
    held_out_inliers=Key(
        STAGE_FIGURES | None, "Metrics of the held-out poses without the outliers; null if there are none."
    ),
).named("stage", "One stage of the fit.")

REPEATABILITY = part(
    joints=Key(
        table(size | None),
        "Standard deviation of each joint's scatter from visit to visit, rad or m; null if it is not identifiable.",
        lambda repeatability: dict(repeatability.joints),
    ),
    position_m=Key(size, "Rms of the scatter's length at the target, m."),
    pose_position_m=Key(
        size, "Rms of the error that all visits of a pose, or of poses close together, share and no effect explains, m."
    ),
    source=Key(
        choice("repeated visits", "several targets", "residual"),
        "Source that separates it from the noise; from the residual alone, an effect outside the catalogue "
        "is not distinguishable.",
    ),
)
"""Intrinsic repeatability of an arm."""


def finite(value: float) -> float | None:
    """Return the value; None if it is not finite, which JSON has no number for."""
    return value if math.isfinite(value) else None


# Stages of a fit: the metrics of each stage with their intervals.

_STAGES = ("nominal_unregistered", "nominal", "before", "after")


def _stage(result: Any, key: str) -> Document:
    """Return the metrics of one stage, with intervals over the commanded poses, repetitions together.

    Intervals on calibration poses ignore the fit to these poses; the metrics on held-out poses are the valid ones.
    """
    stage: Stage = getattr(result, key)
    groups, seed = result.places, result.made.seed or 0
    figures: dict[str, Document | None] = dict.fromkeys(STAGE.keys or ())
    for name in figures:
        metrics, own = getattr(stage, name), groups[name.removesuffix("_inliers")]
        if metrics is not None:
            is_fitted = name.startswith("fitted")
            share = 1.0 if is_fitted else stage.share
            errors = stage.residual if is_fitted else cast("Array", stage.held_out_residual)
            used = stage.inliers if is_fitted else stage.held_out_inliers_mask
            shown = used | (not name.endswith("inliers"))
            figures[name] = {
                "position": _figures(metrics.position, errors[:3, shown], own[shown], "m", seed, share),
                "orientation": _figures(metrics.orientation, errors[3:, shown], own[shown], "rad", seed, share),
            }
    return STAGE.write(figures)


def _figures(
    metrics: "ErrorMetrics | None", errors: Array, groups: NDArray[np.int64], unit: str, seed: int, share: float
) -> Document | None:
    if metrics is None:
        return None
    missing: Mapping[Any, Interval] = dict.fromkeys(_WITH_INTERVALS, Interval.missing(CONFIDENCE, "no pose"))
    found = (
        length_intervals(errors, (CONFIDENCE,), groups=groups, share=share, seed=seed)
        if errors.shape[1]
        else (missing,)
    )
    return {
        **FIGURES[unit].write(metrics),
        "n_poses": int(groups.size),
        "n_commanded_poses": different(groups),
        "intervals": {f"{name}_{unit}": interval for name, interval in found[0].items()},
    }


def _fitted_poses(result: Any) -> Document:
    """Return the calibration poses with the errors of each stage, held-out ones too unless they have their own file."""
    inputs = result.fit_inputs
    errors = {name: getattr(result, name).residual for name in _STAGES}
    if inputs.holdout is None:
        errors |= {f"held_out_{name}": getattr(result, name).held_out_residual for name in _STAGES}
    return pose_document(inputs.data, inputs.data.position - errors["nominal"][:3], errors, result.fit.inliers)


def _validation_poses(result: Any) -> Document | None:
    """Return the poses of a file of their own with the errors of each stage; None without such a file."""
    apart = result.fit_inputs.holdout
    errors = {name: getattr(result, name).held_out_residual for name in _STAGES}
    if apart is None or errors["nominal"] is None:
        return None
    return pose_document(apart, apart.position - errors["nominal"][:3], errors)


_FIT = {
    "n_poses": Key(count, "Measured poses (rows).", "fit_inputs.data.n"),
    "noise": Key(NOISE),
    "nominal_unregistered": Key(
        STAGE,
        "Nominal model as it stands in the robot file, base and tool not fitted.",
        lambda result: _stage(result, "nominal_unregistered"),
    ),
    "nominal": Key(
        STAGE,
        "Nominal model, registered: base and tool frames fitted as far as the poses allow.",
        lambda result: _stage(result, "nominal"),
    ),
    "before": Key(
        STAGE,
        "Baseline: the declared effects are fitted (calibrate: base and tool, if they are fitted at all).",
        lambda result: _stage(result, "before"),
    ),
    "after": Key(
        STAGE,
        "Extended model: all effects are fitted, in trace with the findings.",
        lambda result: _stage(result, "after"),
    ),
    "declared": Key(
        part(
            effects=Key(array(text), "Effects as the parameter declared takes them.", "names"),
            by_default=Key(flag, "The call declared nothing, so the effects are those of every arm."),
            left_out=Key(
                parts(effect=Key(text, "Name of the effect."), why=Key(text, "The reason.")),
                "Effects of every arm that the poses do not support.",
                lambda baseline: [{"effect": name, "why": why} for name, why in baseline.left_out],
            ),
        ),
        "Effects that were declared to a trace, or that a calibration was to fit.",
        "fit_inputs.baseline",
    ),
    "causes": Key(
        parts(
            effect=Key(text, "Name of the effect."),
            joints=Key(array(text), "Joints that it changes."),
            settings=Key(table(), "Settings of the effect."),
            declared=Key(flag, "Whether it was declared; else the trace found it."),
            size_at_tool_m=Key(size, "Root mean square distance by which it alone moves the target, m.", "size"),
            low_m=Key(size, "Lower end of the 95 % interval of that distance, m.", lambda cause: cause.interval[0]),
            high_m=Key(size, "Upper end, m.", lambda cause: cause.interval[1]),
            error_without_m=Key(
                size, "Root mean square error that no other effect of the fit can describe, m.", "left"
            ),
            share=Key(
                share | None,
                "Mean square of that error over that of the nominal model, registered if the fit has frames.",
            ),
            turn_at_tool_rad=Key(
                size | None,
                "Root mean square angle by which it alone turns the target, rad; null where orientation was not "
                "measured.",
                "turn",
                optional=True,
            ),
        ),
        "Effects in the fit other than base and tool, declared or found, that the poses distinguish from "
        "nothing; the largest first.",
    ),
    "gain_m": Key(
        part(
            value=Key(number, "Error before minus error after, m."),
            low=Key(number | None, "Lower limit of the interval, m.", lambda gain: finite(gain.low)),
            high=Key(number | None, "Upper limit of the interval, m.", lambda gain: finite(gain.high)),
            confidence=Key(share, "Confidence of the interval."),
        ).named("gain", "Reduction of the rms position error on held-out poses, m; null if there are none.")
        | None
    ),
    "n_folds": Key(
        count, "Groups of poses that are held out in turn; 0 with validation poses, or where poses are too few."
    ),
    "parameters": Key(array(PARAMETER), "All coefficients of the extended model."),
    "parameter_covariance": Key(COVARIANCE, "Covariance of the coefficients that have a standard error.", "covariance"),
    "priors": Key(
        parts(
            effect=Key(text, "Effect that the constants belong to."),
            unit=Key(text, "Unit of the constants and of the standard deviation."),
            std=Key(number, "Standard deviation of the prior, estimated from the data."),
            weakly_identifiable=Key(
                array(text), "Coefficients of the effect that the poses alone determine poorly.", "names"
            ),
        ),
        "Gaussian priors about nominal on kinds of constants of which some are weakly identifiable; empty if "
        "there are none.",
        lambda result: weak_kinds(result.fit),
    ),
    "repeatability": Key(
        REPEATABILITY | None,
        "Intrinsic repeatability of the arm, apart from the measurement noise; null if it cannot be separated.",
    ),
    "information": Key(
        table(size),
        "Number of identifiable coefficients that each kind of measurement determines; together all of them, less what "
        "priors determine. Empty for one kind.",
        lambda result: result.fit.information(),
    ),
    "converged": Key(flag, "True if the fit of the reported model converged.", "fit.converged"),
    "outliers": Key(
        parts(line=Key(count, "Line of the file.")),
        "Outliers, which the fit leaves out.",
        lambda result: [{"line": result.fit_inputs.data.line(int(i))} for i in result.fit.outliers],
    ),
    **WARNINGS,
    "robot": Key(
        ROBOT | None,
        source=lambda result: robot_document(
            result.fit_inputs.robot, result.fit_inputs.data.q, result.fit.model.arm.robot
        ),
    ),
    "poses": Key(FITTED_POSES, source=_fitted_poses),
    "poses_apart": Key(FITTED_POSES | None, "Poses of the holdout file; null without such a file.", _validation_poses),
}

CALIBRATE = part(
    **_FIT,
    effects=Key(
        array(
            part(effect=Key(text, "Name of the effect."), joints=Key(array(text), "Joints of the effect."))._replace(
                words={"additionalProperties": True}
            )
        ),
        "Fitted effects, with the settings of their form.",
        lambda calibration: [
            {"effect": effect.name, "joints": list(effect.joints), **effect.settings()}
            for effect in calibration.effects
        ],
    ),
    shrinkage=Key(
        parts(
            unit=Key(text, "m or rad."),
            width=Key(
                size | None,
                "Standard deviation of the prior for constants that differ from their nominal values, in the unit.",
                "std",
            ),
            constants=Key(
                parts(
                    name=Key(text, "Name of the coefficient."),
                    probability=Key(share, "Probability that the constant differs from its nominal value."),
                ),
                "Constants of the kind.",
                lambda kind: [
                    {"name": name, "probability": probability}
                    for name, probability in zip(kind.names, kind.probability, strict=True)
                ],
            ),
        ),
        "Constants with shrinkage to the nominal values, by kind.",
        "shrunk",
    ),
    correlations=Key(
        parts(
            first=Key(text, "Name of the first."),
            second=Key(text, "Name of the second."),
            correlation=Key(
                Kind({"type": "number", "minimum": -1, "maximum": 1}), "Correlation, from -1 to 1.", "value"
            ),
        ),
        "Pairs of strongly correlated coefficients.",
    ),
    chi_square=Key(size | None, "Weighted sum of squared residuals.", "fit.chi_square"),
    degrees_of_freedom=Key(number | None, "Degrees of freedom of the fit.", "fit.degrees_of_freedom"),
    n_determined=Key(
        number | None, "How many coefficients the poses determine, not the priors.", "fit.determined", optional=True
    ),
    identifiability=Key(
        part(
            n_identifiable=Key(
                count, "Number of identifiable coefficients.", lambda identifiability: int(identifiability.columns.size)
            ),
            not_identifiable=Key(
                parts(
                    name=Key(text, "Name."),
                    partners=Key(array(text), "Coefficients that it is confounded with."),
                    why=Key(text, "Reason."),
                ),
                "Coefficients that are not identifiable on these poses.",
                "dropped",
            ),
            condition_number=Key(size | None, "Condition number of the scaled Jacobian.", "condition"),
            observability=Key(
                table(number | None),
                "Observability indices O1 to O5.",
                lambda identifiability: identifiability.observability(),
            ),
        ),
        "Identifiability of the coefficients on these poses.",
    ),
    leverage=Key(
        parts(
            line=Key(count, "Line of the file."), share=Key(share, "Leverage: the row's share in its own prediction.")
        ),
        "Rows with high leverage.",
        lambda calibration: [
            {"line": calibration.fit_inputs.data.line(i), "share": share} for i, share in calibration.leverage
        ],
    ),
    partial_residuals=Key(
        parts(name=Key(text, "Name of the effect."), joints=Key(array(text), "Joints of the effect."), **CURVE_KEYS),
        "Partial residuals of each effect that is not a constant.",
        lambda calibration: [
            {"name": effect.name, "joints": list(effect.joints), **CURVE.write(curve)}
            for effect, curve in calibration.partial_residuals
        ],
    ),
    outside_validity=OUTSIDE_KEY,
    gate=GATE_KEY,
).named(
    about="Named effects fitted to measured poses, with the error before and after on calibration poses and on "
    "held-out poses."
)


FINDING = part(
    effect=Key(text, "Name of the effect."),
    joints=Key(array(text), "Joints of the effect; empty if it acts on no particular joint."),
    settings=Key(table(), "Settings of the effect, if it has any."),
    alternatives=Key(
        parts(
            effect=Key(text, "Name of the effect."),
            joints=Key(array(text), "Joints of the effect; empty if it acts on no particular joint."),
            similarity=Key(share, "Cosine between the contributions of the two effects on these poses, 0 to 1."),
            evidence_difference=Key(
                number | None, "Evidence (log Bayes factor) of the finding minus that of the alternative."
            ),
            settings=Key(table(), "Settings of the effect, if it has any."),
        ),
        "Effects that are not distinguishable from the finding on these poses.",
    ),
    p_value=Key(
        share | None,
        "Posterior probability of the model without the effect, against that with it, prior odds of all candidates "
        "included; alternatives are not counted.",
        lambda finding: finite(finding.p_value),
    ),
    evidence=Key(
        number | None, "Evidence (log Bayes factor) for the finding.", lambda finding: finite(finding.evidence)
    ),
    size_at_tool_m=Key(
        size | None,
        "Rms over the calibration poses of the distance by which the effect alone moves the target, m; null "
        "if it cannot be evaluated.",
    ),
    largest_at_tool_m=Key(size | None, "Largest such distance, m."),
    held_out_before_m=Key(
        size | None,
        "Rms position error on held-out poses without the finding, m; null if there are too few poses, and "
        "for a frame, which every model needs.",
    ),
    held_out_after_m=Key(size | None, "Rms position error on held-out poses with the finding, m."),
    held_out_before_rad=Key(
        size | None,
        "Rms orientation error on held-out poses without the finding, rad; null where orientation is not "
        "measured, or as held_out_before_m.",
        lambda finding: finding.held_out_turn[0],
        optional=True,
    ),
    held_out_after_rad=Key(
        size | None,
        "Rms orientation error on held-out poses with the finding, rad.",
        lambda finding: finding.held_out_turn[1],
        optional=True,
    ),
    turn_at_tool_rad=Key(
        size | None,
        "Rms over the calibration poses of the angle by which the effect alone turns the target, rad; null "
        "where orientation is not measured, or as size_at_tool_m.",
        lambda finding: finding.turn_at_tool[0],
        optional=True,
    ),
    largest_turn_at_tool_rad=Key(
        size | None, "Largest such angle, rad.", lambda finding: finding.turn_at_tool[1], optional=True
    ),
    parameters=Key(array(PARAMETER), "Coefficients of the finding."),
    harmonics=Key(
        parts(
            order=Key(number, "Periods per turn."),
            amplitude_rad=Key(
                size, "Amplitude, rad, in amplitude x cos(order x q - phase) with the joint's commanded angle q."
            ),
            amplitude_std_rad=Key(size | None, "Standard error, rad; null if it is not identifiable."),
            phase_rad=Key(number, "Phase, rad, -pi to pi."),
            phase_std_rad=Key(size | None, "Standard error, rad; null if it is not identifiable."),
            origin=Key(text | None, "Physical origin that the order agrees with; null if there is none."),
            aliases=Key(array(number), "Other orders that the poses do not distinguish from it."),
        ),
        "Strong harmonics of a periodic effect.",
    ),
    statement=Key(text | None, "What the finding means and what to do; null if its coefficients say it."),
    change=Key(
        part(
            at=Key(number, "Time of the step, or line of the first pose after it.", lambda finding: finding.change[0]),
            low=Key(number, "First place of the 95 % interval.", lambda finding: finding.change[1]),
            high=Key(number, "Last place of the 95 % interval.", lambda finding: finding.change[2]),
            unit=Key(
                choice("s", "line"),
                "Unit of the three: s, or line for the line (or row) of the file.",
                lambda finding: "s" if "from_time_s" in finding.settings else "line",
            ),
        )
        | None,
        "Place of a step in the sequence of poses; null for every other effect.",
        lambda finding: None if finding.change is None else finding,
    ),
    validity=Key(
        table(array(number, 2)),
        "Range of each joint or driver that the finding was fitted on: low and high, in rad, m or the driver's unit.",
        lambda finding: {name: [low, high] for name, low, high in finding.validity},
    ),
    partial_residuals=Key(array(CURVE), "Residual over the driver of the effect."),
    implausible=Key(
        text | None, "Reason if coefficients are beyond what the effect can be; null if they are plausible."
    ),
    warnings=Key(array(text), "Warnings about the finding."),
)
"""One identified effect."""
_CANDIDATES = part(
    step=Key(count, "Step, from 0."),
    action=Key(text, "Action: add, drop, swap …"),
    effect=Key(text | None, "Chosen effect.", "chosen"),
    ranking=Key(
        parts(
            effect=Key(text, "Name of the effect.", "effect.name"),
            joints=Key(array(text), "Joints of the effect; empty if it acts on no particular joint.", "effect.joints"),
            settings=Key(
                table(), "Settings of the effect, if it has any.", lambda candidate: candidate.effect.settings()
            ),
            evidence=Key(number | None, "Evidence (log Bayes factor)."),
            log_prior=Key(number | None, "Logarithm of the prior probability."),
            p_value=Key(
                share | None, "Posterior probability that the effect is not there, beside the model at this step."
            ),
            explained=Key(number | None, "Share of the whitened squares that the candidate explains.", "gain"),
        ),
        "Candidates, the best first.",
    ),
)
"""Candidates of one step of a search."""
TRACE = part(
    verdict=Key(
        choice("clean", "explained", "partly_explained", "unexplained"),
        "clean: no finding and no remaining structure; otherwise, how far the findings explain the residual.",
    ),
    assumption=Key(
        text | None,
        "What the verdict presumes where the measurement noise is known from the residual alone; else null.",
    ),
    **_FIT,
    findings=Key(array(FINDING), "Identified effects, in the order in which they were added."),
    undeclared_load=Key(
        part(
            statement=Key(text, "What the torques point to, in one sentence."),
            joints=Key(array(text), "Joints whose deflections show it."),
            named=Key(
                flag,
                "Whether a load on one link is far more likely than errors of the file's masses alone: "
                "odds of 150 to 1, divided by the number of hypotheses.",
                "is_named",
            ),
            mass_error=Key(size, "Relative error of the file's masses that explains the torques best without a load."),
            places=Key(
                parts(
                    link=Key(text, "Joint that moves the link."),
                    mass_kg=Key(
                        number, "Median of the load, kg; negative if the link is lighter than the file states.", "mass"
                    ),
                    low_kg=Key(number, "Lower end of the 95 % credible interval, kg.", "low"),
                    high_kg=Key(number, "Upper end, kg.", "high"),
                    log_bayes_factor=Key(
                        number,
                        "Natural logarithm of the marginal likelihood over that of errors of the file's masses alone.",
                    ),
                ),
                "Links that the poses do not distinguish, best first; the best alone if no load is named.",
            ),
        )
        | None,
        "Whether the torques point to a load on one link that the robot file does not state; null unless a "
        "joint_compliance has uncertain masses.",
    ),
    explained_share=Key(
        share | None,
        "Share of the baseline's held-out variance above noise and repeatability that the findings explain; "
        "null where nothing was held out or nothing is above the noise.",
    ),
    unexplained=Key(
        part(
            rms_m=Key(size | None, "Rms length of the residual, m."),
            noise_rms_m=Key(
                size | None,
                "Rms length of the measurement noise, m; null if the noise was estimated from the residual.",
            ),
            structured=Key(flag, "True if the remaining error has structure beyond noise."),
            p_value=Key(share, "p-value of no structure."),
            hints=Key(array(text), "Dependences of the remaining error."),
            parts=Key(
                part(
                    noise_m=Key(size, "Measurement noise, m."),
                    scatter_m=Key(size, "Scatter of the joints from visit to visit, m.", optional=True),
                    pose_m=Key(size, "Error that depends on the pose and has no cause, m.", optional=True),
                    wander_m=Key(size, "Slow random error over time, m.", optional=True),
                ),
                "Parts of the remaining error, rms at the target; those that the data show.",
                lambda it: {f"{part}_m": size for part, size in it.parts.items()},
            ),
        ),
        "Remaining error of the extended model.",
    ),
    search=Key(
        part(
            steps=Key(count, "Steps of all selections: number of candidates.", lambda trace: len(trace.steps)),
            settled=Key(flag, "True if the search ended because no move gained."),
        ),
        "Length of the search.",
        "",
    ),
    candidates=Key(
        array(_CANDIDATES),
        "Candidates of each step, with their scores.",
        lambda trace: [_CANDIDATES.write(step, step=i) for i, step in enumerate(trace.steps)],
    ),
    next_poses=Key(
        parts(
            text=Key(text, "Description."),
            q=Key(array(array(number)), "Joint variables of each pose, rad or m."),
            difference_m=Key(array(number), "Distance between the target positions that the two effects predict, m."),
        ),
        "Poses that would distinguish a finding from an alternative.",
    ),
    not_offered=Key(
        parts(effect=Key(text, "Name of the effect."), why=Key(text, "Reason: missing data or robot properties.")),
        "Effects that are not candidates, with the reason.",
        lambda trace: [{"effect": name, "why": why} for name, why in trace.missing.items()],
    ),
    detection_limits=Key(
        parts(
            effect=Key(text, "Name of the effect."),
            joints=Key(array(text), "Joints of the effect; empty if it acts on no particular joint."),
            settings=Key(table(), "Settings of the effect, if it has any."),
            limit=Key(size | None, "Detection limit in the unit; null if no realistic size would be found."),
            unit=Key(text, "Unit of limit."),
            rms_m=Key(size | None, "Rms displacement of the target over the poses by an effect of that size, m."),
        ),
        "Detection limits: the size of each effect that is found on these poses with probability 1/2.",
        "detection",
    ),
    outside_validity=OUTSIDE_KEY,
    gate=GATE_KEY,
).named(about="Identified effects of measured poses, with the error before and after on held-out poses.")
