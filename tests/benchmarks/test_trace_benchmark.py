"""What closing the loop costs: ``pytest tests/benchmarks -m slow -s`` prints times, and their ratio to one fit."""

from __future__ import annotations

import dataclasses
import time

import pytest
from arms import arm

from robacc.effects.request import build, parse_requests
from robacc.fitting.solver import fit
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.search import search
from robacc.tracing.trace import trace

pytestmark = pytest.mark.slow
DECLARED = "base_frame,tool_frame,joint_offset,link_geometry"


@pytest.mark.parametrize(("n", "wanted"), [(150, 3), (1500, 20)])
@pytest.mark.parametrize("orientation", [False, True], ids=["positions", "poses"])
def test_trace_beside_one_fit(n: int, wanted: float, orientation: bool, capsys: pytest.CaptureFixture[str]) -> None:
    one = arm("puma560")
    effects = (
        {"effect": "backlash", "joints": ["j2"], "values": {"j2": 2e-4}},
        {"effect": "gear_ratio", "joints": ["j3"], "values": {"j3": 4e-4}},
    )
    plan = Plan(
        n,
        seed=1,
        noise_position=2e-5,
        noise_orientation=5e-5,
        orientation=orientation,
        time_step=30.0,
        temperature=(20.0, 26.0),
        payloads=(0.0, 2.0),
    )
    data = simulate(dataclasses.replace(one.robot, effects=effects), plan).data
    model = Model.of(one.robot, build(parse_requests(DECLARED), one, data))
    taken = []
    for work in (lambda: fit(model, data), lambda: search(model, data), lambda: trace(model, data)):
        begin = time.perf_counter()
        result = work()
        taken.append(time.perf_counter() - begin)
    assert sorted(str(finding.effect) for finding in result.findings) == ["backlash", "gear_ratio"]
    single, loop, whole = taken
    kind = "poses" if orientation else "positions"
    with capsys.disabled():
        print(
            f"\n  {n} {kind}: trace with five folds {whole:.2f} s (wanted {wanted}), "
            f"the loop alone {loop:.2f} s, one fit of what is declared {single * 1e3:.0f} ms"
        )
