"""Choice of the deflection model: by the data if the models are distinguishable, else equilibrium."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from io import StringIO

import numpy as np
import pytest
from arms import arm
from scipy import stats

from robacc.documents.fit import CALIBRATE, TRACE, fit_document
from robacc.effects.specification import Baseline, build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.masses import BETTER, choose_form
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.render.text import draw
from robacc.render.views.fit import fit_view
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import Calibration, calibrate
from robacc.tracing.trace import trace

DECLARED = Baseline(("base_frame", "tool_frame"), by_default=False)
ASKED = "base_frame,tool_frame,joint_offset,lateral_compliance[j4]"
NOISE = 8e-6
SOFT, STIFF = 1e-3, 1e-6
"""rad/(N m): the wrist of a Puma 560 sags by 2 mm, and by 2 um."""


def bent(form: str, compliance: float = SOFT) -> Robot:
    entry = {"effect": "lateral_compliance", "joints": ["j4"], "values": {"j4": compliance}}
    settings = {} if form == "equilibrium" else {"deflection": form}
    return dataclasses.replace(arm("puma560").robot, effects=(entry | settings,))


@cache
def measured(
    form: str, compliance: float = SOFT, seed: int = 0, known: bool = False, n: int = 120, noise: float = NOISE
) -> Measurements:
    data = simulate(bent(form, compliance), Plan(n, seed=seed, noise_position=noise)).data
    sigma = np.full((3, data.n), noise) if known else None
    return dataclasses.replace(data, rotation=None, sigma_position=sigma, sigma_rotation=None)


@cache
def calibrated(form: str, compliance: float = SOFT, known: bool = False) -> Calibration:
    data = measured(form, compliance, known=known)
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
        data = measured("rigid", known=True)
        effects = calibrated("equilibrium").effects
        model = Model.of(arm("puma560").robot, effects)
        found = fit(model, data, options)
        other, chosen = choose_form(found, model, data, options)
        return chosen.gain, found, other

    count = len(calibrated("equilibrium").fit.names)
    prior = np.full(count, np.inf)
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
    found, data = calibrated(form, compliance), measured(form, compliance)
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
    robot, data = arm("puma560").robot, measured(form, n=300, noise=2e-5)
    declared = build(parse_requests("base_frame,tool_frame,joint_offset,link_geometry"), arm("puma560"), data)
    holdout = measured(form, seed=1, n=300, noise=2e-5) if apart else None
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
