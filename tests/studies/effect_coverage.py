"""Coverage, detection and false alarms of single effects, on arms simulated by tests/independent_arm.py.

    PYTHONPATH=.. python effect_coverage.py --coverage 20     # intervals of coefficients, and of predicted positions
    PYTHONPATH=.. python effect_coverage.py --clean 20        # searches on arms without an effect

Positions are predicted at 40 fresh poses, so that effects without coefficients of a true value count too: splines of a
rail, a spring's place that is searched. From which size on effects are named is the question of `confused_causes.py`
and `planned_detection.py`. A set is one draw of poses and noise; the unit of a share is the interval.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable

import numpy as np
from independent_arm import (
    TOOL,
    Run,
    measured,
    measured_on_a_rail,
    measured_with_loads,
    robot_on_a_rail,
    run,
    target,
    targets,
    torques,
)
from searched import ARM, error_at, fitted, found

from robacc.effects.campaign import ReadBack, Step
from robacc.effects.elastic import JointCompliance, PayloadCompliance
from robacc.effects.frames import RailErrors
from robacc.effects.periodic import ComplianceVariation, Counterbalance
from robacc.fitting.fit_result import Fit
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

NOISE = 1e-5
COMPLIANCE = 8e-7
FAR = np.array([0.3, -0.2, 0.45])
ON_A_RAIL = Arm.of(robot_on_a_rail())


def own(joints: Run, joint: int) -> np.ndarray:
    return np.array([torques(q)[joint] for q in joints.q.T])


@dataclasses.dataclass
class Case:
    """An effect: its data by number of poses, seed, noise and size; its form; true coefficients at size 1."""

    data: Callable[[int, int, float, float], Measurements]
    effects: Callable[[Measurements], tuple]
    truth: dict[str, float]
    arm: Arm = ARM
    n: int = 100


def counterbalance(n: int, seed: int, noise: float, size: float) -> Measurements:
    joints = run(n, seed)
    angle = joints.q[1]
    stretched = np.sin(angle - np.radians(70.0))
    spring = 2e-3 * stretched - 1.5e-3 * stretched / np.sqrt(1 + 0.7 * np.cos(angle - np.radians(70.0)))
    return measured(joints, joints.turned(1, COMPLIANCE * own(joints, 1) + size * spring), noise, seed)


def variation(n: int, seed: int, noise: float, size: float) -> Measurements:
    joints = run(n, seed)
    turn = COMPLIANCE * own(joints, 1) * (1.0 + size * 0.3 * np.cos(2 * joints.q[1] - 0.7))
    return measured(joints, joints.turned(1, turn), noise, seed)


def read_back(n: int, seed: int, noise: float, size: float) -> Measurements:
    joints = run(n, seed)
    stood = joints.q + size * 2e-4 * np.random.default_rng(seed).normal(size=joints.q.shape)
    return dataclasses.replace(measured(joints, targets(stood), noise, seed), read_back=stood)


def payload(n: int, seed: int, noise: float, size: float) -> Measurements:
    mass = np.random.default_rng(seed).choice([0.0, 20.0, 60.0], n)
    return dataclasses.replace(measured_with_loads(n, seed, noise, size * COMPLIANCE, mass, FAR), payload=mass)


def groups(n: int, seed: int, noise: float, size: float) -> Measurements:
    names = np.random.default_rng(seed).choice(["none", "gripper", "part"], n)
    mass = np.select([names == "gripper", names == "part"], [20.0, 60.0])
    return dataclasses.replace(measured_with_loads(n, seed, noise, size * COMPLIANCE, mass), payload_group=names)


def step(part: str) -> Callable[[int, int, float, float], Measurements]:
    def data(n: int, seed: int, noise: float, size: float) -> Measurements:
        joints, after = run(n, seed), np.arange(n) >= n // 2
        if noise == 0.0:
            after = np.ones(n, dtype=bool)  # fresh poses come after the step
        if part == "payload":
            result = measured_with_loads(n, seed, noise, size * COMPLIANCE, 30.0 * after)
            return result if noise else dataclasses.replace(result, rows=None)
        if part == "joint":
            position = joints.turned(2, size * 1e-4 * after)
        else:
            shift = size * 1e-4 * np.array([0.6, -0.6, 0.53])
            position = np.array(
                [target(q, TOOL + a * shift * (part == "target")) for q, a in zip(joints.q.T, after, strict=True)]
            ).T
            position = position + (part == "base") * after * shift[:, None]
        result = measured(joints, position, noise, seed)
        return result if noise else dataclasses.replace(result, rows=None)

    return data


def stepped(part: str) -> Callable[[Measurements], tuple]:
    joints = {"joint": ("j3",), "payload": ("j2",)}.get(part, ())
    return lambda data: (Step(joints, part, from_line=2 + data.n // 2, file="poses.csv"),)  # type: ignore[arg-type]


SHIFT = dict(zip("xyz", 1e-4 * np.array([0.6, -0.6, 0.53]), strict=True))
CASES = {
    "counterbalance": Case(
        counterbalance,
        lambda data: (JointCompliance(("j2",)), Counterbalance(("j2",), 70.0, 0.7)),
        {"counterbalance.j2.spring": 2e-3, "counterbalance.j2.length": -1.5e-3, "joint_compliance.j2": COMPLIANCE},
    ),
    "compliance_variation": Case(
        variation,
        lambda data: (JointCompliance(("j2",)), ComplianceVariation(("j2",), (2,))),
        {
            "compliance_variation.j2.cos2": 0.3 * COMPLIANCE * np.cos(0.7),
            "compliance_variation.j2.sin2": 0.3 * COMPLIANCE * np.sin(0.7),
        },
    ),
    "read_back": Case(read_back, lambda data: (ReadBack(),), {"read_back": 1.0}),
    "rail_errors": Case(measured_on_a_rail, lambda data: (RailErrors.default(ON_A_RAIL, data),), {}, ON_A_RAIL, 140),
    "payload_compliance com uncertain": Case(
        payload,
        lambda data: (PayloadCompliance(("j2",), "uncertain"),),
        {
            "payload_compliance.j2": COMPLIANCE,
            **{f"payload_compliance.j2.h{a}": COMPLIANCE * d for a, d in zip("xyz", FAR - TOOL, strict=True)},
        },
    ),
    "payload_compliance groups": Case(
        groups,
        lambda data: (PayloadCompliance(("j2",), groups=("gripper", "part")),),
        {"payload_compliance.j2.gripper": 20 * COMPLIANCE, "payload_compliance.j2.part": 60 * COMPLIANCE},
    ),
    "step joint": Case(step("joint"), stepped("joint"), {"step.j3": 1e-4}),
    "step base": Case(step("base"), stepped("base"), {f"step.{a}": v for a, v in SHIFT.items()}),
    "step target": Case(step("target"), stepped("target"), {f"step.{a}": v for a, v in SHIFT.items()}),
    "step payload": Case(step("payload"), stepped("payload"), {"step.j2": 30 * COMPLIANCE}),
}


def positions_held(result: Fit, fresh: Measurements) -> tuple[int, int, float]:
    """Coordinates at fresh poses within 1.96 standard deviations, their number, and the RMS error in um."""
    predicted, jacobian = result.model.bind(fresh).linearise(result.theta)
    covariance = np.nan_to_num(result.covariance)
    std = np.sqrt(np.einsum("mpn,pq,mqn->mn", jacobian[:3], covariance, jacobian[:3]))
    error = fresh.position - predicted.translation
    inside = np.abs(error) <= 1.96 * std
    return int(inside.sum()), inside.size, 1e6 * error_at(result, fresh)


def coverage(sets: int, only: str) -> None:
    for name, case in CASES.items():
        if only not in name:
            continue
        held = count = inside = size = 0
        errors = []
        for seed in range(sets):
            data, fresh = case.data(case.n, 500 + seed, NOISE, 1.0), case.data(40, 900 + seed, 0.0, 1.0)
            result = fitted(data, case.effects(data), case.arm)
            for label, value in case.truth.items():
                i = result.names.index(label)
                held += abs(result.theta[i] - value) <= 1.98 * np.sqrt(result.covariance[i, i])
                count += 1
            ok, n, rms = positions_held(result, fresh)
            inside, size = inside + ok, size + n
            errors.append(rms)
        share = f"{held} of {count} intervals" if count else "no coefficients"
        print(f"{name:34s} {share}, positions {inside / size:.3f}, rms {np.mean(errors):.1f} um", flush=True)


def clean(sets: int) -> None:
    for seed in range(sets):
        joints = run(90, 3000 + seed)
        data = measured(joints, targets(joints.q), NOISE, seed, timed=True, directed=True)
        rng = np.random.default_rng(seed)
        names = rng.choice(["none", "gripper", "part"], data.n)
        data = dataclasses.replace(data, read_back=joints.q + 2e-4 * rng.normal(size=joints.q.shape))
        data = dataclasses.replace(data, payload_group=names)
        if seed % 2:
            data = dataclasses.replace(data, payload=rng.choice([0.0, 20.0, 60.0], data.n), payload_group=None)
        print(f"clean {seed}", list(map(str, found(data))), end=" ")
        print(
            "rail",
            list(map(str, found(measured_on_a_rail(120, 4000 + seed, NOISE, 0.0), ON_A_RAIL))) if seed % 2 else "-",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coverage", type=int, default=0, metavar="SETS")
    parser.add_argument("--clean", type=int, default=0, metavar="SETS")
    parser.add_argument("--only", default="", metavar="NAME")
    options = parser.parse_args()
    coverage(options.coverage, options.only) if options.coverage else None
    clean(options.clean) if options.clean else None
    print(f"{time.process_time():.0f} s of processor time")


if __name__ == "__main__":
    main()
