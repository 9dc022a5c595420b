"""The broad prior bounds weakly identifiable constants, and leaves all others to the data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc.fitting.solver
from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.parameters import apply_fit
from robacc.fitting.priors import weak_kinds
from robacc.fitting.solver import fit
from robacc.fitting.warnings import fit_warnings, lack_of_fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Robot

GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"
NOISE = 2e-4


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


def measured(robot: Robot, q: np.ndarray, seed: int, oriented: bool, noise: float = NOISE) -> Measurements:
    rng = np.random.default_rng(seed)
    data = Measurements(position=np.zeros((3, q.shape[1])), q=q)
    poses = predict(robot, data)
    position = poses.translation + rng.normal(scale=noise, size=poses.translation.shape)
    return dataclasses.replace(data, position=position, rotation=poses.rotation if oriented else None)


def geometry(
    name: str, data: Measurements, robot: Robot | None = None, options: Options | None = None, asked: str = GEOMETRY
) -> Fit:
    nominal = dataclasses.replace(robot or arm(name).robot, effects=())
    model = Model.of(nominal, build(parse_requests(asked), Model.of(nominal).arm, data))
    return fit(model, data, options or Options())


def warnings(found: Fit, data: Measurements, start: str) -> list[str]:
    texts = fit_warnings(found, data, lack_of_fit(found, data), found, (1.0, 1.0))
    return [text for text in texts if text.startswith(start)]


def joints(name: str, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    limits = np.array([joint.limits for joint in arm(name).robot.variables])
    return rng.uniform(0.6 * limits[:, :1], 0.6 * limits[:, 1:], size=(len(limits), n))


def one_orientation(n: int, seed: int) -> np.ndarray:
    """Return poses of a UR10 with nearly one orientation of the target: the last joints turn by a few degrees."""
    q = joints("ur10", n, seed)
    q[3:] = np.array([[-1.0], [1.57], [0.3]]) + 0.05 * np.random.default_rng(seed).normal(size=(3, n))
    return q


@pytest.mark.slow
def test_few_orientations_do_not_change_links_by_centimetres(monkeypatch: pytest.MonkeyPatch) -> None:
    true = made("ur10", 1)
    data = measured(true, one_orientation(25, 2), 3, oriented=False)
    others = Measurements(position=np.zeros((3, 300)), q=joints("ur10", 300, 4))
    wanted = predict(true, others).translation

    def miss(found: Fit) -> float:
        return float(
            np.sqrt(np.mean(np.sum(np.square(predict(apply_fit(found), others).translation - wanted), axis=0)))
        )

    found = geometry("ur10", data)
    kinds = {(kind.effect, kind.unit): kind for kind in weak_kinds(found)}
    assert set(kinds) == {("joint_offset", "rad"), ("link_geometry", "m"), ("link_geometry", "rad")}
    assert all(kind.std == 3e-3 for kind in kinds.values())
    assert all(name.startswith(f"{kind.effect}.") for kind in kinds.values() for name in kind.names)
    (warning,) = warnings(found, data, "weakly identifiable on these poses: ")
    assert "(standard deviation 3 mrad and 3 mm, that of a badly made arm)" in warning
    monkeypatch.setattr(robacc.fitting.solver, "BADLY_MADE", np.inf)
    free = geometry("ur10", data)
    assert warnings(free, data, "weakly identifiable on these poses: ") == []
    # With priors, errors at other orientations are those of the arm as built; without, noise makes them larger.
    assert miss(found) < 4e-3
    assert miss(free) > 3 * miss(found)


@pytest.mark.parametrize(("largest_std", "expected"), [(0.8e-3, False), (1.0e-3, True), (3e-3, True)])
def test_a_standard_error_above_a_millimetre_is_weak(largest_std: float, expected: bool) -> None:
    # Standard errors are proportional to the stated noise, which is chosen for a largest one of so many m or rad.
    robot = dataclasses.replace(arm("ur10").robot, effects=())
    data = measured(robot, joints("ur10", 60, 2), 3, oriented=False, noise=0.0)
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
    found = geometry("panda", measured(robot, joints("panda", 150, 6), 7, oriented=False))
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
    data = measured(true, joints("ur10", n, 8), 9, oriented, noise=5e-5)
    rms = []
    for robot in (arm("ur10").robot, altered(arm("ur10").robot, changes)):
        found = geometry("ur10", data, robot)
        assert weak_kinds(found) == ()
        miss = predict(apply_fit(found), fresh).translation - wanted
        rms.append(float(np.sqrt(np.mean(np.sum(np.square(miss), axis=0)))))
    # Three zeros that are thirty standard deviations off are pulled by a tenth of their standard errors at 20 poses.
    assert rms[1] < 1.15 * rms[0]


def test_outliers_do_not_leave_a_wrong_length() -> None:
    data = measured(made("ur10", 8), joints("ur10", 30, 8), 9, oriented=True, noise=5e-5)
    data = dataclasses.replace(data, position=data.position + 0.5 * (np.arange(30) < 2))
    found = geometry("ur10", data, altered(arm("ur10").robot, {(1, "a"): 0.03}))
    assert found.outliers.tolist() == [0, 1]
    assert found.theta[found.names.index(f"link_geometry.{arm('ur10').names[1]}.a")] == pytest.approx(-0.03, abs=2e-3)


def test_poses_of_nearly_one_orientation_leave_the_tool_unknown() -> None:
    """The orientation of the flange stays the same but for a thousandth."""
    q, small = joints("irb1600", 80, 2), 1e-3 * np.random.default_rng(0).standard_normal((4, 80))
    q[4] = 0.6 - q[1] - q[2] + small[3]
    q[[0, 3, 5]] = small[:3]
    data = measured(dataclasses.replace(arm("irb1600").robot, effects=()), q, 1, oriented=False, noise=2e-5)
    (warning,) = warnings(geometry("irb1600", data, asked="base_frame,tool_frame"), data, "condition number")
    assert "weakly identifiable on these poses, most of all" in warning
    assert "tool_frame." in warning
    assert " mm)" in warning
