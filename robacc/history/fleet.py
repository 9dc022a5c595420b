"""Coefficients over many arms of a model: mean and standard deviation of each, and arms unlike the others.

The coefficient of an arm is normal about the fleet's mean, and its estimate about it with the variance of its fit. The
weighted sum of squares about the mean, with the variance between arms added, has a chi-square distribution: its value
gives the estimate of that variance and the ends of its interval, exactly for normal coefficients.

Sources: R. C. Paule and J. Mandel, "Consensus values and weighting factors", Journal of Research of the National Bureau
of Standards 87, 1982; W. Viechtbauer, "Confidence intervals for the amount of heterogeneity in meta-analysis",
Statistics in Medicine 26, 2007; G. Knapp and J. Hartung, Statistics in Medicine 22, 2003 (interval of the mean);
B. Rosner, "Percentage points for a generalized ESD many-outlier procedure", Technometrics 25, 1983.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robacc.effects.frames import JointOffset, LinkGeometry
from robacc.effects.specification import absorbed
from robacc.errors import refuse
from robacc.geometry import Array
from robacc.history.changes import SETUP
from robacc.robots.description import Robot
from robacc.statistics.distributions import chi2_quantile, f_sf, root, student_quantile

_FEWEST = 4
"""Arms from which one can be unlike the others."""


Entry = Mapping[str, Any]
"""Coefficient over the arms, arm unlike the others, or covariance, by the keys of the result."""


class ArmFit(NamedTuple):
    """Coefficients of one arm."""

    arm: str
    values: Mapping[str, tuple[float, float, str]]
    """Value, standard deviation and unit by key."""
    covariance: Mapping[tuple[str, str], float]


def arm_fit(document: Mapping[str, Any], arm: str) -> ArmFit:
    """Return the coefficients in a result of ``calibrate`` or ``trace``; those of the set-up are left out."""
    values = {
        entry["name"]: (float(entry["value"]), float(entry["std"]), str(entry["unit"]))
        for entry in document["parameters"]
        if entry["std"] is not None and not entry["name"].startswith(SETUP)
    }
    stored = document.get("parameter_covariance") or {"names": [], "lower_triangle": []}
    names = stored["names"]
    covariance = {
        (names[i], names[j]): float(value)
        for i, row in enumerate(stored["lower_triangle"])
        for j, value in enumerate(row)
    }
    return ArmFit(arm, values, covariance)


def _squares(values: Array, variances: Array, between: float) -> float:
    weights = 1.0 / (variances + between)
    return float(weights @ np.square(values - weights @ values / weights.sum()))


def between_variance(values: Array, variances: Array, sum_of_squares: float) -> float:
    """Return the variance between arms at which the weighted sum of squares is ``sum_of_squares``; 0 if it is less."""
    if _squares(values, variances, 0.0) <= sum_of_squares:
        return 0.0
    high = float(np.sum(np.square(values - values.mean()))) / sum_of_squares
    return root(lambda between: _squares(values, variances, between) - sum_of_squares, 0.0, high * (1.0 + 1e-9), 1e-9)


def _coefficient(key: str, unit: str, values: Array, variances: Array) -> Entry:
    """Return mean and standard deviation between the arms with their 95 % intervals, by the keys of the result."""
    dof = len(values) - 1
    between, low, high = (
        between_variance(values, variances, size)
        for size in (float(dof), chi2_quantile(0.975, dof), chi2_quantile(0.025, dof))
    )
    weights = 1.0 / (variances + between)
    mean = float(weights @ values / weights.sum())
    excess = max(1.0, _squares(values, variances, between) / dof)
    half = student_quantile(0.975, dof) * math.sqrt(excess / float(weights.sum()))
    ends = {"mean": mean, "mean_low": mean - half, "mean_high": mean + half}
    stds = {"std": math.sqrt(between), "std_low": math.sqrt(low), "std_high": math.sqrt(high)}
    return {"key": key, "unit": unit, "n_arms": len(values), **ends, **stds}


def fleet_of(arms: Sequence[ArmFit]) -> tuple[list[Entry], list[Entry], Entry]:
    """Return the coefficients over the arms, the arms unlike the others, and the covariance of the coefficients.

    The figures are of the fleet without its strangers, each left out where it is one. The covariance is that of the
    arms' estimates less the mean of their own covariances, as far as it is positive semidefinite.

    Raises:
        UsageError: No coefficient is known of two arms.
    """
    keys = [*dict.fromkeys(key for arm in arms for key in arm.values)]
    coefficients: list[Entry] = []
    strangers: list[Entry] = []
    for key in keys:
        own = [arm for arm in arms if key in arm.values and arm.values[key][1] > 0.0]
        if len(own) < 2:
            continue
        unit = own[0].values[key][2]
        while True:
            values, variances = np.array([(arm.values[key][0], arm.values[key][1] ** 2) for arm in own]).T
            found = _coefficient(key, unit, values, variances)
            if len(own) < _FEWEST:
                break
            far = int(np.argmax(np.abs(values - found["mean"]) / np.sqrt(variances + found["std"] ** 2)))
            rest = np.arange(len(own)) != far
            others = _coefficient(key, unit, values[rest], variances[rest])
            spread = others["std"] ** 2
            square = (values[far] - others["mean"]) ** 2 / (
                variances[far] + spread + 1.0 / np.sum(1.0 / (variances[rest] + spread))
            )
            p_value = len(own) * len(keys) * f_sf(float(square), 1.0, len(own) - 2.0)
            # Probability that any arm of a fleet without a stranger is called one.
            if p_value >= 0.05:
                break
            strangers.append(
                {
                    **{"arm": own[far].arm, "key": key, "unit": unit},
                    **{"value": float(values[far]), "expected": others["mean"], "p_value": p_value},
                }
            )
            own = [arm for arm in own if arm is not own[far]]
        coefficients.append(found)
    refuse((not coefficients, "the results have no coefficient that two arms share"))
    names = [one["key"] for one in coefficients]
    apart = {stranger["arm"] for stranger in strangers}
    whole = [arm for arm in arms if arm.arm not in apart and set(names) <= set(arm.values)]
    covariance = np.diag([one["std"] ** 2 for one in coefficients])
    if len(whole) > 2:
        values = np.array([[arm.values[name][0] for name in names] for arm in whole])
        pairs = [[(a, b) if i >= j else (b, a) for j, b in enumerate(names)] for i, a in enumerate(names)]
        noise = np.mean([[[arm.covariance.get(pair, 0.0) for pair in row] for row in pairs] for arm in whole], axis=0)
        scale = np.sqrt(np.where(np.diag(covariance) > 0.0, np.diag(covariance), 1.0))
        shares, axes = np.linalg.eigh((np.cov(values.T) - noise) / scale[:, None] / scale)
        covariance = scale[:, None] * (axes * np.maximum(shares, 0.0)) @ axes.T * scale
    return coefficients, strangers, {"names": names, "matrix": covariance}


def joint_tolerances(coefficients: Sequence[Entry], urdf: bool) -> dict[str, dict[str, float]]:
    """Return standard deviations between arms by joint and parameter, as robot and tolerance files name them."""
    found: dict[str, dict[str, float]] = {}
    for one in coefficients:
        effect, joint, *label = one["key"].split(".")
        if effect == "joint_offset":
            found.setdefault(joint, {})["offset" if urdf else "theta" if one["unit"] == "rad" else "d"] = one["std"]
        elif effect == "link_geometry" and len(label) == 1:
            found.setdefault(joint, {})[label[0]] = one["std"]
    return found


def typical_robot(robot: Robot, coefficients: Sequence[Entry]) -> Robot:
    """Return a nominal robot with the means of the fleet in its numbers and its standard deviations as tolerances."""
    names = tuple(joint.name for joint in robot.variables)
    own = joint_tolerances(coefficients, robot.convention == "urdf")
    robot = absorbed(
        robot, [JointOffset(names), LinkGeometry(names)], {one["key"]: one["mean"] for one in coefficients}
    )
    joints = (dataclasses.replace(joint, tolerance=own.get(joint.name, {})) for joint in robot.joints)
    return dataclasses.replace(robot, joints=tuple(joints))
