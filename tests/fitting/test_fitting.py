"""Fits, their normal equations, whitening, held-out errors and identifiability against independent computations."""

import dataclasses
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from arms import arm, model_of
from peer import by_scipy
from scipy import stats

import robacc.fitting.normal_equations
from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term
from robacc.effects.specification import entry_of
from robacc.fitting.fit_result import Fit, HoldOut, Identifiability, Options, held_out_poses, identify_terms
from robacc.fitting.levels import DEPENDENT
from robacc.fitting.normal_equations import Whitening, whitening
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, observed_jacobian, predict, residuals
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate

NOISE = 2e-5
ARMS = ("puma560", "panda")
PLAN = Plan(60, seed=1, noise_position=NOISE, noise_orientation=NOISE)


def effects(name: str, *wanted: str) -> list[Effect]:
    """``gear_ratio:2`` is the effect on the second joint, ``joint_offset`` its default form."""
    one, data = arm(name), blank(name)
    found = []
    for text in wanted:
        effect, _, number = text.partition(":")
        found.append(REGISTRY[effect].default(one, data, (one.names[int(number) - 1],) if number else None))
    return found


@cache
def blank(name: str) -> Measurements:
    return simulate(arm(name).robot, PLAN).data


def truth_for(name: str, free: list[Effect], data: Measurements, seed: int = 0) -> tuple[Robot, np.ndarray]:
    """An arm with values of all coefficients that poses tell apart, each some 0.3 mm or mrad; the values."""
    one = arm(name)
    found = fit(Model.of(one.robot, free), data, Options(misfit=(NOISE, NOISE)))
    reach = np.abs(found.model.bind(data).linearise(np.zeros(len(found.terms)))[1]).max(axis=(0, 2))
    value = np.zeros(len(found.terms))
    kept = found.identifiability.columns
    value[kept] = np.random.default_rng(seed).normal(scale=3e-4, size=kept.size) / reach[kept]
    entries = []
    for number, effect in enumerate(free):
        own = {n: float(v) for n, v, owner in zip(found.names, value, found.owners, strict=True) if owner == number}
        entries.append(entry_of(effect, own))
    return dataclasses.replace(one.robot, effects=tuple(entries)), value


SEVERAL = ("joint_offset", "link_geometry", "gear_ratio:2", "backlash:3")


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("name", ARMS)
def test_estimates_scatter_about_the_truth_as_the_covariance_says(name: str, orientation: bool) -> None:
    free = effects(name, *SEVERAL)
    plan = dataclasses.replace(PLAN, orientation=orientation)
    robot, truth = truth_for(name, free, simulate(arm(name).robot, plan).data)
    statistic, count = 0.0, 0
    for seed in range(6):
        data = simulate(robot, dataclasses.replace(plan, seed=seed)).data
        found = fit(Model.of(arm(name).robot, free), data, Options(misfit=(NOISE, NOISE)))
        kept = found.identifiability.columns
        error = (found.theta - truth)[kept]
        statistic += float(error @ np.linalg.solve(found.covariance[np.ix_(kept, kept)], error))
        count += kept.size
        freedom = found.degrees_of_freedom
        # Priors take as much of the coefficients' freedom as they have of the information.
        of_priors = float(found.precision @ np.diag(found.covariance)[kept])
        assert freedom == pytest.approx(data.n * (6 if orientation else 3) - kept.size + of_priors, rel=1e-9)
        assert 1e-4 < stats.chi2.sf(found.chi_square, freedom) < 1 - 1e-4
    # Chi-square of the estimates: one tail in ten thousand, both ways.
    assert 1e-4 < stats.chi2.sf(statistic, count) < 1 - 1e-4


