"""Predicted accuracy of an arm from the tolerances of its parameters, its map, and tolerances that reach a grade.

The prediction is for robots whose parameter errors are random within the tolerances. At each pose the error is Gaussian
with mean zero and covariance V_d or V_δ; over poses it is their mixture in equal parts.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import yaml

from robacc.accuracy.error_statistics import Statistic
from robacc.accuracy.grade import Quantity, Scale
from robacc.errors import Problem, applying, given, refuse
from robacc.geometry import Array, NDArray, compose, transpose
from robacc.io.yaml_nodes import Source, describe, nearest, top_section
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import BASE, TOOL, TURN_OF_ANGLE, Arm, Chain, Scalar
from robacc.robots.description import DH_PARAMETERS, FRAME_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Robot
from robacc.robots.yaml_robot import Kind, read_fields, read_units, tolerances
from robacc.simulation.simulate import even_joints
from robacc.statistics.lengths import length_quantiles, mean_lengths, mixture_quantile, principal_variances

# Parameters with errors and their standard deviations, from the robot file and from a tolerance file.

_COMPONENTS = {
    **{"theta": "theta", "d": "d", "a": "a", "alpha": "alpha", "beta": "alpha", "offset": "offset"},
    **dict.fromkeys(("x", "y", "z"), "origin_length"),
    **dict.fromkeys(("roll", "pitch", "yaw"), "origin_angle"),
}
"""Variance component of each parameter of a joint; beta tilts an axis as alpha does."""


NORMAL = "normal: a tolerance t is one standard deviation, variance t²"


@dataclass(frozen=True, slots=True)
class ToleranceParameter:
    """One parameter of the arm that has an error."""

    name: str
    """``j1.theta``, ``base.x`` …; unique."""
    joint: str | None
    """Name of the joint; None for the base and the tool."""
    kind: str
    """``theta``, ``d`` …; a coordinate of a URDF joint's origin; a coordinate of base or tool."""
    component: str
    """Variance component of the parameter."""
    motion: int
    """Index of the chain's motion."""
    unit: str
    sd: float
    """Standard deviation, m or rad; above zero."""


def uncertain_parameters(robot: Robot) -> tuple[ToleranceParameter, ...]:
    """Return every parameter with a standard deviation above zero: base, joints in order, tool.

    Raises:
        InputError: No parameter has a tolerance.
    """
    arm, kinds = Arm.of(robot), (*DH_PARAMETERS, *ORIGIN_PARAMETERS)
    owners: list[tuple[int, str | None, Sequence[str], Mapping[str, float]]] = [
        (BASE, None, FRAME_PARAMETERS, robot.base_tolerance),
        *((owner, joint.name, kinds, joint.tolerance) for owner, joint in enumerate(robot.joints)),
        (TOOL, None, FRAME_PARAMETERS, robot.tool_tolerance),
    ]
    parameters = []
    for owner, name, own_kinds, sds in owners:
        frame = "base" if owner == BASE else "tool"
        for kind in (kind for kind in own_kinds if sds.get(kind, 0.0) > 0.0):
            # An angle of a frame turns it about its own axis, at any pitch.
            motion = arm.chain.index(owner, TURN_OF_ANGLE.get(kind, kind))
            parameters.append(
                ToleranceParameter(
                    f"{name or frame}.{kind}",
                    name,
                    kind,
                    frame if name is None else _COMPONENTS[kind],
                    motion,
                    arm.chain.motions[motion].unit,
                    sds[kind],
                )
            )
    example = (
        "{x: 0.1, y: 0.1, z: 0.1, offset: 0.01})"
        if robot.convention == "urdf"
        else "{theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}), or add a tolerance to the joints of the robot file"
    )
    refuse(
        (
            not parameters,
            Problem(
                f"no parameter of {robot.name} has a tolerance, so no error can be predicted",
                fix="give a tolerance file with `tolerances` (for example units: {length: mm, angle: deg} and all: "
                + example,
            ),
        )
    )
    return tuple(parameters)


