"""Deflection, the direction of gravity, and masses that are uncertain."""

import dataclasses
import json
from functools import cache
from io import StringIO

import numpy as np
import pytest
from arms import arm
from independent_arm import DH, Matrix, link_frames, measured, run, targets
from scipy import stats
from searched import ARM, model

from robacc.documents.fit import CALIBRATE, TRACE, fit_document
from robacc.effects.elastic import JointCompliance
from robacc.effects.specification import Baseline, build, parse_requests
from robacc.errors import InputError
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.masses import BETTER, choose_form, with_mass_uncertainty
from robacc.fitting.normal_equations import posterior, solved
from robacc.fitting.parameters import parameters
from robacc.fitting.registration import align, gravity_warning, with_gravity_direction
from robacc.fitting.solver import fit
from robacc.fitting.warnings import fit_warnings, lack_of_fit
from robacc.geometry import rotation_from_rpy
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.render.text import draw
from robacc.render.views.fit import fit_view
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import Calibration, calibrate
from robacc.tracing.trace import trace

NOISE = 2e-5
SPRINGS = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])
DOWN = np.array([0.0, 0.0, -9.81])


def torques(q: Matrix, gravity: Matrix) -> Matrix:
    """Torque about each joint: the slope of the work of gravity (3,), stated in the base."""

    def work(at: Matrix) -> float:
        frames = link_frames(at)
        return sum(
            m * float(gravity @ (frame @ np.append(com, 1.0))[:3])
            for frame, (*_, m, com) in zip(frames, DH, strict=True)
        )

    step = 1e-5
    return np.array([(work(q + e) - work(q - e)) / (2 * step) for e in step * np.eye(6)])


def campaign(tilt: Matrix, gravity: Matrix, springs: Matrix = SPRINGS, n: int = 80, seed: int = 1) -> Measurements:
    """Poses of an arm under ``gravity`` in its base, in a measuring frame in which the base is turned by ``tilt``."""
    poses = run(n, seed)
    bent = np.array([q + springs * torques(q, gravity) for q in poses.q.T]).T
    return measured(poses, rotation_from_rpy(tilt) @ targets(bent), NOISE, seed)


def found(data: Measurements) -> tuple[Matrix, str | None]:
    shown = with_gravity_direction(model(data), data).arm.robot.gravity
    return np.array(shown), next(iter(gravity_warning(ARM.robot.gravity, shown)), None)


@pytest.mark.parametrize(
    "tilt",
    [(np.radians(4.0), 0.0, 0.3), (0.0, np.radians(-20.0), 2.0), (np.pi / 2, 0.0, 0.0), (np.pi, 0.0, 1.0)],
    ids=["four degrees", "twenty", "another axis up", "upside down"],
)
def test_deflections_show_where_gravity_acts_in_a_frame_that_is_not_level(tilt: tuple[float, float, float]) -> None:
    """The base stands upright; the frame of the instrument does not."""
    shown, warning = found(campaign(np.array(tilt), DOWN))
    true = rotation_from_rpy(np.array(tilt)) @ DOWN
    assert np.degrees(np.arccos(shown @ true / 9.81**2)) < 0.1
    assert "the measuring frame is not level" in warning


@pytest.mark.parametrize(
    "tilt", [(0.0, 0.0, 1.2), (np.pi / 2, 0.0, 0.0), (0.0, np.radians(30.0), 0.0), (np.pi, 0.0, 0.0)]
)
def test_an_arm_that_leans_in_a_level_frame_keeps_the_gravity_of_its_file(tilt: tuple[float, float, float]) -> None:
    """On a wall, on a slope, under a ceiling; the file does not say how the base stands."""
    shown, warning = found(campaign(np.array(tilt), rotation_from_rpy(np.array(tilt)).T @ DOWN))
    assert warning is None
    assert shown.tolist() == DOWN.tolist()


@pytest.mark.parametrize("seed", range(5))
def test_a_rigid_arm_shows_no_direction(seed: int) -> None:
    tilt = np.array([np.radians(25.0), 0.0, 0.0])
    assert found(campaign(tilt, DOWN, np.zeros(6), 40, seed))[1] is None


def test_trace_names_the_springs_and_a_model_holds_in_other_frames() -> None:
    data = campaign(np.array([np.radians(15.0), np.radians(-7.0), 0.4]), DOWN)
    result = trace(model(data), data)
    assert {(finding.effect, finding.joints) for finding in result.findings} == {
        ("joint_compliance", ("j2",)),
        ("joint_compliance", ("j3",)),
    }
    assert any("not level" in warning for warning in result.warnings)
    other = campaign(np.array([0.0, np.radians(50.0), -1.0]), DOWN, n=30, seed=8)
    registered = align(result.robot, other, ["base_frame"])
    error = other.position - predict(registered.robot, other).translation
    assert np.sqrt(np.mean(np.sum(error**2, axis=0))) < 2.0 * NOISE * np.sqrt(3)
    assert any("not level" in note for note in registered.notes)


