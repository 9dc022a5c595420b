"""What to expect: ``robacc.predict/1`` and ``robacc.plan/1`` in m and rad, and the prediction of every pose as CSV."""

import dataclasses
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np

from robacc.documents.envelope import GATE_KEY
from robacc.documents.keys import (
    NOTES,
    OUTSIDE_KEY,
    QUANTITIES,
    REGISTERED_PARAMETER,
    ROBOT,
    Document,
    Key,
    Kind,
    array,
    choice,
    constant,
    count,
    flag,
    integer,
    matrix3,
    number,
    ordinal,
    part,
    parts,
    robot_document,
    rounded,
    rows3,
    share,
    size,
    table,
    text,
    texts,
    vector3,
)
from robacc.planning.candidates import targets_in_base
from robacc.prediction.predicting import warranty_map
from robacc.robots.description import Frame

if TYPE_CHECKING:
    from robacc.planning.campaign import CampaignPlan

# A prediction.

COVERED = part(
    n_poses=Key(ordinal, "Measured poses."),
    n_inside=Key(count, "Measured poses within their bounds."),
    share=Key(share, "Share of the measured poses within their bounds."),
    noise_source=Key(
        choice("given", "file", "fit"),
        "Source of the measurement noise in the bounds: given, columns of the file, or the fit of the model.",
    ),
).named("covered", "Measured poses within their bounds.")

CHI_SQUARE = part(
    statistic=Key(size, "Sum of squares over their predicted variances."),
    dof=Key(count, "Degrees of freedom."),
    lower=Key(size, "Lower limit of the 95 % range of the statistic."),
    upper=Key(size, "Upper limit of the 95 % range of the statistic."),
    p_value=Key(share, "Two-sided p-value."),
    ratio=Key(size, "Statistic over degrees of freedom."),
).named("chi_square", "Normalised squared error; null if it is not available.")

PERCENTILES = part(
    p5=Key(size, "5th percentile."),
    p25=Key(size, "25th percentile."),
    p50=Key(size, "50th percentile."),
    p75=Key(size, "75th percentile."),
    p95=Key(size, "95th percentile."),
).named("percentiles", "Percentiles over poses.")

_SHARE = part(
    name=Key(text, "Name of the joint or kind."),
    share_position=Key(share, "Share of the position variance; all shares sum to 1."),
    share_orientation=Key(share, "Share of the orientation variance; all shares sum to 1."),
).named("share", "Contribution of one source to the predicted variance.")

_ERRORS = {
    unit: part(
        **{
            f"rms_{unit}": Key(size, f"Rms over robots and poses, {unit}."),
            f"mean_error_{unit}": Key(size, f"Mean length over robots and poses, {unit}."),
            f"p95_{unit}": Key(size, f"95th percentile over robots and poses, {unit}."),
            f"max_radius95_{unit}": Key(size, f"Largest of the poses' 95 % radii, {unit}.", "max"),
            f"mean_covariance_{unit}2": Key(
                matrix3, f"Mean covariance over poses, {unit}².", lambda errors: np.mean(errors.covariance, axis=2)
            ),
            "percentiles_over_poses": Key(
                part(
                    **{
                        f"rms_{unit}": Key(PERCENTILES, source=lambda errors: errors.percentiles(errors.pose_rms)),
                        f"radius95_{unit}": Key(
                            PERCENTILES, source=lambda errors: errors.percentiles(errors.pose_radius95)
                        ),
                    }
                ),
                "Percentiles over poses.",
                "",
            ),
            "worst": Key(
                part(
                    **{
                        "pose": Key(count, "Number of the pose, from 0."),
                        "label": Key(text, "Label of the pose."),
                        "q": Key(array(number), "Joint variables, rad or m."),
                        f"rms_{unit}": Key(size, f"Rms {name} error, {unit}."),
                        f"radius95_{unit}": Key(size, f"Radius that contains 95 % of the errors at this pose, {unit}."),
                        "direction": Key(vector3, "Direction of the largest error: unit vector in the tool frame."),
                        f"sd_{unit}": Key(size, f"Standard deviation along the direction, {unit}."),
                    }
                ),
                "The pose with the largest predicted rms.",
            ),
            f"covariance_{unit}2": Key(
                array(matrix3),
                f"Covariance at each pose, {unit}²: equations (7), (8).",
                lambda errors: np.moveaxis(errors.covariance, -1, 0),
            ),
            f"pose_rms_{unit}": Key(array(size), f"Rms at each pose, {unit}."),
            f"pose_radius95_{unit}": Key(array(size), f"Radius that contains 95 % of the errors at each pose, {unit}."),
        }
    )
    for unit, name in QUANTITIES
}
"""Predicted errors by unit."""