@pytest.mark.parametrize(("name", "orientation"), [("puma560", True), ("puma560", False), ("panda", True)])
def test_the_solution_is_scipys(name: str, orientation: bool) -> None:
    # From the registered start, frames metres away included; scipy on the same residuals, by its method that ends
    # nearest to the minimum: "trf" and "lm" may stop a millionth of a standard error before it.
    free = effects(name, "base_frame", "tool_frame", "joint_compliance:2", *SEVERAL)
    robot, _ = truth_for(name, effects(name, "joint_compliance:2", *SEVERAL), blank(name))
    data = simulate(robot, dataclasses.replace(PLAN, orientation=orientation)).data
    found = fit(Model.of(arm(name).robot, free), data, Options(robust=False, misfit=(NOISE, NOISE)))
    kept = found.identifiability.columns
    peer, size = by_scipy(found, data, NOISE, method="dogbox", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert kept.size > 25
    assert np.linalg.norm(found.theta[kept] - peer.x * size) <= 1e-9 * np.linalg.norm(found.theta[kept])
    # Standard errors are those of the Jacobian at the solution.
    np.testing.assert_allclose(
        found.covariance[np.ix_(kept, kept)] / size[:, None] / size, np.linalg.inv(peer.jac.T @ peer.jac), atol=1e-5
    )


@pytest.mark.parametrize("orientation", [True, False])
def test_rows_that_are_no_part_of_the_rest_are_named_and_no_others(orientation: bool) -> None:
    free = effects("puma560", "base_frame", "tool_frame", *SEVERAL)
    robot, _ = truth_for("puma560", effects("puma560", *SEVERAL), blank("puma560"))
    for seed, size in ((1, 0.5e-3), (2, 5e-3), (3, 0.3)):
        plan = dataclasses.replace(PLAN, seed=seed, outliers=4, outlier_size=size, orientation=orientation)
        made = simulate(robot, plan)
        found = fit(Model.of(arm("puma560").robot, free), made.data)
        assert found.outliers.tolist() == made.outliers.tolist()
        assert found.misfit[0] == pytest.approx(NOISE, rel=0.3)
        every = fit(Model.of(arm("puma560").robot, free), made.data, Options(robust=False))
        assert every.inliers.all()
        assert every.misfit[0] > 1.5 * NOISE


def test_rows_are_weighed_by_their_own_sigma() -> None:
    # Half the rows a hundred times worse, and saying so: the fit is nearly that of the good half.
    data = blank("puma560")
    rng = np.random.default_rng(4)
    sigma = np.where(np.arange(data.n) % 2, 2e-3, NOISE)
    position = predict(arm("puma560").robot, data).translation + sigma * rng.normal(size=(3, data.n))
    measured = dataclasses.replace(
        data, position=position, rotation=None, sigma_position=np.broadcast_to(sigma, (3, data.n)).copy()
    )
    free = effects("puma560", "joint_offset")
    found = fit(Model.of(arm("puma560").robot, free), measured)
    good = fit(Model.of(arm("puma560").robot, free), measured.subset(np.flatnonzero(sigma == NOISE)))
    kept = np.intersect1d(found.identifiability.columns, good.identifiability.columns)
    ratio = np.sqrt(np.diag(found.covariance)[kept] / np.diag(good.covariance)[kept])
    assert np.all(ratio <= 1 + 1e-9)
    assert np.all(ratio > 0.9)
    assert found.inliers.all()
    assert found.misfit[0] < NOISE
    assert 1e-3 < stats.chi2.sf(found.chi_square, found.degrees_of_freedom) < 1 - 1e-3


def test_priors_are_rows_of_their_own() -> None:
    data = blank("puma560")
    free = effects("puma560", "joint_offset", "gear_ratio:2")
    robot, _ = truth_for("puma560", free, data)
    data = simulate(robot, PLAN).data
    count = len(fit(Model.of(arm("puma560").robot, free), data).terms)
    deviation = np.full(count, np.inf)
    deviation[:3] = 5e-6, 2e-6, 1e-9
    options = Options(priors=deviation, misfit=(NOISE, NOISE), robust=False)
    found = fit(Model.of(arm("puma560").robot, free), data, options)
    # Linear algebra on the last linearisation: a prior is one more measurement, of zero.
    _, columns = found.model.bind(data).linearise(found.theta)
    jacobian = np.moveaxis(observed_jacobian(columns, found.residual) * found.weight[:, None, :], 1, 2)
    jacobian = jacobian.reshape(-1, count)
    right = (found.residual * found.weight).ravel() + jacobian @ found.theta
    rows = np.diag(1 / deviation)[:3]
    expected = np.linalg.lstsq(np.vstack((jacobian, rows)), np.concatenate((right, np.zeros(3))), rcond=None)[0]
    np.testing.assert_allclose(found.theta, expected, rtol=1e-6, atol=1e-12)
    assert abs(found.theta[2]) < 5e-9
    np.testing.assert_array_less(np.sqrt(np.diag(found.covariance))[:3], deviation[:3])


def test_order_of_rows_and_size_of_blocks_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    free = effects("puma560", "base_frame", "tool_frame", *SEVERAL)
    robot, _ = truth_for("puma560", effects("puma560", *SEVERAL), blank("puma560"))
    data = simulate(robot, PLAN).data
    model = Model.of(arm("puma560").robot, free)
    first = fit(model, data)
    order = np.random.default_rng(6).permutation(data.n)
    shuffled = fit(model, data.subset(order))
    np.testing.assert_allclose(shuffled.poses.translation, first.poses.translation[:, order], rtol=0, atol=1e-10)
    monkeypatch.setattr(robacc.fitting.normal_equations, "BLOCK", 7)
    blocked = fit(model, data)
    np.testing.assert_allclose(blocked.poses.translation, first.poses.translation, rtol=0, atol=1e-10)
    assert blocked.chi_square == pytest.approx(first.chi_square, rel=1e-6)


@pytest.mark.parametrize("n", [300, 600])
def test_a_direction_that_the_poses_hardly_show_does_not_hold_up_the_others(n: int) -> None:
    # Positions of a target on the last axis: registering it makes up levers of a micrometre, along which a step is
    # radians long. Every other coefficient still reaches its minimum, which takes its share of chi-square.
    noise = 2e-5
    plan = Plan(n, seed=1, noise_position=noise, orientation=False, motion=False)
    robot = dataclasses.replace(arm("puma560").robot, tool=Frame())
    data = simulate(robot, plan).data
    left = []
    for names in (("base_frame", "tool_frame"), ("base_frame", "tool_frame", "joint_offset", "link_geometry")):
        found = fit(Model.of(robot, effects("puma560", *names)), data, Options(robust=False))
        left.append((float(np.square(found.residual / noise).sum()), found.identifiability.columns.size))
    (before, few), (after, many) = left
    assert stats.chi2.cdf(before - after, many - few) > 1e-3
    assert stats.chi2.sf(before - after, many - few) > 1e-3


POSES, CYCLES, TARGETS = 5, 4, 3
N = POSES * CYCLES * TARGETS
COMPONENTS, JOINTS = 3, 4
NOISE_OF_WHITENING = 1.3
DIRECTIONAL = np.array([[2.0, 0.6, -0.5], [0.6, 0.9, 0.3], [-0.5, 0.3, 1.4]])
"""Covariance of each row beside the noise."""
CASES = [(0.5, None), (0.0, None), (0.5, DIRECTIONAL), (0.0, DIRECTIONAL)]


class Sample:
    """Rows in random order, with their covariance as one dense matrix; component by component, row by row."""

    def __init__(self, visit_std: float, noise: np.ndarray | None = None) -> None:
        rng = np.random.default_rng(1)
        self.visits = np.repeat(np.arange(POSES * CYCLES), TARGETS)[rng.permutation(N)]
        self.weight = np.full((COMPONENTS, N), 1.0 / NOISE_OF_WHITENING)
        self.columns = rng.normal(size=(COMPONENTS, JOINTS, N))
        self.scatter = visit_std * np.arange(1.0, JOINTS + 1)
        self.dense = np.diag(1.0 / np.square(self.weight.ravel()))
        self.dense += sum(std**2 * self.shared(self.visits, joint) for joint, std in enumerate(self.scatter.tolist()))
        self.noise = noise
        if noise is not None:
            self.dense += np.kron(noise, np.eye(N))

    def shared(self, groups: np.ndarray, joint: int) -> np.ndarray:
        """B B^T of a joint whose error the rows of a group share."""
        column, number = self.columns[:, joint].ravel(), np.tile(groups, COMPONENTS)
        return np.outer(column, column) * (number[:, None] == number)

    def whitening(self) -> Whitening:
        return whitening(self.weight, self.columns, self.scatter, self.visits, self.noise_of_rows())

    def noise_of_rows(self) -> np.ndarray | None:
        return None if self.noise is None else np.repeat(self.noise[..., None], N, axis=2)


def matrix(white: Whitening) -> np.ndarray:
    unit = np.eye(COMPONENTS * N).reshape(-1, COMPONENTS, N)
    return white.apply(unit).reshape(COMPONENTS * N, -1).T


@pytest.mark.parametrize(("visit_std", "noise"), CASES)
def test_residuals_get_unit_covariance(visit_std: float, noise: np.ndarray | None) -> None:
    sample = Sample(visit_std, noise)
    white = sample.whitening()
    root = matrix(white)
    np.testing.assert_allclose(root @ sample.dense @ root.T, np.eye(COMPONENTS * N), atol=1e-12)
    unit = np.eye(COMPONENTS * N).reshape(-1, COMPONENTS, N)
    np.testing.assert_allclose(white.apply_transposed(unit).reshape(COMPONENTS * N, -1), root, atol=1e-13)


FIT = "base_frame,tool_frame,joint_offset,link_geometry,joint_compliance[j2,j3]"
NOISE_OF_HELD_OUT = 5e-5


def measured_of_held_out(poses: int = 40, cycles: int = 1, *, orientation: bool = True) -> Measurements:
    robot = dataclasses.replace(
        arm("puma560").robot,
        effects=({"effect": "joint_compliance", "joints": ["j2", "j3"], "values": {"j2": 2e-5, "j3": 3e-5}},),
    )
    plan = Plan(
        poses, seed=1, cycles=cycles, noise_position=NOISE_OF_HELD_OUT, noise_orientation=1e-4, orientation=orientation
    )
    return simulate(robot, plan).data


def fitted(data: Measurements, asked: str = FIT, **options: object) -> Fit:
    return fit(model_of(arm("puma560").robot, asked, data), data, Options(**options))  # type: ignore[arg-type]


def refitted(data: Measurements, groups: Array, asked: str, like: Fit) -> Array:
    """Residuals of each group by fits to all others."""
    apart = np.empty((3 if data.rotation is None else 6, data.n))
    for group in np.unique(groups):
        inside = np.flatnonzero(groups == group)
        part = fitted(data.subset(np.flatnonzero(groups != group)), asked, misfit=like.misfit, robust=False)
        apart[:, inside] = residuals(data.subset(inside), part.predict(data.subset(inside)))
    return apart


@pytest.mark.parametrize(("cycles", "orientation", "folds"), [(1, False, None), (1, True, 5), (3, True, None)])
def test_each_pose_is_predicted_as_by_a_fit_without_it(cycles: int, orientation: bool, folds: int | None) -> None:
    data = measured_of_held_out(24, cycles, orientation=orientation)
    found = fitted(data, robust=False)
    how = HoldOut.of(data, None, folds, 0)
    (apart,) = how.residuals(found)
    np.testing.assert_allclose(
        apart, refitted(data, how.groups, FIT, found), rtol=0, atol=0.05 * np.std(found.residual[:3])
    )
    assert np.std(apart) > 1.02 * np.std(found.residual)


def test_a_model_without_an_effect_is_fitted_again_without_it() -> None:
    data = measured_of_held_out()
    found = fitted(data, robust=False)
    how = HoldOut.of(data, None, None, 0)
    (lacking,) = how.residuals(found, [[4]])
    reference = refitted(data, how.groups, FIT.partition(",joint_compliance")[0], found)
    size = np.sqrt(np.mean(np.square(reference[:3])))
    assert size > 3 * NOISE_OF_HELD_OUT
    assert np.sqrt(np.mean(np.square((lacking - reference)[:3]))) < 0.02 * size


def test_repeats_are_held_out_together_whatever_the_order_of_rows() -> None:
    data = measured_of_held_out(17, 3)
    for one in (data, dataclasses.replace(data, pose=None)):
        how = HoldOut.of(one, None, 5, 0)
        for pose in np.unique(one.q, axis=1).T:
            assert np.unique(how.groups[np.all(one.q == pose[:, None], axis=0)]).size == 1
        assert sorted(np.bincount(how.groups)) == [9, 9, 9, 12, 12]
        order = np.random.default_rng(1).permutation(one.n)
        np.testing.assert_array_equal(HoldOut.of(one.subset(order), None, 5, 0).groups, how.groups[order])
        assert not np.array_equal(HoldOut.of(one, None, 5, 1).groups, how.groups)


def test_a_coefficient_that_one_pose_alone_determines_is_nominal_for_that_pose() -> None:
    # Only the last pose turns j1, so that only it separates its gear ratio from a turn of the base.
    data = measured_of_held_out(30, orientation=False)
    q = data.q.copy()
    q[0, :-1] = 0.3
    one = arm("puma560")
    model = model_of(one.robot, "gear_ratio[j1],base_frame", data)
    moved = dataclasses.replace(data, q=q)
    bound = model.bind(moved)
    exact = bound.poses(np.array([2e-3 * name.startswith("gear_ratio") for name in bound.names]))
    moved = dataclasses.replace(moved, position=exact.translation)
    found = fit(model, moved, Options(robust=False))
    alone: list[list[int]] = []
    (poses,) = held_out_poses(found, moved, np.arange(moved.n), undetermined=lambda rows: alone.append(rows.tolist()))
    assert alone == [[29]]
    # The base explains the others; a nominal gear ratio leaves the whole error at the last pose.
    error = np.linalg.norm(moved.position - poses.translation, axis=0)
    assert error[:-1].max() < 1e-6
    assert error[-1] > 1e-4


PLACE = ("tool_frame.x", "tool_frame.y", "tool_frame.z")
GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")


def identify(matrix: np.ndarray, names: Sequence[str], n: int, units: Sequence[str] = ()) -> Identifiability:
    terms = [Term(name, unit, 1.0, ()) for name, unit in zip(names, units or names, strict=True)]
    return identify_terms(matrix, terms, n)


def geometric_model(name: str, data: Measurements, effects: tuple[str, ...] = GEOMETRY) -> Model:
    one = arm(name)
    return Model.of(one.robot, [REGISTRY[effect].default(one, data) for effect in effects])


def test_a_column_that_others_make_up_is_dropped_with_its_partners() -> None:
    rng = np.random.default_rng(0)
    a, b, c, noise = rng.normal(size=(4, 50))
    matrix = np.stack((a, 1e-6 * b, 2 * a - 3 * b, np.zeros(50), c, c + 1e-4 * noise), axis=1)
    found = identify(matrix, ("a", "b", "ab", "nothing", "c", "nearly c"), 50)
    assert found.columns.tolist() == [0, 1, 4, 5]
    assert [drop.name for drop in found.dropped] == ["ab", "nothing"]
    assert set(found.dropped[0].partners) == {"a", "b"}
    assert (
        found.dropped[0].why
        == f"ab is not distinguishable from {', '.join(found.dropped[0].partners)} together on these poses"
    )
    assert found.dropped[1].why == "nothing has no effect on these poses"


@pytest.mark.parametrize(("angle", "kept"), [(3 * DEPENDENT, 2), (DEPENDENT / 3, 1)])
def test_the_limit_is_the_part_that_is_new(angle: float, kept: int) -> None:
    # Two unit columns at a known angle; neither the units of a column nor its order in the rows matters.
    matrix = np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)], [0.0, 0.0]])
    for scale in (np.ones(2), np.array([1e5, 1e-5])):
        assert identify(matrix * scale, ("one", "other"), 3).columns.size == kept
        assert identify((matrix * scale)[::-1], ("one", "other"), 3).columns.size == kept