DECLARED = Baseline(("base_frame", "tool_frame"), by_default=False)
ASKED = "base_frame,tool_frame,joint_offset,lateral_compliance[j4]"
NOISE_OF_DEFLECTION_MODEL = 8e-6
SOFT, STIFF = 1e-3, 1e-6
"""rad/(N m): the wrist of a Puma 560 sags by 2 mm, and by 2 um."""


def bent(form: str, compliance: float = SOFT) -> Robot:
    entry = {"effect": "lateral_compliance", "joints": ["j4"], "values": {"j4": compliance}}
    settings = {} if form == "equilibrium" else {"deflection": form}
    return dataclasses.replace(arm("puma560").robot, effects=(entry | settings,))


@cache
def measured_of_deflection_model(
    form: str,
    compliance: float = SOFT,
    seed: int = 0,
    known: bool = False,
    n: int = 120,
    noise: float = NOISE_OF_DEFLECTION_MODEL,
) -> Measurements:
    data = simulate(bent(form, compliance), Plan(n, seed=seed, noise_position=noise)).data
    sigma = np.full((3, data.n), noise) if known else None
    return dataclasses.replace(data, rotation=None, sigma_position=sigma, sigma_rotation=None)


@cache
def calibrated(form: str, compliance: float = SOFT, known: bool = False) -> Calibration:
    data = measured_of_deflection_model(form, compliance, known=known)
    return calibrate(arm("puma560").robot, data, parse_requests(ASKED), n_folds=2)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("form", ["equilibrium", "rigid"])
def test_the_form_of_a_soft_arm_is_the_one_its_poses_have(form: str, known: bool) -> None:
    found = calibrated(form, known=known)
    chosen = found.deflection
    assert chosen.form == form
    assert (chosen.gain > BETTER) == (form == "rigid")
    # Micrometres of two millimetres; where the data have no other error, the gain is about the squared separation.
    assert 3e-6 < chosen.difference < 1e-5
    assert abs(chosen.gain) == pytest.approx(chosen.separation**2, rel=0.6)
    values = {one.name: one for one in found.parameters}
    one = values["lateral_compliance.j4"]
    assert one.value == pytest.approx(SOFT, abs=4 * one.std)
    assert {e.settings().get("deflection", "equilibrium") for e in found.effects if e.name.startswith("lat")} == {form}


def test_log_likelihood_is_that_of_independent_normal_errors_and_of_the_priors() -> None:
    def gain(options: Options) -> tuple[float, Fit, Fit]:
        data = measured_of_deflection_model("rigid", known=True)
        model = Model.of(arm("puma560").robot, calibrated("equilibrium").effects)
        found = fit(model, data, options)
        other, chosen = choose_form(found, model, data, options)
        return chosen.gain, found, other

    prior = np.full(len(calibrated("equilibrium").fit.names), np.inf)
    prior[-1] = 1e-4
    value, found, other = gain(Options(priors=prior, robust=False))

    def density(one: Fit) -> float:
        errors = stats.norm.logpdf(one.residual, scale=1.0 / one.weight).sum()
        zeros = [name.startswith("joint_offset.") for name in one.names]
        return float(
            errors
            + stats.norm.logpdf(one.theta[-1], scale=1e-4)
            + stats.cauchy.logpdf(one.theta[zeros], scale=np.sqrt(2.0) * 3e-3).sum()
        )

    assert value == pytest.approx(2 * (density(other) - density(found)), rel=1e-9)


@pytest.mark.parametrize(
    ("form", "compliance", "said"),
    [
        (
            "rigid",
            SOFT,
            "deflection model: undeflected pose; torques at the undeflected pose change the prediction",
        ),
        (
            "equilibrium",
            SOFT,
            "deflection model: equilibrium; torques at the undeflected pose change the prediction by 0.00",
        ),
        ("equilibrium", STIFF, "mm rms, too little to distinguish the two models"),
    ],
)
def test_table_and_document_say_which_form_and_why(form: str, compliance: float, said: str) -> None:
    found, data = calibrated(form, compliance), measured_of_deflection_model(form, compliance)
    payload = fit_document(CALIBRATE, found, data, arm("puma560").robot, baseline=DECLARED)
    stream = StringIO()
    draw(fit_view(payload, "poses.csv", "robot.yaml", "full"), stream)
    assert said in " ".join(stream.getvalue().split())
    document = payload["deflection"]
    assert json.loads(json.dumps(document)) == document
    assert document == {
        "form": form,
        "difference_rms_m": found.deflection.difference,
        "difference_whitened": found.deflection.separation,
        "rigid_better_by": found.deflection.gain,
        "needed": BETTER,
    }