# Tolerance file of ``robacc predict --tolerances``: YAML, every problem with its line and key.
#
# units: {length: mm, angle: deg}
# distribution: limits            # normal (default) | uniform | limits
# coverage: 3                     # limits only: number of standard deviations of a limit
# all: {theta: 0.01, d: 0.2, a: 0.2, alpha: 0.01}   # every moving joint
# joints:
#   j2: {a: 0.5}                  # replaces all
# base: {x: 0.5, yaw: 0.05}
# tool: {z: 0.1}


def parse_tolerances(text: str, file: str, robot: Robot) -> tuple[Robot, str]:
    """Return ``robot`` with the tolerances of a file, which replace its own one by one, as standard deviations.

    Beside it is the conversion of a tolerance into a variance, as text.

    Raises:
        InputError: The file has problems; all of them are listed with line and dotted key.
    """
    top = top_section(text, file, ("units", "distribution", "coverage", "all", "joints", "base", "tool"))
    source, units = top.source, read_units(top)
    distribution = top.text("distribution", ("normal", "uniform", "limits")) or "normal"
    coverage = top.number("coverage", lambda sds: 0 < sds <= 10, "standard deviations, above 0 and at most 10", 3.0)
    if top.get("coverage") is not None and distribution != "limits":
        top.report("coverage", "applies only to limits", "write distribution: limits")
    if units is None:
        source.raise_if_any()  # Nothing else can be checked without units.
    divisor, meaning = {
        "normal": (1.0, NORMAL),
        "uniform": (math.sqrt(3.0), "uniform: a tolerance t is the half width, variance t²/3"),
        "limits": (
            coverage,
            f"limits: a tolerance t is {coverage:g} standard deviations, variance (t/{coverage:g})²",
        ),
    }[distribution]
    is_urdf, types = robot.convention == "urdf", {joint.type for joint in robot.joints if joint.type != "fixed"}

    def kind(joint_type: str) -> Kind:
        names = FRAME_PARAMETERS if joint_type == "fixed" else ORIGIN_PARAMETERS if is_urdf else DH_PARAMETERS
        lengths = LENGTH_PARAMETERS | ({"offset"} if joint_type == "prismatic" else set())
        return tolerances(names, lengths, "a tolerance cannot be negative, found {found}")

    def by_joint(source: Source, node: yaml.Node, path: str) -> dict[str, dict[str, float]]:
        if not isinstance(node, yaml.MappingNode):
            source.report(node, path, f"expected names of joints with tolerances, found {describe(node)}")
            return {}
        kinds, values = {joint.name: kind(joint.type) for joint in robot.joints}, {}
        for name, key_node, value in source.entries(node, path):
            if name in kinds:
                values[name] = kinds[name](source, value, f"{path}.{name}") or {}
            else:
                fix = nearest(name, tuple(kinds)) or f"the joints are {', '.join(kinds)}"
                source.report(key_node, f"{path}.{name}", "the robot has no such joint", fix)
        return values

    of_any, of_frame = kind("prismatic" if types == {"prismatic"} else "revolute"), kind("fixed")
    given = read_fields(top, {"all": of_any, "joints": by_joint, "base": of_frame, "tool": of_frame})
    if "offset" in given.get("all", ()) and len(types) > 1:
        source.report(
            top.get("all"),
            "all.offset",
            "offset is an angle of revolute joints and a length of prismatic joints",
            "give it under joints, for each joint by name",
        )
    if not any(given.values()) and not source.problems:
        source.report(None, "", "no tolerance is given", "add all, joints, base or tool")
    source.raise_if_any()

    def replaced(own: Mapping[str, float], *files: Mapping[str, float]) -> dict[str, float]:
        return {**own, **{name: value / divisor for file in files for name, value in file.items()}}

    return replace(
        robot,
        joints=tuple(
            replace(
                joint,
                tolerance=replaced(
                    joint.tolerance,
                    given.get("all", {}) if joint.type != "fixed" else {},
                    given.get("joints", {}).get(joint.name, {}),
                ),
            )
            for joint in robot.joints
        ),
        base_tolerance=replaced(robot.base_tolerance, given.get("base", {})),
        tool_tolerance=replaced(robot.tool_tolerance, given.get("tool", {})),
    ), meaning


