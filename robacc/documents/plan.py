"""Keys of ``robacc.plan/1`` in m and rad."""

from __future__ import annotations

import dataclasses
from hashlib import sha256
from typing import TYPE_CHECKING

from robacc.documents.keys import (
    Document,
    Key,
    array,
    choice,
    count,
    flag,
    integer,
    number,
    ordinal,
    part,
    share,
    size,
    table,
    text,
)
from robacc.documents.parts import ROBOT, robot_document, rounded, texts
from robacc.planning.candidates import targets_in_base
from robacc.robots.description import Frame

if TYPE_CHECKING:
    from robacc.planning.campaign import CampaignPlan

_POINT = part(
    {
        "n_poses": Key(ordinal, "Number of poses.", "n"),
        "rms_m": Key(
            size,
            "Root mean variance over the region, from the uncertainty of the coefficients, m.",
        ),
        "worst_m": Key(size, "The same at the worst task pose, m."),
        "total_rms_m": Key(
            size,
            "The same with repeatability and unexplained error, which no fit removes, m.",
            "total",
        ),
        "random_rms_m": Key(
            size | None,
            "Mean of rms_m over draws of as many random feasible poses, m; null where they do not identify the model.",
        ),
    }
)
"""Predicted accuracy for a number of poses."""


def _visits(plan: CampaignPlan) -> Document:
    visits = plan.visits()
    return {
        "pose": texts(visits.pose),
        "role": list(plan.route.roles),
        "q": rounded(plan.q),
        "direction": None if visits.direction is None else visits.direction.T.astype(int),
        "speed": rounded(visits.speed),
        "payload_kg": plan.payload_kg,
        "target_in_base_m": rounded(plan.candidates.position[:, plan.chosen[plan.route.visits]]),
    }