PREDICT = part(
    n_poses=Key(count, "Number of configurations.", "configurations.n"),
    frame=Key(choice("tool"), "Axes of the covariances.", lambda _: "tool"),
    configurations=Key(text, "Source of the configurations.", "configurations.source"),
    tolerances=Key(
        part(
            meaning=Key(text, "Conversion of a tolerance to a variance."),
            parameters=Key(
                parts(
                    parameter=Key(text, "Parameter, as joint.kind.", "name"),
                    joint=Key(text | None, "Joint; null for base and tool."),
                    kind=Key(text, "Kind of parameter: theta, d, a, alpha …"),
                    sd=Key(size, "Standard deviation, in the unit."),
                    unit=Key(text, "m or rad."),
                ),
                "All parameters with a tolerance.",
            ),
        ),
        "Tolerances behind the prediction.",
        "",
    ),
    position=Key(_ERRORS["m"], "Predicted position errors, m, tool frame."),
    orientation=Key(_ERRORS["rad"], "Predicted orientation errors, rad, tool frame."),
    budget=Key(
        parts(
            parameter=Key(text, "Parameter, as joint.kind."),
            joint=Key(text | None, "Joint; null for base and tool."),
            kind=Key(text | None, "Kind of parameter: theta, d, a, alpha …"),
            sd=Key(size | None, "Standard deviation, in the unit."),
            unit=Key(text | None, "m or rad."),
            share_position=Key(share, "Share of the position variance."),
            share_orientation=Key(share, "Share of the orientation variance."),
        ),
        "Error budget by parameter, the largest share of position first; shares sum to 1.",
    ),
    budget_by_joint=Key(array(_SHARE), "Error budget by joint.", "by_joint"),
    budget_by_kind=Key(array(_SHARE), "Error budget by kind of parameter.", "by_kind"),
    grade=Key(
        part(
            grade=Key(text, "Grade by the predicted statistic."),
            scale=Key(text, "Name of the scale."),
            statistic=Key(choice("rms", "mean_error", "p95", "max"), "Statistic that the limits apply to."),
            position=Key(text, "Grade of position alone."),
            orientation=Key(text, "Grade of orientation alone."),
            limited_by=Key(array(text), "Quantities that prevent a better grade."),
            demonstrated=Key(constant(False), "Always false: a prediction is not a measurement."),
            share_of_poses_meeting=Key(table(share), "Share of poses that meet each grade."),
        ),
        "Grade of the prediction.",
    ),
    allocation=Key(
        part(
            grade=Key(text, "Required grade."),
            met=Key(flag, "True if the allocated tolerances reach the grade."),
            uniform_factor=Key(size, "Common factor for all tolerances that would reach the grade."),
            tolerances=Key(
                parts(
                    parameter=Key(text, "Parameter, as joint.kind."),
                    joint=Key(text | None, "Joint, or null."),
                    given_sd=Key(size, "Given tolerance, one standard deviation, in the unit."),
                    needed_sd=Key(size, "Needed tolerance, one standard deviation, in the unit."),
                    factor=Key(size, "Needed over given tolerance."),
                    unit=Key(text, "m or rad."),
                ),
                "Tolerance of each parameter.",
            ),
            verified=Key(
                part(
                    grade=Key(text, "Reached grade.", lambda verified: verified.grade["grade"]),
                    position=Key(
                        part(
                            rms_m=Key(size, "Rms position error, m."),
                            p95_m=Key(size, "95th percentile of the position error, m."),
                        )
                    ),
                    orientation=Key(
                        part(
                            rms_rad=Key(size, "Rms orientation error, rad."),
                            p95_rad=Key(size, "95th percentile of the orientation error, rad."),
                        )
                    ),
                ),
                "Prediction with the allocated tolerances.",
            ),
        )
        | None,
        "Tolerances that would reach the required grade; null without one.",
    ),
    against=Key(
        part(
            n_poses=Key(count, "Measured poses."),
            measured=Key(
                part(
                    position_rms_m=Key(size, "Rms position error, m."),
                    orientation_rms_rad=Key(size | None, "Rms orientation error, rad, or null."),
                ),
                "Measured errors after the registration.",
            ),
            alignment=Key(
                part(
                    what=Key(array(text), "Fitted frames: base_frame, tool_frame or both."),
                    degrees_of_freedom=Key(count, "Degrees of freedom of the registration."),
                    parameters=Key(array(REGISTERED_PARAMETER), "Fitted coefficients."),
                )
                | None,
                "Frames registered to the poses; null without a registration.",
            ),
            noise=Key(
                part(
                    position_m=Key(size | None, "Standard deviation along an axis, m."),
                    orientation_rad=Key(size | None, "Standard deviation about an axis, rad, or null."),
                    source_position=Key(text, "Source of the value."),
                    source_orientation=Key(text | None, "Source of the value."),
                ),
                "Measurement noise along and about an axis.",
            ),
            verdict=Key(text, "Verdict on the consistency."),
            hint=Key(text | None, "Likely cause of errors that are too large for any tolerance."),
            normalised_squared_error=Key(
                part(total=Key(CHI_SQUARE | None), parameters=Key(CHI_SQUARE | None), noise=Key(CHI_SQUARE | None)),
                "Normalised squared error of all numbers, of the directions that the parameters affect, "
                "and of the other directions.",
            ),
            likelihood_ratio=Key(
                part(
                    factor=Key(size, "Estimated scale of all tolerances: 1 as predicted."),
                    statistic=Key(number, "Statistic of the test."),
                    p_value=Key(share, "p-value from draws of the prediction."),
                    p_value_asymptotic=Key(share, "p-value from a chi-square distribution, for comparison."),
                    draws=Key(count, "Number of draws."),
                )
                | None,
                "Likelihood-ratio test of a common scale of all tolerances; null if no parameter is identifiable.",
            ),
            variance_components=Key(
                part(
                    confidence=Key(share, "Confidence of the intervals."),
                    components=Key(
                        parts(
                            name=Key(text, "Kind of parameter: theta, d, a, alpha …"),
                            n_parameters=Key(count, "Number of parameters of the kind."),
                            unit=Key(text, "m or rad."),
                            predicted=Key(size, "Rms standard deviation, in the unit."),
                            factor=Key(size, "Estimated over predicted standard deviation."),
                            estimate=Key(size, "Estimate in the unit."),
                            lower=Key(size | None, "Lower limit of factor."),
                            upper=Key(size | None, "Upper limit of factor; null if there is none."),
                            dof=Key(size | None, "Effective degrees of freedom."),
                            likelihood_ratio=Key(number | None, "Likelihood ratio of the prediction for this kind."),
                            why=Key(text | None, "Reason why the kind is not identifiable, or null."),
                        ),
                        "Components by kind.",
                    ),
                    notes=Key(array(text), "Notes on the components."),
                )
                | None,
                "Estimated tolerance of each kind; null if none is identifiable.",
            ),
            one_draw=Key(text, "Limitation: the poses come from one robot."),
        )
        | None,
        "Comparison of the prediction with measured poses; null without them.",
        "comparison",
    ),
    coverage=Key(
        part(
            probability=Key(share, "Probability of the bound."),
            registered=Key(
                array(text),
                "Frames fitted to one half of the measured poses for the errors of the other half; empty without.",
            ),
            position=Key(COVERED, "Positions within their bounds."),
            orientation=Key(
                COVERED | None, "Orientations within their bounds; null where the poses or the fit have none."
            ),
        )
        | None,
        "Measured poses within the bound of their error; null without them, and for tolerances.",
    ),
    **NOTES,
    warranty_map=Key(
        part(
            voxel_m=Key(Kind({"type": "number", "exclusiveMinimum": 0}), "Edge of a voxel, m."),
            centre_m=Key(rows3, "Centre of each voxel in the measuring frame, m."),
            configurations=Key(array(ordinal), "Number of configurations in each voxel."),
            bound95_m=Key(array(size), "Largest 95 % bound of position in each voxel, m."),
            bound95_rad=Key(array(size), "Largest 95 % bound of orientation in each voxel, rad."),
            grade=Key(array(text), "Grade that every configuration of each voxel meets."),
        )
        | None,
        "Grade by voxel of the workspace, of a prediction from the fit of a model; else null.",
        lambda result: None if result.parameters else warranty_map(result, result.reached)[0],
    ),
    robot=Key(ROBOT | None, source=lambda result: robot_document(result.robot, result.configurations.q)),
    poses=Key(
        part(
            label=Key(array(text), "Label of each pose.", lambda result: list(result.configurations.labels)),
            q=Key(array(array(number)), "Joint variables, rad or m.", lambda result: rounded(result.configurations.q)),
            commanded_m=Key(
                rows3, "Position of the target in the measuring frame, m.", lambda result: rounded(result.reached)
            ),
        ),
        "Poses of the prediction.",
        "",
    ),
    outside_validity=OUTSIDE_KEY,
    gate=GATE_KEY,
).named(about="Covariances, error budget and grade predicted from parameter tolerances.")


