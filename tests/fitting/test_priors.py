"""Priors, shrinkage, weak parameters and their covariance."""

import dataclasses
import json
from functools import cache
from itertools import product

import numpy as np
import pytest
from arms import arm, model_of
from scipy.optimize import minimize

from robacc.documents.keys import COVARIANCE
from robacc.effects import REGISTRY
from robacc.effects.base import Term
from robacc.effects.periodic import TransmissionError
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.levels import LARGEST
from robacc.fitting.normal_equations import GAIN, NormalEquations, posterior
from robacc.fitting.parameters import apply_fit, parameter_covariance
from robacc.fitting.priors import shrink_to_nominal, weak_kinds
from robacc.fitting.solver import Priors, fit, refit
from robacc.fitting.warnings import fit_warnings, lack_of_fit
from robacc.geometry import Array, exp_so3
from robacc.io.json_text import json_text
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate

ORDERS = np.arange(1, 37) / 2
TYPICAL = 1e-4


def waves(angle: Array) -> Array:
    """Return ``(N, 72)`` cosines and sines of the orders."""
    return np.concatenate([np.cos(angle[:, None] * ORDERS), np.sin(angle[:, None] * ORDERS)], axis=1)


def test_a_profile_with_a_gap_stays_of_its_usual_size_there() -> None:
    """An error of 30 mrad that the orders cannot hold, seen from 0 to 0.4 rad and from 2.0 to 2.4 rad."""
    rng = np.random.default_rng(3)
    angle = np.concatenate([rng.uniform(0.0, 0.4, 3000), rng.uniform(2.0, 2.4, 3000)])
    noise_std = 1e-5
    design = waves(angle) / noise_std
    measured = (30e-3 * np.sign(angle - 1.0) * angle + rng.normal(scale=noise_std, size=angle.size)) / noise_std
    gram, rhs = design.T @ design, design.T @ measured
    normal = NormalEquations(np.zeros(72), gram[None], rhs[None], np.array([measured @ measured]))
    terms = [Term(f"t{i}", "rad", TYPICAL, (), "profile") for i in range(72)]
    priors = Priors(terms, np.full(72, np.inf), np.full(72, np.inf), {})
    columns = np.arange(72)
    priors.update(normal, columns, float(angle.size), noise_known=True)
    # Steps end before the bound where the next would gain next to nothing.
    assert 0.95 * LARGEST * TYPICAL < priors.group_stds["profile"] <= LARGEST * TYPICAL
    theta = posterior(gram, priors.precision[columns]) @ rhs
    # Without the bound the coefficients are 5e10 rad, and 2e7 rad is predicted in the gap.
    assert np.abs(waves(np.linspace(0.5, 1.9, 200)) @ theta).max() < 0.1


def linear_problem(seed: int, noise_std: float) -> tuple[Array, Array, NormalEquations]:
    """Return design, data and normal equations of two groups of ten and five coefficients and four free ones."""
    rng = np.random.default_rng(seed)
    truth = np.concatenate((rng.normal(scale=3e-4, size=10), rng.normal(scale=2e-5, size=5), rng.normal(size=4)))
    design = rng.normal(size=(60, 19)) * np.repeat((1e4, 1e5, 1e2), (10, 5, 4))
    measured = design @ truth + rng.normal(scale=noise_std, size=60)
    gram, rhs = design.T @ design, design.T @ measured
    normal = NormalEquations(np.zeros(19), gram[None], rhs[None], np.array([measured @ measured]))
    return design, measured, normal


