"""What poses cannot tell apart: decided before the fit, the same every time, and said in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from arms import arm

from robacc.effects import REGISTRY
from robacc.effects.base import Term
from robacc.fitting.fit_result import DEPENDENT, Identifiability, Options, identify_terms
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate

PLACE = ("tool_frame.x", "tool_frame.y", "tool_frame.z")
GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")


def identify(matrix: np.ndarray, names: Sequence[str], n: int, units: Sequence[str] = ()) -> Identifiability:
    terms = [Term(name, unit, 1.0, ()) for name, unit in zip(names, units or names, strict=True)]
    return identify_terms(matrix, terms, n)


def poses(name: str, n: int = 40, seed: int = 2, *, orientation: bool = True) -> Measurements:
    plan = Plan(n, seed=seed, noise_position=2e-5, noise_orientation=2e-5, orientation=orientation)
    return simulate(arm(name).robot, plan).data


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


def test_poses_too_much_alike_lose_coefficients() -> None:
    # A joint that never moved is part of a link: 4 R + 6 of an arm of one joint fewer.
    data = poses("puma560", 60)
    q = data.q.copy()
    q[3] = 0.3
    still = dataclasses.replace(data, q=q)
    assert fit(geometric_model("puma560", data), data).identifiability.columns.size == 4 * 6 + 6
    assert fit(geometric_model("puma560", still), still).identifiability.columns.size == 4 * 5 + 6


def test_the_decision_does_not_depend_on_the_order_of_rows_or_on_the_run() -> None:
    data = poses("panda", 50, orientation=False)
    shuffled = data.subset(np.random.default_rng(3).permutation(data.n))
    first, again, other = (fit(geometric_model("panda", one), one) for one in (data, data, shuffled))
    assert first.identifiability.dropped == again.identifiability.dropped
    np.testing.assert_array_equal(first.theta, again.theta)
    assert [drop.name for drop in first.identifiability.dropped] == [
        drop.name for drop in other.identifiability.dropped
    ]
    assert [set(drop.partners) for drop in first.identifiability.dropped] == [
        set(drop.partners) for drop in other.identifiability.dropped
    ]