PLAN = part(
    {
        "purpose": Key(
            choice("calibrate", "trace", "acceptance", "health"), "Purpose of the measurement.", "settings.purpose"
        ),
        "criterion": Key(
            choice("I", "G", "D", "A") | None,
            (
                "Criterion of the choice: mean (I) or worst (G) predicted error, determinant (D) or sum of variances "
                "(A) of the coefficients; null where the purpose sets it."
            ),
            lambda plan: plan.settings.criterion if plan.settings.purpose == "calibrate" else None,
        ),
        "n_poses": Key(ordinal, "Number of different poses.", lambda plan: int(plan.chosen.size)),
        "n_visits": Key(
            ordinal, "Number of visits, with repeats and drift checks.", lambda plan: len(plan.route.roles)
        ),
        "fit": Key(text, "Effects that the fit leaves free.", "settings.fit"),
        "candidates": Key(
            part(
                {
                    "source": Key(text, "Origin of the candidates."),
                    "drawn": Key(count, "Number of candidates before the filters.", "n_drawn"),
                    "feasible": Key(count, "Number of feasible candidates that were chosen from.", "n_poses"),
                    "excluded": Key(
                        array(
                            part(
                                {
                                    "reason": Key(text, "Reason."),
                                    "count": Key(count, "Candidates that the reason excludes."),
                                    "alone": Key(count, "Candidates that no other reason excludes."),
                                }
                            )
                        ),
                        "Candidates excluded, by reason, the largest first.",
                    ),
                }
            ),
            "Poses that were chosen from.",
        ),
        "collisions": Key(
            part(
                {
                    "pairs": Key(
                        array(array(text)),
                        "Links of each pair that was checked.",
                    ),
                    "overlapping": Key(
                        array(array(text)),
                        "Links of each pair that was not checked, because they touch at nearly all poses.",
                    ),
                }
            )
            | None,
            "Pairs of links that were checked for collisions; null without a check of collisions.",
            "settings.constraints.collisions",
        ),
        "noise": Key(
            part(
                {
                    "position_m": Key(size, "Instrument along each axis, m.", "noise.position"),
                    "orientation_rad": Key(
                        size | None,
                        "Instrument about each axis, rad; null where orientation is not measured.",
                        "noise.orientation",
                    ),
                    "repeatability_joints": Key(
                        array(number), "Repeatability of each joint, rad or m.", "noise.joints"
                    ),
                    "repeatability_m": Key(size, "Repeatability of the target along each axis, m rms over the task."),
                    "unexplained_m": Key(
                        size,
                        "Error of the model that stays the same at a pose, along each axis, m.",
                        "noise.unexplained",
                    ),
                    "source": Key(text, "Origin of the figures.", "noise.source"),
                }
            ),
            "Errors that no model predicts, standard deviations.",
            "",
        ),
        "visits": Key(
            part(
                {
                    "pose": Key(array(text), "Name of the pose."),
                    "role": Key(
                        array(choice("pose", "repeat", "check")),
                        "pose, repeat (a second visit) or check (drift check).",
                    ),
                    "q": Key(array(array(number)), "Joint variables, rad or m."),
                    "direction": Key(
                        array(array(integer)),
                        "Direction of approach of each joint: -1, 0 or 1.",
                    ),
                    "speed": Key(
                        array(array(number)),
                        "Last speed of each joint as a fraction of full speed, signed.",
                    ),
                    "payload_kg": Key(
                        array(number) | None, "Payload at each visit, kg; null where no payload was given."
                    ),
                    "target_in_base_m": Key(
                        array(array(number)),
                        "Nominal position of the target in the base frame, m; the mean of several targets.",
                    ),
                }
            ),
            "Visits in order; each list has an entry for each visit.",
            _visits,
        ),
        "route": Key(
            part(
                {
                    "passes": Key(ordinal, "Number of passes through the workspace."),
                    "length": Key(
                        size, "Sum over all moves of the largest joint move, in ranges of the planned poses."
                    ),
                    "random_length": Key(size, "The same in a random order."),
                    "rarer_direction_share": Key(
                        array(number),
                        "Share of the rarer direction among the approaches of each joint; 0.5 is balanced.",
                        "direction_share",
                    ),
                    "speed_std": Key(
                        array(number), "Standard deviation of the size of each joint's relative last speed."
                    ),
                    "drift_share": Key(
                        size, "Share of a drift linear in time that a linear function of the joints explains."
                    ),
                    "repeats": Key(count, "Number of second visits.", lambda it: it.roles.count("repeat")),
                    "checks": Key(
                        count, "Number of visits of the drift check pose.", lambda it: it.roles.count("check")
                    ),
                }
            ),
            "Figures of the order.",
        ),
        "payloads": Key(
            array(
                part(
                    {
                        "payload_kg": Key(size, "Payload, kg.", "payload"),
                        "first_visit": Key(ordinal, "Number of the first visit, from 1.", "first"),
                        "n_visits": Key(ordinal, "Number of visits."),
                        "n_poses": Key(ordinal, "Number of different poses."),
                    }
                )
            ),
            "Payloads in the order in which they are mounted; empty where no payload was given.",
            "payload_blocks",
        ),
        "validation": Key(
            part(
                {
                    "q": Key(
                        array(array(number)),
                        "Joint variables of each pose, rad or m.",
                        lambda plan: rounded(plan.validation.q),
                    ),
                    "payload_kg": Key(
                        array(number) | None,
                        "Payload of each pose, kg; null where no payload was given.",
                        "validation.payload",
                    ),
                    "target_in_base_m": Key(
                        array(array(number)),
                        "Nominal position of the target in the base frame, m; the mean of several targets.",
                        lambda plan: rounded(targets_in_base(plan.robot, plan.validation.q)),
                    ),
                }
            )
            | None,
            "Validation poses in order; null without.",
            lambda plan: None if plan.validation is None else plan,
        ),
        "instrument_in_base_m": Key(
            array(number) | None,
            "Position of the instrument in the base frame, m; null if it was not given.",
            "settings.constraints.sight.position",
        ),
        "robot": Key(
            ROBOT,
            "Robot, with its outline in the base frame.",
            lambda plan: robot_document(dataclasses.replace(plan.robot, base=Frame()), plan.q),
        ),
        "coefficients": Key(
            array(
                part(
                    {
                        "name": Key(text, "Name, effect.joint.term."),
                        "unit": Key(text, "Unit."),
                        "std": Key(size | None, "Predicted standard error; null if it is not identifiable."),
                        "prior_std": Key(size | None, "Prior standard deviation in the choice of poses."),
                        "why": Key(text | None, "Reason if std is null."),
                    }
                )
            ),
            "Coefficients of the fit.",
        ),
        "correlations": Key(
            array(
                part(
                    {
                        "first": Key(text, "Name of a coefficient."),
                        "second": Key(text, "Name of the other."),
                        "value": Key(number, "Correlation."),
                    }
                )
            ),
            "Pairs of coefficients whose estimates will be strongly correlated.",
        ),
        "accuracy": Key(
            part(
                {
                    "planned": Key(
                        _POINT | None,
                        "The planned poses; null where they do not identify the model.",
                    ),
                    "curve": Key(
                        array(_POINT),
                        "Over the number of poses.",
                        "points",
                    ),
                    "knee": Key(
                        integer | None,
                        (
                            "Number of poses from which ten more reduce the error by less than a tenth; null beyond "
                            "the curve."
                        ),
                    ),
                }
            )
            | None,
            "Predicted accuracy after calibration; null for other purposes.",
        ),
        "worth": Key(
            part(
                {
                    "new_poses_rms_m": Key(number | None, "Twice as many poses, m.", "new_poses"),
                    "repeated_poses_rms_m": Key(number | None, "Every pose visited twice, m.", "repeated_poses"),
                    "readings_rms_m": Key(number | None, "Every pose read twice at one visit, m.", "readings"),
                    "verdict": Key(text, "Comparison in words."),
                }
            )
            | None,
            "Predicted error for the same number of measurements, spent in different ways; null for other purposes.",
        ),
        "detection_limits": Key(
            array(
                part(
                    {
                        "effect": Key(text, "Name of the effect."),
                        "joints": Key(array(text), "Joints."),
                        "settings": Key(table(), "Settings of the form."),
                        "limit": Key(
                            number | None, "Size found with probability 1/2; null if no plausible size is found."
                        ),
                        "unit": Key(text, "Unit of limit and usual_size."),
                        "usual_size": Key(size, "Geometric mean of the catalogue's usual sizes.", "usual"),
                        "power": Key(share, "Probability that an effect of the usual size is found."),
                        "rms_m": Key(
                            number | None,
                            "Displacement of the target by an effect of the limit's size, m rms over the visits.",
                        ),
                    }
                )
            )
            | None,
            "Detection limit of every form of an effect; null for acceptance.",
            "detectability.limits",
        ),
        "inseparable": Key(
            array(
                part(
                    {
                        "first": Key(text, "An effect of its usual size."),
                        "second": Key(text, "The effect that explains it."),
                        "similarity": Key(share, "Largest cosine between their columns."),
                        "evidence": Key(size, "Expected difference in evidence (log Bayes factor)."),
                    }
                )
            )
            | None,
            "Pairs of detectable effects of which the second explains the first within the noise; null for acceptance.",
            "detectability.pairs",
        ),
        "not_testable": Key(
            table() | None,
            "Reason why an effect cannot be tested on these poses, by effect; null for acceptance.",
            "detectability.missing",
        ),
        "power": Key(
            part(
                {
                    "found": Key(share, "Probability that a coefficient is found.", "power.detected"),
                    "separated": Key(
                        share,
                        "Probability that it is found and distinguished from the most similar effect.",
                        "power.separated",
                    ),
                    "random_found": Key(
                        share, "found, for random candidates in the same number.", "random_power.detected"
                    ),
                    "random_separated": Key(
                        share, "separated, for random candidates in the same number.", "random_power.separated"
                    ),
                }
            )
            | None,
            (
                "Mean probabilities over the coefficients of the catalogue at their usual sizes, before repeats and "
                "checks; null unless the purpose is trace."
            ),
            lambda plan: None if plan.power is None or plan.random_power is None else plan,
        ),
        "needed_poses": Key(
            array(
                part(
                    {
                        "name": Key(text, "Name of the criterion or grade.", "demand.label"),
                        "statistic": Key(
                            choice("rms", "mean_error", "p95", "max"),
                            "Statistic of the position error.",
                            "demand.statistic",
                        ),
                        "limit_m": Key(size, "Limit, m.", "demand.limit"),
                        "confidence": Key(share, "Confidence of the bound.", "demand.confidence"),
                        "true_over_limit": Key(size, "True value over the limit that the number is for.", "ratio"),
                        "n_poses": Key(
                            integer | None, "Poses that decide with probability 0.9; null if too many.", "poses"
                        ),
                        "by_ratio": Key(
                            array(
                                part(
                                    {
                                        "true_over_limit": Key(size, "True value over the limit."),
                                        "n_poses": Key(integer | None, "Poses that decide; null if too many."),
                                    }
                                )
                            ),
                            "The same for other true values.",
                            lambda entry: [
                                {"true_over_limit": ratio, "n_poses": number} for ratio, number in entry.by_ratio
                            ],
                        ),
                    }
                )
            ),
            "Numbers of poses that decide the limits of an acceptance test.",
            "needed",
        ),
        "sufficiency": Key(
            part(
                {
                    "n_already": Key(count, "Number of poses measured already, or of the model's fit.", "n"),
                    "enough": Key(flag, "Whether they are enough."),
                    "why": Key(text, "Reason."),
                    "now_m": Key(number | None, "Predicted error now, with repeatability, m rms."),
                    "later_m": Key(number | None, "The same with the next poses, m rms."),
                    "of_model": Key(
                        flag,
                        "Whether the poses are those that the model was fitted to, in place of poses measured already.",
                    ),
                }
            )
            | None,
            "Answer to whether the poses measured already are enough; null without such poses.",
        ),
        "file_sha256": Key(text, "SHA-256 of the CSV of the visits."),
    },
    about="Plan of a measurement: visits in order, and the expected result.",
)


def payload(plan: CampaignPlan, csv: str) -> Document:
    """Return the keys of a plan; ``csv`` is the file of the visits."""
    return PLAN.write(plan, file_sha256=sha256(csv.encode()).hexdigest())