# Configurations for the prediction: the poses of a file, or samples spread evenly over the joints' ranges.


@dataclass(frozen=True, slots=True)
class Configurations:
    """Configurations of one arm, N of them."""

    q: Array
    """``(J, N)`` joint variables, rad or m."""
    scalars: tuple[Scalar, ...]
    """Nominal scalars of the chain at each configuration, with the target measured there."""
    labels: tuple[str, ...]
    """``(N,)`` label of each: its line in the file, or its number."""
    source: str
    """Description of their source as text."""
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of configurations."""
        return int(self.q.shape[1])


def configurations_of(robot: Robot, data: Measurements) -> Configurations:
    """Return the commanded configurations of measured or planned poses, each with its target.

    Raises:
        InputError: There are no poses or no joint variables.
        UsageError: The joint variables do not fit the robot.
    """
    refuse((data.n == 0, Problem("has no poses to predict the accuracy at", data.source)))
    no_joints = "has no joint columns: the prediction needs the joint values"
    return Configurations(
        given(data.q, Problem(no_joints, data.source, fix="add q1, q2, …")),
        # Effects change a covariance in second order only.
        Model.of(replace(robot, effects=())).bind(data).nominal,
        tuple(data.place(i) for i in range(data.n)),
        f"the {data.n} pose{'s' * (data.n != 1)} of {data.source or 'the data'}",
    )


def sampled_configurations(robot: Robot, n: int, seed: int = 0, target: str | None = None) -> Configurations:
    """Return ``n`` configurations spread evenly over the joints' ranges; a revolute joint without limits turns fully.

    Args:
        robot: The arm.
        n: Number of configurations.
        seed: Seed of the shift.
        target: Name of the target if the robot has several; None: the first.

    Raises:
        UsageError: ``n`` is less than one, or the robot has no such target.
        InputError: A prismatic joint has no limits.
    """
    refuse((n < 1, f"`samples` is at least 1, not {n}"))
    fix = "give it limits, or give the configurations with `poses`"
    q = even_joints(robot, n, np.random.default_rng(seed), "to spread configurations over", fix)
    endless = [joint.name for joint in robot.variables if joint.limits is None]
    name = next(iter(robot.targets), None) if target is None else target
    known = f"has {', '.join(robot.targets)}" if robot.targets else "has no targets"
    refuse((name not in (None, *robot.targets), f"no target {name!r}; the robot file {known}"))
    notes = applying(
        (endless, f"joint{'s' * (len(endless) > 1)} {', '.join(endless)} without limits: sampled over a full turn"),
        (
            target is None and len(robot.targets) > 1,
            f"predicted for the target {name}, the first of {len(robot.targets)}; `target` selects another",
        ),
    )
    if name is not None:
        robot = replace(robot, tool=robot.targets[name], targets={})
    return Configurations(
        q,
        tuple(Arm.of(robot).chain.scalars(q)),
        tuple(f"sample {i}" for i in range(1, n + 1)),
        f"{n} configuration{'s' * (n != 1)} spread evenly over the joint ranges (seed {seed})",
        notes,
    )


# Covariances V_d and V_delta of each pose, equations (7) and (8), and each parameter's share.
#
# With J the columns of equation (6) and s_p the parameters' standard deviations, V = Σ_p s_p² J_p J_pᵀ, and the trace
# of V divides among the parameters as Σ_n s_p² |J_pn|². The trace does not depend on the frame, so the sums are
# computed in the measuring frame of the sweep, and only the 3 x 3 results are rotated into the tool's frame.
#
# The Jacobian of a block is the largest working array; only the 3 x 3 results and the shares outlive the block.


def pose_covariances(
    chain: Chain, scalars: Sequence[Scalar], n: int, parameters: Sequence[ToleranceParameter]
) -> tuple[Array, Array, Array]:
    """Return equations (7) and (8) for ``n`` poses with the chain's ``scalars`` (floats, or ``(n,)`` if they vary).

    They are the covariances ``(3, 3, N)`` V_d (m²) and V_δ (rad²) in the tool's frame, and the contribution ``(2, P)``
    of each parameter to the sum of all their traces.
    """
    sd = np.array([parameter.sd for parameter in parameters])[:, None]
    covariances, power = np.empty((2, 3, 3, n)), np.zeros((2, len(parameters)))
    for block in chain.blocks(n):
        local = [scalar if isinstance(scalar, float) else scalar[block] for scalar in scalars]
        sweep = chain.sweep(local, block.stop - block.start, [parameter.motion for parameter in parameters])
        for part, columns in enumerate(np.split(sweep.jacobian * sd, 2)):
            covariances[part, :, :, block] = in_tool_frame(outer_sums(columns), sweep.poses.rotation)
            power[part] += np.einsum("ipn,ipn->p", columns, columns)
    return covariances[0], covariances[1], power


def outer_sums(columns: Array) -> Array:
    """Return Σ_k c_k c_kᵀ ``(R, R, n)`` of columns ``(R, K, n)``."""
    return np.asarray(np.einsum("ikn,jkn->ijn", columns, columns))


def in_tool_frame(covariance: Array, rotation: Array) -> Array:
    """Return covariances ``(3, 3, n)`` of the measuring frame in the tool's, whose axes are ``rotation``."""
    return compose(transpose(rotation), compose(covariance, rotation))