# A plan of a measurement.

_POINT = part(
    n_poses=Key(ordinal, "Number of poses."),
    rms_m=Key(size, "Root mean variance over the region, from the uncertainty of the coefficients, m."),
    worst_m=Key(size, "The same at the worst task pose, m."),
    total_rms_m=Key(size, "The same with repeatability and unexplained error, which no fit removes, m."),
    random_rms_m=Key(
        size | None,
        "Mean of rms_m over draws of as many random feasible poses, m; null where they do not identify the model.",
    ),
)
"""Predicted accuracy for a number of poses."""


def _visits(plan: "CampaignPlan") -> Document:
    visits = plan.visits
    return {
        "pose": texts(visits.pose),
        "role": list(plan.route.roles),
        "q": rounded(visits.q),
        "direction": None if visits.direction is None else visits.direction.T.astype(int),
        "speed": rounded(visits.speed),
        "payload_kg": visits.payload,
        "target_in_base_m": rounded(plan.candidates.position[:, plan.chosen[plan.route.visits]]),
    }


PLAN = part(
    purpose=Key(choice("calibrate", "trace", "acceptance", "health"), "Purpose of the measurement."),
    criterion=Key(
        choice("I", "G", "D", "A") | None,
        "Criterion of the choice: mean (I) or worst (G) predicted error, determinant (D) or sum of variances "
        "(A) of the coefficients; null where the purpose sets it.",
        lambda plan: plan.criterion if plan.purpose == "calibrate" else None,
    ),
    n_poses=Key(ordinal, "Number of different poses.", lambda plan: int(plan.chosen.size)),
    n_visits=Key(ordinal, "Number of visits, with repeats and drift checks.", lambda plan: len(plan.route.roles)),
    fit=Key(text, "Effects that the fit leaves free."),
    candidates=Key(
        part(
            source=Key(text, "Origin of the candidates."),
            drawn=Key(count, "Number of candidates before the filters.", "n_drawn"),
            feasible=Key(count, "Number of feasible candidates that were chosen from.", "n_poses"),
            in_sockets=Key(flag, "Whether the target is in sockets, so that its place need not be measured."),
            excluded=Key(
                parts(
                    reason=Key(text, "Reason."),
                    count=Key(count, "Candidates that the reason excludes."),
                    alone=Key(count, "Candidates that no other reason excludes."),
                ),
                "Candidates excluded, by reason, the largest first.",
            ),
        ),
        "Poses that were chosen from.",
    ),
    collisions=Key(
        part(
            pairs=Key(array(array(text)), "Links of each pair that was checked."),
            overlapping=Key(
                array(array(text)), "Links of each pair that was not checked, because they touch at nearly all poses."
            ),
        )
        | None,
        "Pairs of links that were checked for collisions; null without a check of collisions.",
        "constraints.collisions",
    ),
    noise=Key(
        part(
            position_m=Key(size, "Instrument along each axis, m.", "noise.position"),
            orientation_rad=Key(
                size | None,
                "Instrument about each axis, rad; null where orientation is not measured.",
                "noise.orientation",
            ),
            repeatability_joints=Key(array(number), "Repeatability of each joint, rad or m.", "noise.joints"),
            repeatability_m=Key(size, "Repeatability of the target along each axis, m rms over the task."),
            unexplained_m=Key(
                size, "Error of the model that stays the same at a pose, along each axis, m.", "noise.unexplained"
            ),
            source=Key(text, "Origin of the figures.", "noise.source"),
        ),
        "Errors that no model predicts, standard deviations.",
        "",
    ),
    visits=Key(
        part(
            pose=Key(array(text), "Name of the pose."),
            role=Key(array(choice("pose", "repeat", "check")), "pose, repeat (a second visit) or check (drift check)."),
            q=Key(array(array(number)), "Joint variables, rad or m."),
            direction=Key(array(array(integer)), "Direction of approach of each joint: -1, 0 or 1."),
            speed=Key(array(array(number)), "Last speed of each joint as a fraction of full speed, signed."),
            payload_kg=Key(array(number) | None, "Payload at each visit, kg; null where no payload was given."),
            target_in_base_m=Key(
                array(array(number)),
                "Nominal position of the target in the base frame, m; the mean of several targets.",
            ),
        ),
        "Visits in order; each list has an entry for each visit.",
        _visits,
    ),
    route=Key(
        part(
            passes=Key(ordinal, "Number of passes through the workspace."),
            length=Key(size, "Sum over all moves of the largest joint move, in ranges of the planned poses."),
            random_length=Key(size, "The same in a random order."),
            rarer_direction_share=Key(
                array(number), "Share of the rarer direction among the approaches of each joint; 0.5 is balanced."
            ),
            speed_std=Key(array(number), "Standard deviation of the size of each joint's relative last speed."),
            drift_share=Key(size, "Share of a drift linear in time that a linear function of the joints explains."),
            repeats=Key(count, "Number of second visits."),
            checks=Key(count, "Number of visits of the drift check pose."),
        ),
        "Figures of the order.",
        "route.figures",
    ),
    payloads=Key(
        parts(
            payload_kg=Key(size, "Payload, kg."),
            first_visit=Key(ordinal, "Number of the first visit, from 1."),
            n_visits=Key(ordinal, "Number of visits."),
            n_poses=Key(ordinal, "Number of different poses."),
        ),
        "Payloads in the order in which they are mounted; empty where no payload was given.",
        "payload_blocks",
    ),
    validation=Key(
        part(
            q=Key(
                array(array(number)), "Joint variables of each pose, rad or m.", lambda plan: rounded(plan.validation.q)
            ),
            payload_kg=Key(
                array(number) | None, "Payload of each pose, kg; null where no payload was given.", "validation.payload"
            ),
            target_in_base_m=Key(
                array(array(number)),
                "Nominal position of the target in the base frame, m; the mean of several targets.",
                lambda plan: rounded(targets_in_base(plan.robot, plan.validation.q)),
            ),
        )
        | None,
        "Validation poses in order; null without.",
        lambda plan: None if plan.validation is None else plan,
    ),
    instrument_in_base_m=Key(
        array(number) | None,
        "Position of the instrument in the base frame, m; null if it was not given.",
        "constraints.sight.position",
    ),
    robot=Key(
        ROBOT,
        "Robot, with its outline in the base frame.",
        lambda plan: robot_document(dataclasses.replace(plan.robot, base=Frame()), plan.visits.q),
    ),
    coefficients=Key(
        parts(
            name=Key(text, "Name, effect.joint.term."),
            unit=Key(text, "Unit."),
            std=Key(size | None, "Predicted standard error; null if it is not identifiable."),
            prior_std=Key(size | None, "Prior standard deviation in the choice of poses."),
            why=Key(text | None, "Reason if std is null."),
        ),
        "Coefficients of the fit.",
    ),
    correlations=Key(
        parts(
            first=Key(text, "Name of a coefficient."),
            second=Key(text, "Name of the other."),
            value=Key(number, "Correlation."),
        ),
        "Pairs of coefficients whose estimates will be strongly correlated.",
    ),
    accuracy=Key(
        part(
            planned=Key(_POINT | None, "The planned poses; null where they do not identify the model."),
            curve=Key(array(_POINT), "Over the number of poses."),
            of_tracker=Key(
                _POINT | None,
                "As many poses anywhere, measured with the typical noise; null unless the candidates are in sockets.",
            ),
            knee=Key(
                integer | None,
                "Number of poses from which ten more reduce the error by less than a tenth; null beyond the curve.",
            ),
        )
        | None,
        "Predicted accuracy after calibration; null for other purposes.",
    ),
    worth=Key(
        part(
            new_poses_rms_m=Key(number | None, "Twice as many poses, m."),
            repeated_poses_rms_m=Key(number | None, "Every pose visited twice, m."),
            readings_rms_m=Key(number | None, "Every pose read twice at one visit, m."),
            verdict=Key(text, "Comparison in words."),
        )
        | None,
        "Predicted error for the same number of measurements, spent in different ways; null for other purposes.",
    ),
    detection_limits=Key(
        parts(
            effect=Key(text, "Name of the effect."),
            joints=Key(array(text), "Joints."),
            settings=Key(table(), "Settings of the form."),
            limit=Key(number | None, "Size found with probability 1/2; null if no plausible size is found."),
            unit=Key(text, "Unit of limit and usual_size."),
            usual_size=Key(size, "Geometric mean of the catalogue's usual sizes."),
            power=Key(share, "Probability that an effect of the usual size is found."),
            rms_m=Key(
                number | None, "Displacement of the target by an effect of the limit's size, m rms over the visits."
            ),
        )
        | None,
        "Detection limit of every form of an effect; null for acceptance.",
        lambda plan: plan.detectability and plan.detectability["limits"],
    ),
    inseparable=Key(
        parts(
            first=Key(text, "An effect of its usual size."),
            second=Key(text, "The effect that explains it."),
            similarity=Key(share, "Largest cosine between their columns."),
            evidence=Key(size, "Expected difference in evidence (log Bayes factor)."),
        )
        | None,
        "Pairs of detectable effects of which the second explains the first within the noise; null for acceptance.",
        lambda plan: plan.detectability and plan.detectability["pairs"],
    ),
    not_testable=Key(
        table() | None,
        "Reason why an effect cannot be tested on these poses, by effect; null for acceptance.",
        lambda plan: plan.detectability and plan.detectability["missing"],
    ),
    power=Key(
        part(
            found=Key(share, "Probability that a coefficient is found."),
            separated=Key(share, "Probability that it is found and distinguished from the most similar effect."),
            random_found=Key(share, "found, for random candidates in the same number."),
            random_separated=Key(share, "separated, for random candidates in the same number."),
        )
        | None,
        "Mean probabilities over the coefficients of the catalogue at their usual sizes, before repeats and "
        "checks; null unless the purpose is trace.",
    ),
    needed_poses=Key(
        parts(
            name=Key(text, "Name of the criterion or grade."),
            statistic=Key(choice("rms", "mean_error", "p95", "max"), "Statistic of the position error."),
            limit_m=Key(size, "Limit, m."),
            confidence=Key(share, "Confidence of the bound."),
            true_over_limit=Key(size, "True value over the limit that the number is for."),
            n_poses=Key(integer | None, "Poses that decide with probability 0.9; null if too many."),
            by_ratio=Key(
                parts(
                    true_over_limit=Key(size, "True value over the limit."),
                    n_poses=Key(integer | None, "Poses that decide; null if too many."),
                ),
                "The same for other true values.",
            ),
        ),
        "Numbers of poses that decide the limits of an acceptance test.",
        "needed",
    ),
    sufficiency=Key(
        part(
            n_already=Key(count, "Number of poses measured already, or of the model's fit."),
            enough=Key(flag, "Whether they are enough."),
            why=Key(text, "Reason."),
            now_m=Key(number | None, "Predicted error now, with repeatability, m rms."),
            later_m=Key(number | None, "The same with the next poses, m rms."),
            of_model=Key(
                flag, "Whether the poses are those that the model was fitted to, in place of poses measured already."
            ),
        )
        | None,
        "Answer to whether the poses measured already are enough; null without such poses.",
    ),
    file_sha256=Key(text, "SHA-256 of the CSV of the visits.", lambda plan: sha256(plan.csv().encode()).hexdigest()),
).named(about="Plan of a measurement: visits in order, and the expected result.")
