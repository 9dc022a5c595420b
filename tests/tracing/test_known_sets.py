"""What a search knows before it chooses: sets tried earlier, and that a robot file's masses are mostly right."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
from arms import arm

from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.joint_compliance import JointCompliance
from robacc.effects.periodic import of_order
from robacc.measurements import Measurements
from robacc.tracing.candidates import Candidate, named_candidates
from robacc.tracing.ranking import Chosen
from robacc.tracing.selection import Selection

SPRING = JointCompliance(("j2",))
NONE = np.zeros(0)


def selection(chosen: tuple[Effect, ...], known: tuple[Effect, ...]) -> Selection:
    findings = [Chosen(Candidate(effect, (), 0.0), NONE.astype(np.int64), NONE) for effect in chosen]
    return Selection(cast(Any, None), findings, known=known)


@pytest.mark.parametrize(
    ("chosen", "is_known"),
    [
        ((SPRING, of_order("j1", 2.0)), True),
        ((of_order("j1", 2.0), SPRING), True),
        ((SPRING,), False),
        ((SPRING, of_order("j3", 2.0)), False),
        ((SPRING, of_order("j1", 2.0), of_order("j3", 1.0)), False),
    ],
)
def test_a_set_is_known_if_an_earlier_selection_came_to_it(chosen: tuple[Effect, ...], is_known: bool) -> None:
    assert selection(chosen, (SPRING, of_order("j1", 2.0))).is_known() is is_known


def test_masses_of_the_robot_file_are_150_times_as_likely_as_wrong_ones() -> None:
    tested, rng = arm("panda"), np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (len(tested.names), 30))
    pool, _ = named_candidates(tested, Measurements(q=q, position=np.zeros((3, 30))), (), [JointCompliance.name])
    priors = {str(c.effect.settings().get("masses", "known")): c.log_prior for c in pool}
    assert priors["known"] - priors["uncertain"] == pytest.approx(math.log(150.0))
    assert (
        REGISTRY[JointCompliance.name].default(tested, Measurements(q=q, position=np.zeros((3, 30)))).prior_odds == 1.0
    )