RADIUS_PROBABILITY = 0.95
"""Probability of the error radius at each pose."""
PERCENTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True, slots=True)
class PredictedErrors:
    """Predicted position or orientation errors, m or rad."""

    unit: Literal["m", "rad"]
    covariance: Array
    """``(3, 3, N)`` in the tool's frame: equation (7) or (8)."""
    pose_rms: Array
    """``(N,)`` root of the trace."""
    pose_radius95: Array
    """``(N,)`` radius of 95 % of the errors at each pose, exact for Gaussian errors."""
    rms: float
    """Over robots and poses, as are ``mean_error`` and ``p95``."""
    mean_error: float
    p95: float
    max: float
    """Largest of ``pose_radius95``: Gaussian errors have no maximum."""
    worst: Mapping[str, Any]
    """Pose with the largest RMS error, with the keys of the result: its number and label, joints ``q`` (rad or m), RMS,
    radius of 95 % of its errors, unit vector in the tool's frame along which the error is largest, whose largest
    component is positive, and the standard deviation along it."""
    pose_statistic: Array
    """``(N,)`` the grade scale's statistic at each pose; for p95 and max the 95 % radius."""

    def percentiles(self, values: Array) -> Mapping[str, float]:
        """Return percentiles over poses of predicted errors ``(N,)``, with the keys of the result."""
        sizes = np.percentile(values, PERCENTILES).tolist()
        return {f"p{percent}": size for percent, size in zip(PERCENTILES, sizes, strict=True)}


@dataclass(frozen=True, slots=True)
class Prediction:
    """Result of :func:`predict_accuracy`."""

    parameters: tuple[ToleranceParameter, ...]
    """None of one calibrated arm, whose prediction is from the fit of its model."""
    configurations: Configurations
    position: PredictedErrors
    orientation: PredictedErrors
    budget: Sequence[Mapping[str, Any]]
    """Shares in the predicted variance by parameter, the largest share of position first, with the keys of the result;
    shares sum to 1."""
    by_joint: Sequence[Mapping[str, Any]]
    by_kind: Sequence[Mapping[str, Any]]
    scale: Scale
    grade: Mapping[str, Any]
    """Grade on the scale, of both quantities and of each, and the share of poses that meet each step, with the keys of
    the result."""
    meaning: str
    """Conversion of a tolerance into a variance, as text."""
    notes: tuple[str, ...]


