"""A change of the load is searched where poses before it show that the load was not there all the time."""

from __future__ import annotations

import dataclasses

import numpy as np
from arms import arm

from robacc.effects.change_points import changes_load
from robacc.effects.request import build, parse_requests
from robacc.fitting.solver import fit
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.candidate_pool import CandidatePools
from robacc.tracing.linearised_candidates import linearise
from robacc.tracing.step_scans import late_places


def test_a_quarter_of_the_visits_lies_before_a_late_place() -> None:
    # Place 0 has one visit before it.
    assert np.flatnonzero(late_places(39)).tolist() == list(range(9, 39))


def test_only_changes_of_the_load_have_to_be_late() -> None:
    robot = dataclasses.replace(arm("panda").robot, effects=())
    plan = Plan(80, seed=1, noise_position=2e-5, orientation=False, time_step=30.0)
    data = simulate(robot, plan).data
    start = Model.of(robot)
    free = build(parse_requests("base_frame,tool_frame,joint_offset"), start.arm, data)
    fitted = fit(Model(start.arm, start.known, free), data)
    scans = linearise(fitted, CandidatePools(data, None).of(start.arm, free)).step_scans
    first = {changes_load(scan.form): int(scan.eligible[0]) for scan in scans}
    assert first[True] >= 19
    assert first[False] < 10