def test_a_lever_that_no_instrument_sees_tells_nothing() -> None:
    matrix = np.diag([1.0, DEPENDENT / 3, DEPENDENT / 3])
    assert identify(matrix, ("a", "b", "c"), 3).columns.tolist() == [0, 1, 2]
    assert identify(matrix, ("a", "b", "c"), 3, ("rad", "rad", "m")).columns.tolist() == [0, 2]


def upright(turn: float) -> Measurements:
    """Return poses of a PUMA whose last link turns about the vertical, else by ``turn`` rad; joint 2 errs by waves."""
    rng = np.random.default_rng(4)
    n = 60
    q = rng.uniform(-0.8, 0.8, (6, n))
    q[3], q[5] = turn * rng.standard_normal((2, n))
    q[4] = 0.6 - q[1] - q[2] + turn * rng.standard_normal(n)
    reached = q.copy()
    reached[1] += 3e-4 * np.sin(9.0 * q[1])
    true = Model.of(arm("puma560").robot).bind(Measurements(q=reached, position=np.zeros((3, n)))).poses(np.zeros(0))
    return Measurements(q=q, position=true.translation + rng.normal(0.0, 1e-5, (3, n)), rotation=true.rotation)


@pytest.mark.parametrize(("turn", "tells"), [(3e-4, False), (2e-2, True)])
def test_turns_as_small_as_the_arms_own_errors_tell_no_place_of_the_target(turn: float, tells: bool) -> None:
    data = upright(turn)
    found = fit(geometric_model("puma560", data, ("base_frame", "tool_frame", "joint_offset")), data, Options())
    held = [
        drop for drop in found.identifiability.dropped if drop.name.startswith("tool_frame") and drop.name[-1] in "xyz"
    ]
    assert len(held) == (0 if tells else 1)
    if not tells:
        assert "base_frame.z" in held[0].partners
    moved = [value for name, value in zip(found.names, found.theta, strict=True) if name in PLACE]
    place = np.array(found.model.arm.robot.tool.xyz) + moved
    # Least squares alone misses by 8 mm (standard error 21 mm) with turns of 0.3 mrad.
    np.testing.assert_allclose(place, arm("puma560").robot.tool.xyz, atol=1e-3)


def test_observability_indices_are_those_of_the_definition() -> None:
    matrix = np.diag([3.0, 5.0]) @ np.array([[1.0, 0.6], [0.0, 0.8]])
    found = identify(matrix, ("a", "b"), 16)
    columns = matrix / np.linalg.norm(matrix, axis=0)
    # The singular values of two unit columns at an angle follow from its cosine alone.
    cosine = columns[:, 0] @ columns[:, 1]
    first, last = np.sqrt(1 + abs(cosine)), np.sqrt(1 - abs(cosine))
    expected = {
        "O1": np.sqrt(first * last) / 4,
        "O2": last / first,
        "O3": last,
        "O4": last**2 / first,
        "O5": 1 / (1 / first + 1 / last),
    }
    assert found.observability() == pytest.approx(expected, rel=1e-12)
    assert found.condition == pytest.approx(first / last, rel=1e-12)