def predict_accuracy(
    robot: Robot,
    parameters: Sequence[ToleranceParameter],
    configurations: Configurations,
    scale: Scale,
    meaning: str = NORMAL,
) -> Prediction:
    """Predict the covariances, error budget and grade of robots with these tolerances.

    Args:
        robot: The arm.
        parameters: From :func:`uncertain_parameters`.
        configurations: Configurations of equal weight.
        scale: Scale of the grade.
        meaning: Conversion of a tolerance into a variance, as text.
    """
    *covariances, power = pose_covariances(Arm.of(robot).chain, configurations.scalars, configurations.n, parameters)
    by_parameter = with_shares(
        [{"parameter": p.name, "joint": p.joint, "kind": p.kind, "sd": p.sd, "unit": p.unit} for p in parameters], power
    )
    notes = applying(
        (robot.effects, "the robot file's effects are not part of a prediction from tolerances"),
        (meaning != NORMAL, "radii and percentiles assume that the sum of all errors is Gaussian; covariances do not"),
    )
    return predicted(
        configurations,
        covariances,
        scale,
        parameters=tuple(parameters),
        budget=sorted(by_parameter, key=largest_first),
        by_joint=_summed_shares(
            by_parameter, [share["joint"] or share["parameter"].split(".")[0] for share in by_parameter]
        ),
        by_kind=_summed_shares(by_parameter, [parameter.component for parameter in parameters]),
        meaning=meaning,
        notes=(*configurations.notes, *notes),
    )


def with_shares(sources: Sequence[Mapping[str, Any]], power: Array) -> list[dict[str, Any]]:
    """Return the sources of error, each with its share in the variances ``power`` ``(2, P)``."""
    totals = power.sum(axis=1, keepdims=True)
    shares = (power / np.where(totals > 0.0, totals, 1.0)).T.tolist()
    return [
        {**source, "share_position": position, "share_orientation": orientation}
        for source, (position, orientation) in zip(sources, shares, strict=True)
    ]


def predicted(configurations: Configurations, covariances: Sequence[Array], scale: Scale, **facts: Any) -> Prediction:
    """Return the prediction of covariances ``(3, 3, N)`` of position and orientation in the tool's frame.

    ``facts`` are the other fields of the prediction.
    """
    sizes: dict[Quantity, PredictedErrors] = {
        "position": _predicted_errors("m", covariances[0], configurations, scale.statistic),
        "orientation": _predicted_errors("rad", covariances[1], configurations, scale.statistic),
    }
    ranks = {name: scale.rank_of(name, getattr(errors, scale.statistic)) for name, errors in sizes.items()}
    met = steps_met(scale, {name: errors.pose_statistic for name, errors in sizes.items()}).mean(axis=1)
    return Prediction(
        configurations=configurations,
        position=sizes["position"],
        orientation=sizes["orientation"],
        scale=scale,
        grade={
            "grade": scale.name_of(max(ranks.values())),
            "scale": scale.name,
            "statistic": scale.statistic,
            **{name: scale.name_of(rank) for name, rank in ranks.items()},
            "limited_by": tuple(name for name, rank in ranks.items() if rank == max(ranks.values()) > 0),
            "demonstrated": False,
            "share_of_poses_meeting": dict(zip((step.grade for step in scale.steps), met.tolist(), strict=False)),
        },
        **facts,
    )


def _predicted_errors(
    unit: Literal["m", "rad"], covariance: Array, configurations: Configurations, statistic: Statistic
) -> PredictedErrors:
    """Return the predicted errors of covariances ``(3, 3, N)`` in the tool's frame."""
    variances = principal_variances(covariance)
    rms = np.sqrt(np.sum(variances, axis=0))
    radius, means = length_quantiles(RADIUS_PROBABILITY, variances), mean_lengths(variances)
    # The first of equal poses: rounding makes a different one the largest on different machines.
    index = int(np.argmax(rms >= (1.0 - 1e-9) * np.max(rms)))
    values, vectors = np.linalg.eigh(covariance[:, :, index])
    return PredictedErrors(
        unit,
        covariance,
        rms,
        radius,
        rms=math.sqrt(float(np.mean(np.square(rms)))),
        mean_error=float(np.mean(means)),
        p95=mixture_quantile(RADIUS_PROBABILITY, variances),
        max=float(np.max(radius)),
        worst={
            "pose": index,
            "label": configurations.labels[index],
            "q": configurations.q[:, index].copy(),
            f"rms_{unit}": float(rms[index]),
            f"radius95_{unit}": float(radius[index]),
            "direction": vectors[:, 2] if vectors[np.argmax(np.abs(vectors[:, 2])), 2] >= 0 else -vectors[:, 2],
            f"sd_{unit}": math.sqrt(max(float(values[2]), 0.0)),
        },
        pose_statistic={"rms": rms, "mean_error": means}.get(statistic, radius),
    )


