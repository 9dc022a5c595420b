"""The periodic error of a slide: a screw's lead, a pinion's circumference."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.modelling.model import predict
from robacc.simulation.simulate import Plan, simulate

DECLARED = "base_frame,tool_frame,joint_offset"


@pytest.mark.parametrize("order", [12.0, 314.0])
def test_a_screw_is_named_with_its_period(order: float) -> None:
    """The larger order is above those that compete with every candidate."""
    nominal = dataclasses.replace(arm("stanford").robot, effects=())
    screw = {
        "effect": "transmission_error",
        "joints": ["j3"],
        "orders": [order],
        "values": {f"j3.cos{order:g}": 6e-5, f"j3.sin{order:g}": -8e-5},
    }
    robot = dataclasses.replace(nominal, effects=(screw,))
    data = simulate(robot, Plan(150, seed=4, noise_position=2e-5, orientation=False)).data
    result = robacc.trace(data, robot=nominal, declared=DECLARED, folds=3)
    (finding,) = result.findings
    assert (finding.effect, finding.joints, result.verdict) == ("transmission_error", ("j3",), "explained")
    assert finding.settings["orders"] == pytest.approx([order], abs=0.5)
    amplitude = np.hypot(*(parameter.value for parameter in finding.parameters))
    assert amplitude == pytest.approx(1e-4, rel=0.15)
    assert {parameter.unit for parameter in finding.parameters} == {"m"}
    assert finding.harmonics == ()
    period = float(str(finding.statement).split()[1])
    assert period == pytest.approx(2e3 * np.pi / order, rel=0.02)


def test_a_slide_that_scatters_has_no_period() -> None:
    nominal = dataclasses.replace(arm("stanford").robot, effects=())
    exact = simulate(nominal, Plan(120, seed=2, noise_position=2e-5, orientation=False)).data
    q = exact.q.copy()
    q[2] += 6e-5 * np.random.default_rng(3).standard_normal(120)
    position = predict(nominal, dataclasses.replace(exact, q=q)).translation
    noise = 2e-5 * np.random.default_rng(5).standard_normal(position.shape)
    data = dataclasses.replace(exact, position=position + noise)
    assert robacc.trace(data, robot=nominal, declared=DECLARED, folds=3).findings == ()
