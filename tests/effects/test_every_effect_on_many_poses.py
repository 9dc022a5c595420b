"""Every effect on thousands of poses: several blocks, targets, folds, both deflection forms; slow."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm, circumstances

from robacc import calibrate
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.elastic import Elastic
from robacc.effects.specification import entry_of
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.arm import Arm

ELASTIC = tuple(name for name, cls in REGISTRY.items() if issubclass(cls, Elastic))


def arm_for(name: str) -> Arm:
    """The arm with two targets, or one with a slide where the effect needs it."""
    stem = "puma560" if REGISTRY[name].possible_joints(arm("targets:puma560")) else "stanford"
    return arm(f"targets:{stem}")


def effect_of(name: str, one: Arm, data: Measurements, deflection: str) -> Effect:
    cls = REGISTRY[name]
    joints = tuple(joint for joint in ("j2", "j3") if joint in cls.possible_joints(one))
    effect = cls.default(one, data, joints if cls.traits.per_joint else None)
    return dataclasses.replace(effect, deflection=deflection) if isinstance(effect, Elastic) else effect


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "n", "deflection"),
    [
        *((name, n, "equilibrium") for name in REGISTRY for n in (5000, 20000)),
        *((name, 5000, "rigid") for name in ELASTIC),
    ],
)
def test_every_effect_on_many_poses(name: str, n: int, deflection: str) -> None:
    """Fit the effect alone, with base and tool, to poses of an arm that has it; nothing fails and errors decrease."""
    one = arm_for(name)
    robot, data = one.robot, circumstances(one.robot, n, 3)
    effect = effect_of(name, one, data, deflection)
    terms = effect.terms(one, data)
    true = dataclasses.replace(robot, effects=(entry_of(effect, {term.name: term.typical for term in terms}),))
    exact = predict(true, data)
    noise = np.random.default_rng(n).normal(0, 2e-5, (3, n))
    data = dataclasses.replace(data, position=exact.translation + noise, rotation=exact.rotation)
    joints = f"[{','.join(effect.joints)}]" if REGISTRY[name].traits.per_joint else ""
    result = calibrate(data, robot=robot, fit=f"{name}{joints}", folds=2)
    assert result.after.fitted.position.rms < 2e-4
    assert result.document()["parameters"]