def _summed_shares(shares: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> list[dict[str, Any]]:
    """Return the sum of the shares of each key, the largest first."""
    sums: dict[str, dict[str, Any]] = {}
    for share, key in zip(shares, keys, strict=True):
        total = sums.setdefault(key, {"name": key, "share_position": 0.0, "share_orientation": 0.0})
        total |= {name: total[name] + share[name] for name in ("share_position", "share_orientation")}
    return sorted(sums.values(), key=largest_first)


def largest_first(share: Mapping[str, Any]) -> tuple[float, float]:
    """Return a sort key, rounded so that equal shares stay in the chain's order on every machine."""
    return -round(share["share_position"], 9), -round(share["share_orientation"], 9)


def steps_met(scale: Scale, sizes: Mapping[Quantity, Array]) -> NDArray[np.bool_]:
    """Return ``(S + 1, N)`` which steps errors ``(N,)`` meet, position in m and orientation in rad; the last always."""
    limits = [[np.inf if (limit := step.limit(name)) is None else limit for name in sizes] for step in scale.steps]
    met = np.array(list(sizes.values())) <= np.array(limits)[:, :, None]
    return np.concatenate((met.all(axis=1), np.ones((1, met.shape[2]), dtype=bool)))


def step_limits(scale: Scale, grade: str) -> tuple[float, float | None]:
    """Return the limits of a grade: m, and rad or None.

    Raises:
        UsageError: The scale has no step of that name.
    """
    limits = {step.grade: (step.position, step.orientation) for step in scale.steps}
    refuse((grade not in limits, f"no grade {grade!r} on the scale {scale.name}; it has {', '.join(limits)}"))
    return limits[grade]


# Tolerances that reach a grade at least cost, by tightening the given tolerances.
#
# A tighter tolerance costs more; in the reciprocal model the cost is c t0/t, and c = 1 for every given tolerance t0
# (K. W. Chase, W. H. Greenwood, B. G. Loosli, L. F. Hauglund, "Least cost tolerance allocation for mechanical
# assemblies with automated process selection", Manufacturing Review 3(1), 1990). With factors f_p = t/t0 and shares
# A_p, B_p of the predicted variance of position and orientation,
#
#     minimise Σ 1/f_p   subject to   Σ A_p f_p² <= T_A,  Σ B_p f_p² <= T_B,  f_p <= 1,
#
# the solution is f_p = min(1, (λ A_p + μ B_p)^(-1/3)) with both multipliers at zero or at their limits. Parameters
# with a large share are tightened most; no tolerance is widened.

_SOLVED = 1e-12


def allocate(robot: Robot, prediction: Prediction, grade: str) -> Mapping[str, Any]:
    """Tighten the tolerances of ``prediction`` until it reaches ``grade`` of its scale.

    Return, with the keys of the result, whether it does, the common factor of all tolerances that would do so too, each
    tolerance as given and as needed, and the prediction with the needed tolerances at the same poses.

    Raises:
        UsageError: The scale has no such grade.
    """
    scale = prediction.scale
    limits = step_limits(scale, grade)
    budget = {part["parameter"]: (part["share_position"], part["share_orientation"]) for part in prediction.budget}
    shares = np.array([budget[parameter.name] for parameter in prediction.parameters]).T
    excess = _relative_excess(prediction, limits)
    uniform_factor = min(1.0, 1.0 / float(np.max(excess)))
    # The statistic is not exactly proportional to the RMS, whose square the budget divides: correct the targets.
    target_variances, verified = 1.0 / np.maximum(np.square(excess), np.finfo(float).tiny), prediction
    for _ in range(12):
        if np.max(excess) <= 1.0:
            break
        multipliers = np.ones(2)
        for _ in range(2000):
            # A price of at most one leaves the tolerance unchanged.
            factors: Array = np.maximum(multipliers @ shares, 1.0) ** (-1.0 / 3.0)
            change = (shares @ np.square(factors) / target_variances) ** 1.5
            multipliers = multipliers * change
            if np.all((np.abs(change - 1.0) < _SOLVED) | (multipliers < _SOLVED)):
                break
        tightened = [
            replace(parameter, sd=parameter.sd * factor)
            for parameter, factor in zip(prediction.parameters, factors.tolist(), strict=True)
        ]
        verified = predict_accuracy(robot, tightened, prediction.configurations, scale, prediction.meaning)
        excess = _relative_excess(verified, limits)
        # Relative distance below the square of a limit that the allocation aims at.
        target_variances = (
            target_variances / np.square(np.maximum(excess, 1.0)) * np.where(excess > 1.0, 1.0 - 5e-4, 1.0)
        )
    return {
        "grade": grade,
        "met": bool(np.max(excess) <= 1.0),
        "uniform_factor": uniform_factor,
        "tolerances": [
            {
                "parameter": given.name,
                "joint": given.joint,
                "given_sd": given.sd,
                "needed_sd": needed.sd,
                "factor": needed.sd / given.sd,
                "unit": given.unit,
            }
            for given, needed in zip(prediction.parameters, verified.parameters, strict=True)
        ],
        "verified": verified,
    }


def _relative_excess(prediction: Prediction, limits: tuple[float, float | None]) -> Array:
    """Return the statistics of position and orientation over their limits; zero if there is no limit."""
    sizes = (getattr(part, prediction.scale.statistic) for part in (prediction.position, prediction.orientation))
    return np.array([size / (limit or np.inf) for size, limit in zip(sizes, limits, strict=True)])


# Map of the workspace: where an arm holds its grade, by voxels of the predicted positions.


def warranty_map(prediction: Prediction, position: Array, edge: float | None = None) -> tuple[Mapping[str, Any], Array]:
    """Return the map of the V voxels that have a configuration, with the keys of the result, and their RMS errors.

    The map has the grade that every configuration of a voxel meets. The errors ``(2, V)`` are those of position (m) and
    of orientation (rad).

    Args:
        prediction: Predicted errors of N configurations.
        position: ``(3, N)`` position of the target, measuring frame, m.
        edge: Edge of a voxel, m; None for a round length that gives ten to 25 voxels along its longest side.
    """
    if edge is None:
        # 1, 2 or 5 times a power of ten, near a tenth of the longest side of the workspace.
        wanted = max(float(np.max(np.ptp(position, axis=1), initial=0.0)) / 10, 1e-3)
        power = 10.0 ** math.floor(math.log10(wanted))
        edge = float(power * max(step for step in (1, 2, 5) if step * power <= wanted))
    voxels, number = np.unique(np.floor(position / edge).astype(np.int64), axis=1, return_inverse=True)
    number = number.ravel()
    count, parts = np.bincount(number), (prediction.position, prediction.orientation)
    rms = np.sqrt([np.bincount(number, np.square(errors.pose_rms)) / count for errors in parts])
    bound = np.zeros(rms.shape)
    for largest, errors in zip(bound, parts, strict=True):
        np.maximum.at(largest, number, errors.pose_radius95)
    ranks = np.argmax(steps_met(prediction.scale, {"position": bound[0], "orientation": bound[1]}), axis=0)
    return {
        "voxel_m": edge,
        "centre_m": np.round((voxels + 0.5) * edge, 12).T,
        "configurations": count,
        "bound95_m": bound[0],
        "bound95_rad": bound[1],
        "grade": [*map(prediction.scale.name_of, ranks.tolist())],
    }, rms