@pytest.mark.parametrize(
    ("form", "apart"),
    [
        pytest.param("equilibrium", False, marks=pytest.mark.slow),
        ("rigid", True),
        pytest.param("equilibrium", True, marks=pytest.mark.slow),
        pytest.param("rigid", False, marks=pytest.mark.slow),
    ],
)
def test_a_finding_of_a_trace_gets_the_form_too(form: str, apart: bool) -> None:
    # As much noise as leaves the search nothing to explain but the finding, and as many poses as show its form.
    robot, data = arm("puma560").robot, measured_of_deflection_model(form, n=300, noise=2e-5)
    declared = build(parse_requests("base_frame,tool_frame,joint_offset,link_geometry"), arm("puma560"), data)
    holdout = measured_of_deflection_model(form, seed=1, n=300, noise=2e-5) if apart else None
    found = trace(Model.of(robot, declared), data, n_folds=4, holdout=holdout)
    settings = {} if form == "equilibrium" else {"deflection": "rigid"}
    assert [(one.effect, one.joints, one.settings) for one in found.findings] == [
        ("lateral_compliance", ("j4",), settings)
    ]
    assert found.deflection.form == form
    finding = found.findings[0]
    assert finding.held_out_after < 2 * np.sqrt(3) * 2e-5 < finding.held_out_before
    again = predict(parse_robot(robot_to_yaml(found.robot), "model.yaml"), data)
    np.testing.assert_allclose(again.translation, found.fit.poses.translation, rtol=0, atol=1e-12)
    payload = fit_document(TRACE, found, data, robot, holdout, baseline=DECLARED)
    assert payload["deflection"]["form"] == form
    assert payload["findings"][0]["settings"] == settings
    stream = StringIO()
    draw(fit_view(payload, "poses.csv", "robot.yaml", "full"), stream)
    assert "torques at the undeflected pose change" in " ".join(stream.getvalue().split())


JOINTS = ("j2", "j3")
COMPLIANCE = {"j2": 3e-6, "j3": 8e-6}


def with_masses(robot: Robot, factors: np.ndarray) -> Robot:
    joints = tuple(
        dataclasses.replace(joint, mass=None if joint.mass is None else joint.mass * factor)
        for joint, factor in zip(robot.joints, factors, strict=True)
    )
    return dataclasses.replace(robot, joints=joints)


def measured_of_mass_uncertainty(robot: Robot, rng: np.random.Generator, n: int = 40) -> Measurements:
    """Noisy poses of an arm with compliant joints and these masses."""
    entry = {"effect": "joint_compliance", "joints": list(JOINTS), "values": COMPLIANCE}
    q = rng.uniform(-1.5, 1.5, (len(robot.variables), n))
    data = Measurements(position=np.zeros((3, n)), q=q)
    exact = predict(dataclasses.replace(robot, effects=(entry,)), data).translation
    sigma = np.full((3, n), NOISE)
    return dataclasses.replace(data, position=exact + rng.normal(0, NOISE, (3, n)), sigma_position=sigma)


def fitted(robot: Robot, data: Measurements) -> Fit:
    return fit(Model(Arm.of(robot), (), (JointCompliance(JOINTS),)), data)


def test_sensitivity_to_a_mass_is_that_of_a_fit_with_another_mass() -> None:
    robot = dataclasses.replace(arm("puma560").robot, mass_uncertainty=1.0)
    data = measured_of_mass_uncertainty(robot, np.random.default_rng(0))
    first = fitted(robot, data)
    added = with_mass_uncertainty(first, data).covariance - first.covariance
    expected = np.zeros((2, 2))
    for i, joint in enumerate(robot.joints):
        if joint.mass:
            factors = np.ones(len(robot.joints))
            factors[i] = 1.01
            change = (fitted(with_masses(robot, factors), data).theta - first.theta) / 0.01
            expected += np.outer(change, change)
    np.testing.assert_allclose(added, expected, rtol=0.03, atol=0.03 * np.abs(expected).max())


def test_the_default_is_stated_and_the_file_can_state_another() -> None:
    robot = arm("puma560").robot
    data = measured_of_mass_uncertainty(robot, np.random.default_rng(1))
    default = fitted(robot, data)
    texts = list(fit_warnings(default, data, lack_of_fit(default, data), default, (1.0, 1.0)))
    assert any("an uncertainty of 10 % of each link's mass" in text for text in texts)
    stds = []
    for share in (None, 0.1, 0.0):
        stated = dataclasses.replace(robot, mass_uncertainty=share)
        stated = parse_robot(robot_to_yaml(stated), "stated.yaml")
        assert stated.mass_uncertainty == share
        stds.append(parameters(with_mass_uncertainty(fitted(stated, data), data))[0].std)
    assert stds[0] == stds[1]
    assert stds[1] > 1.2 * stds[2], "10 % of a mass is as large as the noise of 40 poses"
    with pytest.raises(InputError, match=r"mass_uncertainty.*share from 0 to 1"):
        parse_robot(robot_to_yaml(robot) + "mass_uncertainty: 20\n", "wrong.yaml")


def test_singular_systems_have_a_solution_without_the_missing_direction() -> None:
    matrix = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.solve(matrix, np.ones(3))
    np.testing.assert_allclose(solved(matrix, np.array([1.0, 1.0, 0.0])), [0.5, 0.5, 0.0], atol=1e-9)
    assert np.isfinite(posterior(matrix, np.zeros(3))).all()
