"""An effect that is added needs its own file and one import: nothing else knows its name."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from arms import arm, circumstances

import robacc
from robacc.diagnostics.partial_residuals import partial_residuals
from robacc.effects import REGISTRY
from robacc.effects.base import About, Effect, Need, Over, Term, Traits, driven_by, register, varies
from robacc.effects.request import catalogue
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.tracing.trace import trace


@pytest.fixture
def toy() -> Iterator[type[Effect]]:
    """Register an effect for one test: a joint's zero that follows the payload."""
    before = dict(REGISTRY)

    @register
    @dataclass(frozen=True)
    class PayloadZero(Effect):
        """Joint variable plus a coefficient times the payload."""

        name = "payload_zero"
        traits = Traits(
            needs=(Need("no payload_kg column that varies", lambda arm, data: varies(data.payload)),),
            drivers=("payload_kg",),
            chart=Over("payload_kg"),
            extrapolates="the zero follows any payload",
        )
        about = About(
            summary="a joint's zero that follows the payload",
            equation="theta_j + c m",
            unit="rad/kg",
            usual_size="1e-5 to 1e-3 rad/kg",
            usual_range=(1e-5, 1e-3),
            needs="payload_kg",
            confused_with="payload_compliance",
            source="this test",
            example="{effect: payload_zero, joints: [j1], values: {j1: 1e-4}}",
        )

        def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
            payload = driven_by(arm, data, "payload_kg", self.name)
            return tuple(self.joint_term(arm, joint, payload, unit="rad/kg") for joint in self.joints)

    yield PayloadZero
    REGISTRY.clear()
    REGISTRY.update(before)


def test_it_is_listed_read_simulated_fitted_traced_and_drawn(toy: type[Effect]) -> None:
    robot = arm("puma560").robot
    assert [entry.effect.name for entry in catalogue("payload_zero", robot)] == ["payload_zero"]
    truth = dataclasses.replace(robot, effects=({"effect": "payload_zero", "joints": ["j1"], "values": {"j1": 3e-4}},))
    data = circumstances(robot, 80)
    rng = np.random.default_rng(3)
    payload = rng.choice([0.0, 2.0, 5.0], 80)
    data = dataclasses.replace(data, payload=payload, rotation=None)
    measured = predict(truth, data).translation + rng.normal(scale=2e-5, size=(3, 80))
    data = dataclasses.replace(data, position=measured)
    model = Model(arm("puma560"))
    effect = toy(joints=("j1",))
    found = fit(dataclasses.replace(model, free=(effect,)), data, Options())
    assert found.theta[0] == pytest.approx(3e-4, rel=0.05)
    (curve,) = partial_residuals(effect, found, data)
    assert (curve.driver, curve.driver_unit) == ("payload_kg", "kg")
    result = trace(model, data, n_folds=3)
    assert [(finding.effect, finding.joints) for finding in result.findings] == [("payload_zero", ("j1",))]


def test_nothing_outside_the_effects_names_one() -> None:
    """Modules that judge effects ask them; only what registers frames or geometry knows those by name."""
    folder = Path(robacc.__file__).parent
    classes = re.compile(
        r"from robacc\.effects\.(?!base|campaign|correction|driver|elastic|periodic|request|specification)"
    )
    offenders = [
        str(path.relative_to(folder))
        for package in ("tracing", "accuracy", "api", "calibration", "comparison", "documents", "gates", "render")
        for path in ([folder / package] if package.endswith(".py") else sorted((folder / package).rglob("*.py")))
        if classes.search(path.read_text(encoding="utf-8"))
    ]
    assert offenders == []