@pytest.mark.parametrize("noise_std", [None, 0.1, 1.0, 30.0])
@pytest.mark.parametrize("start", [1e-6, 1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_group_stds_have_the_largest_marginal_likelihood(seed: int, start: float, noise_std: float | None) -> None:
    """Rows have unit weights; their noise is known to be 1, or is ``noise_std`` and estimated with the groups."""
    noise_known = noise_std is None
    design, measured, normal = linear_problem(seed, noise_std or 1.0)
    terms = [Term(f"t{i}", "rad", TYPICAL, (), "a" if i < 10 else "b" if i < 15 else None) for i in range(19)]
    priors = Priors(terms, np.full(19, np.inf), np.full(19, np.inf), {"a": start, "b": start})
    _, noise = priors.update(normal, np.arange(19), 60.0, noise_known)
    free = design[:, 15:]

    def restricted_likelihood(log_stds: Array) -> float:
        std = np.exp(np.repeat(log_stds[:2], (10, 5)))
        covariance = np.exp(2.0 * log_stds[2]) * np.eye(60) + (design[:, :15] * np.square(std)) @ design[:, :15].T
        precision = np.linalg.inv(covariance)
        projected = precision - precision @ free @ np.linalg.solve(free.T @ precision @ free, free.T @ precision)
        determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(free.T @ precision @ free)[1]
        return -0.5 * float(determinants + measured @ projected @ measured)

    def missed(log_stds: Array) -> float:
        return -restricted_likelihood(np.append(log_stds[:2], 0.0 if noise_known else log_stds[-1]))

    best = minimize(missed, np.log([3e-4, 2e-5, noise_std or 1.0]), method="Nelder-Mead", options={"maxiter": 2000}).x
    reached = np.log([priors.group_stds["a"], priors.group_stds["b"], noise**0.5])
    assert restricted_likelihood(reached) > -missed(best) - 2 * GAIN


NOISE = 2e-5
PLAN = Plan(60, noise_position=NOISE, orientation=False)
CONSTANTS = ("joint_offset", "link_geometry")


@pytest.mark.parametrize("size", [2e-5, 3e-3])
def test_deviations_and_an_unknown_noise_end_where_a_refit_leaves_them(size: float) -> None:
    """A profile of the usual size and of a hundred times that, which the start takes for noise."""
    one = arm("puma560")
    orders = tuple(float(order) for order in range(1, 13))
    rng = np.random.default_rng(7)
    values = {f"j2.{wave}{order:g}": size * rng.normal() for order in orders for wave in ("cos", "sin")}
    entry = {"effect": "transmission_error", "joints": ["j2"], "orders": list(orders), "values": values}
    robot = dataclasses.replace(one.robot, effects=(entry,), effect_units=(1.0, 1.0))
    data = simulate(robot, dataclasses.replace(PLAN, poses=200)).data
    frames = [REGISTRY[name].default(one, data) for name in ("base_frame", "tool_frame")]
    model = Model.of(one.robot, [*frames, TransmissionError(("j2",), orders, shrunk=True)])
    found = fit(model, data, Options(robust=False))
    assert found.misfit[0] == pytest.approx(NOISE, rel=0.1)
    again = refit(found, model.free, data, Options(robust=False))
    assert again.misfit == pytest.approx(found.misfit, rel=2e-3)
    np.testing.assert_allclose(list(again.group_stds.values()), list(found.group_stds.values()), rtol=0.05)


def test_deviations_beside_scatter_have_the_noise_of_the_fit() -> None:
    """The misfit is that of the residual, scatter included: deviations at less noise would not be those of the fit."""
    one, orders, rng = arm("puma560"), tuple(float(order) for order in range(1, 13)), np.random.default_rng(7)
    values = {f"j2.{wave}{order:g}": 3e-5 * rng.normal() for order in orders for wave in ("cos", "sin")}
    entry = {"effect": "transmission_error", "joints": ["j2"], "orders": list(orders), "values": values}
    robot = dataclasses.replace(one.robot, effects=(entry,), effect_units=(1.0, 1.0))
    data = simulate(robot, dataclasses.replace(PLAN, poses=200, noise_position=6e-5)).data
    frames = [REGISTRY[name].default(one, data) for name in ("base_frame", "tool_frame")]
    model = Model.of(one.robot, [*frames, TransmissionError(("j2",), orders, shrunk=True)])
    options = Options(robust=False, scatter=np.full(6, 1e-4))
    found = fit(model, data, options)
    known = refit(found, model.free, data, dataclasses.replace(options, misfit=found.misfit))
    np.testing.assert_allclose(list(known.group_stds.values()), list(found.group_stds.values()), rtol=0.02)


ONE = ({"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 5e-4}},)


def measured(effects: tuple[dict[str, object], ...], seed: int, name: str = "puma560") -> Measurements:
    robot = dataclasses.replace(arm(name).robot, effects=effects, effect_units=(1.0, 1.0))
    return simulate(robot, dataclasses.replace(PLAN, seed=seed)).data


def plain(data: Measurements, *names: str, robot: str = "puma560") -> Fit:
    one = arm(robot)
    free = [REGISTRY[name].default(one, data) for name in ("base_frame", "tool_frame", *names)]
    return fit(Model.of(one.robot, free), data, Options(misfit=(NOISE, NOISE)))


@cache
def everywhere() -> tuple[dict[str, object], ...]:
    """Every constant off by some 0.2 mm or mrad, as a robot file has it."""
    found = plain(measured((), 0), *CONSTANTS)
    rng = np.random.default_rng(3)
    entries: list[dict[str, object]] = []
    for number, effect in enumerate(found.model.free):
        if effect.name in CONSTANTS:
            own = [n for n, owner in zip(found.names, found.owners, strict=True) if owner == number]
            values = {n.partition(".")[2]: float(rng.choice([-1, 1]) * rng.uniform(1e-4, 3e-4)) for n in own}
            entries.append({"effect": effect.name, "joints": list(effect.joints), "values": values})
    return tuple(entries)


def error(found: Fit, robot: Robot) -> float:
    """Root mean square of what is predicted wrong at poses of their own, m."""
    fresh = simulate(robot, Plan(200, seed=77, orientation=False)).data
    missed = fresh.position - found.model.bind(fresh).poses(found.theta).translation
    return float(np.sqrt(np.mean(np.sum(np.square(missed), axis=0))))


def test_where_one_length_is_wrong_it_is_found_and_noise_moves_no_other() -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=ONE, effect_units=(1.0, 1.0))
    squares = np.zeros(2)
    for seed in range(1, 6):
        data = measured(ONE, seed)
        alone = plain(data, "link_geometry")
        found, kinds = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
        lengths = next(kind for kind in kinds if kind.unit == "m")
        chances = dict(zip(lengths.names, lengths.probability, strict=True))
        assert chances.pop("link_geometry.j2.a") > 0.999
        assert max(chances.values()) < 0.5
        assert lengths.std == pytest.approx(5e-4, rel=0.2)
        # What is found is as least squares has it, and standard errors are those of least squares.
        at = found.names.index("link_geometry.j2.a")
        deviation = float(np.sqrt(alone.covariance[at, at]))
        assert found.theta[at] == pytest.approx(5e-4, abs=4 * deviation)
        np.testing.assert_array_equal(found.covariance, alone.covariance)
        assert found.degrees_of_freedom > alone.degrees_of_freedom + 4
        squares += np.square((error(found, robot), error(alone, robot)))
    # 26 coefficients against 10 known in advance: sqrt(10 / 26) at best.
    assert np.sqrt(squares[0] / squares[1]) < 0.75


def test_where_most_are_wrong_least_squares_stays() -> None:
    data = measured(everywhere(), 1)
    alone = plain(data, *CONSTANTS)
    found, kinds = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
    assert kinds == ()
    assert found is alone


def test_kinds_are_judged_apart() -> None:
    # Every offset wrong, no length: only lengths are drawn.
    entry = {"effect": "joint_offset", "joints": ["j2", "j3", "j4", "j5", "j6"]}
    values = {"j2": 1e-3, "j3": -8e-4, "j4": 9e-4, "j5": -1e-3, "j6": 7e-4}
    twists = {"effect": "link_geometry", "joints": ["j1", "j2", "j3", "j4", "j5"]}
    off = {f"j{i}.alpha": 1e-3 * (-1) ** i for i in range(1, 6)}
    data = measured(({**entry, "values": values}, {**twists, "values": off}), 2)
    alone = plain(data, *CONSTANTS)
    found, kinds = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
    assert [kind.unit for kind in kinds] == ["m"]
    lengths = [i for i in found.identifiability.columns if found.names[i] in kinds[0].names]
    assert np.linalg.norm(found.theta[lengths]) < 0.5 * np.linalg.norm(alone.theta[lengths])


def test_probabilities_are_those_of_all_subsets_counted() -> None:
    # Bayes' rule over the 2^n models of which offsets differ, with the widths and shares that were found.
    entry = {"effect": "joint_offset", "joints": ["panda_joint4"], "values": {"panda_joint4": 4e-4}}
    data = measured((entry,), 4, "panda")
    alone = plain(data, "joint_offset", robot="panda")
    _, (kind,) = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
    kept = [alone.names[i] for i in alone.identifiability.columns]
    own, others = [kept.index(name) for name in kind.names], [i for i, n in enumerate(kept) if n not in kind.names]
    share = (sum(kind.probability) + 0.5) / (len(own) + 1.0)
    evidence, models = [], list(product((False, True), repeat=len(own)))
    for chosen in models:
        inside = [own[i] for i in np.flatnonzero(chosen)]
        columns = others + inside
        prior = np.array([0.0] * len(others) + [kind.std**-2] * len(inside))
        matrix = alone.gram[np.ix_(columns, columns)] + np.diag(prior)
        moment = alone.rhs[columns]
        log = 0.5 * moment @ np.linalg.solve(matrix, moment) - 0.5 * np.linalg.slogdet(matrix)[1]
        log += 0.5 * np.log(prior[len(others) :]).sum() + len(inside) * np.log(share / (1.0 - share))
        evidence.append(log)
    weight = np.exp(np.array(evidence) - max(evidence))
    exact = (weight @ np.array(models, dtype=float)) / weight.sum()
    # The mean field takes each offset's neighbours at their mean.
    np.testing.assert_allclose(kind.probability, exact, atol=0.01)
    assert sorted(exact)[-1] > 0.99


GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"
NOISE_OF_WEAK_PARAMETERS = 2e-4


def made(name: str, seed: int, std: float = 5e-4) -> Robot:
    """Return the arm as built: every constant differs by some half millimetre or milliradian, or by ``std``."""
    rng = np.random.default_rng(seed)
    robot = arm(name).robot
    joints = tuple(
        dataclasses.replace(
            joint, parameters={label: value + rng.normal(scale=std) for label, value in joint.parameters.items()}
        )
        for joint in robot.joints
    )
    return dataclasses.replace(robot, joints=joints, effects=())


def measured_of_weak_parameters(
    robot: Robot, q: np.ndarray, seed: int, oriented: bool, noise: float = NOISE_OF_WEAK_PARAMETERS
) -> Measurements:
    rng = np.random.default_rng(seed)
    data = Measurements(position=np.zeros((3, q.shape[1])), q=q)
    poses = predict(robot, data)
    position = poses.translation + rng.normal(scale=noise, size=poses.translation.shape)
    return dataclasses.replace(data, position=position, rotation=poses.rotation if oriented else None)


def geometry(
    name: str, data: Measurements, robot: Robot | None = None, options: Options | None = None, asked: str = GEOMETRY
) -> Fit:
    nominal = dataclasses.replace(robot or arm(name).robot, effects=())
    return fit(model_of(nominal, asked, data), data, options or Options())


def warnings(found: Fit, data: Measurements, start: str) -> list[str]:
    texts = fit_warnings(found, data, lack_of_fit(found, data), found, (1.0, 1.0))
    return [text for text in texts if text.startswith(start)]


def joints(name: str, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    limits = np.array([joint.limits for joint in arm(name).robot.variables])
    return rng.uniform(0.6 * limits[:, :1], 0.6 * limits[:, 1:], size=(len(limits), n))


@pytest.mark.parametrize(("largest_std", "expected"), [(0.8e-3, False), (1.0e-3, True), (3e-3, True)])
def test_a_standard_error_above_a_millimetre_is_weak(largest_std: float, expected: bool) -> None:
    # Standard errors are proportional to the stated noise, which is chosen for a largest one of so many m or rad.
    robot = dataclasses.replace(arm("ur10").robot, effects=())
    data = measured_of_weak_parameters(robot, joints("ur10", 60, 2), 3, oriented=False, noise=0.0)
    reference = geometry("ur10", data, options=Options(misfit=(1e-7, 1e-7), robust=False))
    assert weak_kinds(reference) == ()
    constants = [i for i in reference.identifiability.columns if "_frame." not in reference.names[i]]
    std = np.sqrt(np.diag(reference.covariance))[constants]
    noise = 1e-7 * largest_std / std.max()
    fitted = geometry("ur10", data, options=Options(misfit=(noise, noise), robust=False))
    weak = {name for kind in weak_kinds(fitted) for name in kind.names}
    assert (reference.names[constants[std.argmax()]] in weak) is expected
    assert bool(weak) is expected


def test_a_target_on_the_last_axis_lets_nothing_drift() -> None:
    """A Panda whose target is on the flange's axis: constants of joints 6 and 7 are weakly identifiable."""
    robot = dataclasses.replace(
        made("panda", 5), tool=dataclasses.replace(arm("panda").robot.tool, xyz=(0.0, 0.0, 0.1))
    )
    found = geometry("panda", measured_of_weak_parameters(robot, joints("panda", 60, 6), 7, oriented=False))
    constants = [i for i, name in enumerate(found.names) if not name.startswith(("base_frame", "tool_frame"))]
    assert np.abs(found.theta[constants]).max() < 1e-2


def altered(robot: Robot, changes: dict[tuple[int, str], float]) -> Robot:
    """Return the robot with parameters (joint's number, label) changed."""
    joints = list(robot.joints)
    for (i, label), change in changes.items():
        parameters = joints[i].parameters
        joints[i] = dataclasses.replace(joints[i], parameters={**parameters, label: parameters[label] + change})
    return dataclasses.replace(robot, joints=tuple(joints))


@pytest.mark.parametrize("oriented", [False, True])
@pytest.mark.parametrize("n", [20, 60])
@pytest.mark.parametrize(
    "changes",
    [
        {(1, "a"): 0.03},
        {(1, "a"): 0.1},
        {(2, "theta"): 0.035},
        {(1, "theta"): 0.09, (2, "theta"): -0.09, (3, "theta"): 0.09},
    ],
    ids=["30 mm", "100 mm", "2 deg", "5 deg each"],
)
def test_a_wrong_file_is_corrected(changes: dict[tuple[int, str], float], n: int, oriented: bool) -> None:
    """An arm ten to forty standard deviations of the prior from its file is found as one that is near it."""
    true = made("ur10", 8)
    fresh = Measurements(position=np.zeros((3, 300)), q=joints("ur10", 300, 10))
    wanted = predict(true, fresh).translation
    data = measured_of_weak_parameters(true, joints("ur10", n, 8), 9, oriented, noise=5e-5)
    rms = []
    for robot in (arm("ur10").robot, altered(arm("ur10").robot, changes)):
        found = geometry("ur10", data, robot)
        assert weak_kinds(found) == ()
        miss = predict(apply_fit(found), fresh).translation - wanted
        rms.append(float(np.sqrt(np.mean(np.sum(np.square(miss), axis=0)))))
    # Three zeros that are thirty standard deviations off are pulled by a tenth of their standard errors at 20 poses.
    assert rms[1] < 1.15 * rms[0]


def test_poses_of_nearly_one_orientation_leave_the_tool_unknown() -> None:
    """The orientation of the flange stays the same but for a thousandth."""
    q, small = joints("irb1600", 80, 2), 1e-3 * np.random.default_rng(0).standard_normal((4, 80))
    q[4] = 0.6 - q[1] - q[2] + small[3]
    q[[0, 3, 5]] = small[:3]
    data = measured_of_weak_parameters(
        dataclasses.replace(arm("irb1600").robot, effects=()), q, 1, oriented=False, noise=2e-5
    )
    (warning,) = warnings(geometry("irb1600", data, asked="base_frame,tool_frame"), data, "condition number")
    assert "weakly identifiable on these poses, most of all" in warning
    assert "tool_frame." in warning
    assert " mm)" in warning


NOISE_OF_PARAMETER_COVARIANCE = 5e-5
EFFECTS = "base_frame,tool_frame,joint_offset[panda_joint2]"


def fitted(base_rpy: tuple[float, float, float]) -> Fit:
    """Fit frames and a joint offset to noisy poses of an arm with such a base."""
    robot = dataclasses.replace(arm("panda").robot, base=Frame((0.3, -0.2, 0.5), base_rpy))
    rng = np.random.default_rng(4)
    n = 40
    data = Measurements(position=np.zeros((3, n)), q=rng.uniform(-1.0, 1.0, (len(robot.variables), n)))
    exact = predict(robot, data)
    turn = exp_so3(rng.normal(0.0, NOISE_OF_PARAMETER_COVARIANCE, (3, n)))
    rotation = np.einsum("ijn,jkn->ikn", turn, exact.rotation)
    data = dataclasses.replace(
        data, position=exact.translation + rng.normal(0, NOISE_OF_PARAMETER_COVARIANCE, (3, n)), rotation=rotation
    )
    return fit(model_of(robot, EFFECTS, data), data)


def written(result: Fit, theta: np.ndarray) -> dict[str, float]:
    """Return the coordinates of the frames that a fit with these coefficients writes."""
    robot = apply_fit(dataclasses.replace(result, theta=theta))
    return {
        f"{prefix}.{label}": value
        for prefix, frame in (("base_frame", robot.base), ("tool_frame", robot.tool))
        for label, value in zip(("x", "y", "z", "roll", "pitch", "yaw"), (*frame.xyz, *frame.rpy), strict=True)
    }


@pytest.mark.parametrize("base_rpy", [(0.4, -0.8, 1.9), (2.5, 0.3, -3.0)])
def test_matrix_is_that_of_the_reported_numbers(base_rpy: tuple[float, float, float]) -> None:
    result = fitted(base_rpy)
    covariance = parameter_covariance(result)
    columns = result.identifiability.columns
    assert covariance.names == tuple(result.names[i] for i in columns)
    slopes = np.zeros((len(covariance.names), columns.size))
    step = 1e-6
    for k, column in enumerate(columns):
        higher, lower = result.theta.copy(), result.theta.copy()
        higher[column] += step
        lower[column] -= step
        above, below = written(result, higher), written(result, lower)
        for i, name in enumerate(covariance.names):
            slopes[i, k] = (above[name] - below[name]) / (2 * step) if name in above else float(i == k)
    expected = slopes @ result.covariance[np.ix_(columns, columns)] @ slopes.T
    scale = np.sqrt(np.diag(expected))
    # Turns about a frame's axes, some 1e-5 rad after registration, count as rates: they do not commute exactly.
    np.testing.assert_allclose(covariance.matrix / scale / scale[:, None], expected / scale / scale[:, None], atol=1e-4)


def test_document_gives_the_covariance_by_its_triangle() -> None:
    covariance = parameter_covariance(fitted((0.4, -0.8, 1.9)))
    document = json.loads(json_text(COVARIANCE.write(covariance)))
    assert tuple(document["names"]) == covariance.names
    size = len(covariance.names)
    assert [len(row) for row in document["lower_triangle"]] == list(range(1, size + 1))
    written = np.zeros((size, size))
    written[np.tril_indices(size)] = np.concatenate(document["lower_triangle"])
    written = np.where(written == 0.0, written.T, written)
    # The document has eight significant digits, twelve of variances.
    np.testing.assert_allclose(written, covariance.matrix, rtol=6e-8)
    np.testing.assert_allclose(np.diag(written), np.diag(covariance.matrix), rtol=1e-11)
    # Sums of coefficients whose errors cancel keep their variance.
    assert np.linalg.eigvalsh(written).min() > 0
