#!/usr/bin/env python3
"""Which cause does a trace name for each effect: the right one, the right one among the alternatives, or a wrong one?

Each set is a random arm (`real_arm.py`) whose geometry is a few tenths of a millimetre wrong, with one effect of the
catalogue at --times the size that an ideal test of this effect alone finds with probability 1/2. The ideal test knows
the noise, and has the level of one candidate among 80 in a trace. `robacc trace` has frames, joint offsets and link
geometry declared and columns for every circumstance. An answer is

right      a finding has the effect and its joint
alternative  a finding of another name has them among its alternatives, or the effect in its statement
missed     no finding at all
wrong      neither; `explained` says whether the verdict is that

A set's name is EFFECT-ARM-FORM-sSEED; everything else is drawn by the name.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import tool
from corrected_arms import circumstances, write_csv
from real_arm import (
    DRAWN,
    EFFECTS,
    KINDS,
    TEMPLATES,
    Pose,
    RealArm,
    Truth,
    measured,
    random_arm,
    random_truth,
    torques,
    write_robot,
)
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

LEVEL = 0.002 / 80
EXTRA = ("counterbalance", "compliance_variation", "joint_warmup", "step_joint", "step_target", "tracker_error")
"""Effects that this module adds to those of `real_arm.py`."""
NO_CAUSE = "joint_correction"
"""An empirical correction: a trace calls such a profile a wave, or a correction."""
TERMS = {
    "transmission_error": 4, "axis_wobble": 8, "frame_drift": 3, "step": 3, "counterbalance": 2,
    "compliance_variation": 2, "step_target": 3,
}  # fmt: skip
"""Coefficients of an effect in the ideal test, where they are more than one."""
BESIDE = {"counterbalance": "joint_compliance", "compliance_variation": "joint_compliance"}
"""Effect that the arm has besides on the same joint: nobody balances a joint that does not give way."""
LEAST_NEW = 0.02
"""Share of the effect's displacement that geometry must leave, or another arm is drawn: little of a gear's error of
an outer joint differs from errors of geometry."""
ANSWERS = ("right", "alternative", "missed", "wrong")


class ConfusionStudy:
    """One set: the arm, its effect at the wanted size, and its measurements."""

    def __init__(self, name: str, poses: int, times: float) -> None:
        self.kind, template, form, _ = name.split("-")
        self.rng = rng = tool.generator(name)
        self.noise = float(rng.choice([2e-5, 5e-5]))
        for _ in range(50):
            self.arm: RealArm = random_arm(template, form, rng)
            truth = drawn_truth(self.arm, self.kind, rng)
            self.q = rng.uniform(*self.arm.limits.T, (poses, len(self.arm.joints)))
            self.pose: Pose = circumstances(self.q, rng, ordered=False)
            share, length = self._visible(truth)
            if share > LEAST_NEW:
                break
        else:
            raise ValueError(f"{name}: geometry stands for the effect on 50 arms")
        terms = TERMS.get(self.kind, 1)
        needed = brentq(lambda x: ncx2.sf(chi2.isf(LEVEL, terms), terms, x) - 0.5, 1e-3, 1e3)
        self.factor = times * math.sqrt(needed) * self.noise / length
        self.truth = scaled(truth, self.kind, self.factor)

    def _visible(self, truth: Truth) -> tuple[float, float]:
        """Return the share of the effect's displacement that frames and geometry cannot stand for, and its length."""
        without = dataclasses.replace(truth, effects={k: v for k, v in truth.effects.items() if k != self.kind})
        start = self._measured(without).ravel()
        moved = self._measured(truth).ravel() - start
        columns = []
        for name, size in (("base", 6), ("tool", 3), ("rows", truth.rows.size)):
            if name == "rows" and self.kind == "instrument_scale":
                continue
            for i in range(size):
                value = getattr(without, name).copy()
                value.ravel()[i] += 1e-6
                other = dataclasses.replace(without, **{name: value})
                columns.append((self._measured(other).ravel() - start) / 1e-6)
        if self.kind in BESIDE:
            loaded = {BESIDE[self.kind]: {**truth.effects[BESIDE[self.kind]]}}
            softer = scaled(dataclasses.replace(without, effects=loaded), BESIDE[self.kind], 1.01)
            columns.append(100.0 * (self._measured(softer).ravel() - start))
        u, s, _ = np.linalg.svd(np.array(columns).T, full_matrices=False)
        basis = u[:, s > 1e-9 * s[0]]
        left = moved - basis @ (basis.T @ moved)
        return float(np.linalg.norm(left) / np.linalg.norm(moved)), float(np.linalg.norm(left))

    def _measured(self, truth: Truth) -> np.ndarray:
        """Return the measured positions (N, 3) without noise."""
        effect: Mapping[str, Any] | None = truth.effects.get(self.kind)
        if self.kind not in EXTRA or effect is None:
            return measured(self.arm, truth, self.q, self.pose)[0]
        plain = dataclasses.replace(truth, effects={k: v for k, v in truth.effects.items() if k != self.kind})
        if self.kind == "tracker_error":
            place = measured(self.arm, plain, self.q, self.pose)[0]
            beam = place - effect["station"]
            return place + effect["size"] * beam / np.linalg.norm(beam, axis=1)[:, None]
        after = self.pose.time >= np.median(self.pose.time)
        if self.kind == "step_target":
            place, turned = measured(self.arm, plain, self.q, self.pose)
            return place + after[:, None] * (turned @ effect["size"])
        q, j = self.q.copy(), int(effect["joint"])
        angle = q[:, j] - effect.get("phase", 0.0)
        if self.kind == "counterbalance":
            change = np.sin(angle) * (1.0 - 0.75 / np.sqrt(1.0 + 0.7 * np.cos(angle)))
        elif self.kind == "compliance_variation":
            change = torques(self.arm, self.q)[:, j] * np.cos(2.0 * angle)
        elif self.kind == "joint_warmup":
            change = 1.0 - np.exp(-self.pose.time / (0.2 * np.ptp(self.pose.time)))
        else:
            change = after.astype(float)
        q[:, j] += effect["size"] * change
        return measured(self.arm, plain, q, self.pose)[0]

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of the measured poses."""
        place = self._measured(self.truth)
        place = place + self.noise * self.rng.standard_normal(place.shape)
        columns = {f"q{i + 1}": row for i, row in enumerate(self.q.T)} | dict(zip("xyz", place.T, strict=True))
        columns |= {f"speed_q{i + 1}": row for i, row in enumerate(self.pose.speed.T)}
        columns |= {f"dir_q{i + 1}": row for i, row in enumerate(self.pose.direction.T)}
        circumstances_ = {"time_s": self.pose.time, "temperature_c": self.pose.temperature}
        return columns | circumstances_ | {"payload_kg": self.pose.payload}

    @property
    def joint(self) -> str | None:
        """Name of the effect's joint."""
        place = self.truth.effects[self.kind].get("joint")
        return None if place is None else self.arm.names[int(place)]  # type: ignore[call-overload]


def drawn_truth(arm: RealArm, kind: str, rng: np.random.Generator) -> Truth:
    """Draw a real arm with one effect, and what it needs besides."""
    if kind not in EXTRA:
        return random_truth(arm, [kind], rng)
    truth = random_truth(arm, [BESIDE[kind]] if kind in BESIDE else [], rng)
    effect: dict[str, object] = {"size": 1e-4}
    if kind == "step_target":
        effect["size"] = 1e-4 * rng.standard_normal(3)
    elif kind == "tracker_error":
        effect["station"] = np.append(rng.uniform(2.5, 4.0) * np.array([1.0, rng.uniform(-1, 1)]), rng.uniform(0, 1.5))
    else:
        beside = truth.effects[BESIDE[kind]] if kind in BESIDE else DRAWN["backlash"](arm, rng)
        effect |= {"joint": beside["joint"], "phase": float(rng.uniform(-math.pi, math.pi))}
        if kind == "compliance_variation":
            effect["size"] = 0.1 * float(beside["size"])  # type: ignore[arg-type]
    return dataclasses.replace(truth, effects={**truth.effects, kind: effect})


def scaled(truth: Truth, kind: str, factor: float) -> Truth:
    """Return the truth with the effect's size times ``factor``."""
    effect: Mapping[str, Any] = truth.effects[kind]
    changed = {**effect, "size": np.asarray(effect["size"]) * factor}
    return dataclasses.replace(truth, effects={**truth.effects, kind: changed})


def run_set(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, trace and judge one set."""
    study = ConfusionStudy(name, options.poses, options.times)
    declared = "base_frame,tool_frame,joint_offset"
    declared += "" if study.kind == "instrument_scale" else ",link_geometry"
    with tool.folder_of(name, options) as folder:
        robot = write_robot(study.arm, folder)
        write_csv(folder / "poses.csv", study.columns())
        words = [*tool.command(options), "trace", str(folder / "poses.csv"), "--robot", str(robot)]
        answer = tool.run([*words, "--declared", declared], options.limit)
    row: dict[str, Any] = {"name": name, "effect": study.kind, "seconds": answer.seconds}
    if answer.result is None:
        return {**row, "error": answer.error}
    return {**row, "joint": study.joint, "factor": study.factor, **judged(study.kind, study.joint, answer.result)}


def judged(kind: str, joint: str | None, result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer, the names, and the verdict of a trace."""

    def is_true(named: Mapping[str, Any]) -> bool:
        effect = named["effect"]
        if effect == "step" and kind != "step":
            effect += "_" + named["settings"].get("part", "joint" if named["joints"] else "base")
        return bool(effect == kind and (joint is None or joint in named["joints"]))

    findings = [f for f in result["findings"] if f["effect"] != BESIDE.get(kind) or "masses" in f["settings"]]
    right = any(map(is_true, findings))
    alternative = any(
        is_true(other) or kind.replace("_", " ") in (finding["statement"] or "")
        for finding in findings
        for other in finding["alternatives"] or [finding]
    )
    answer = ANSWERS[0 if right else 1 if alternative else 3 if findings else 2]
    names = [f"{f['effect']}[{','.join(f['joints'])}]" for f in findings if not is_true(f)]
    explained = result["verdict"] == "explained"
    return {"answer": answer, "others": names, "explained": explained, "verdict": result["verdict"]}


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Print the answers by effect, and what is confused with what."""
    header = ("effect", "sets", *ANSWERS, "wrong and explained", "named instead or besides")
    lines = []
    for kind in dict.fromkeys(row["effect"] for row in rows):
        group = [row for row in rows if row["effect"] == kind]
        answers = Counter(row["answer"] for row in group)
        names = Counter(name.split("[")[0] for row in group for name in row["others"])
        explained = sum(row["answer"] == "wrong" and row["explained"] for row in group)
        instead = ", ".join(f"{count} {name}" for name, count in names.most_common())
        lines.append([kind, len(group), *(answers[answer] for answer in ANSWERS), explained, instead or "-"])
    print(tool.table(header, lines))
    answers = Counter(row["answer"] for row in rows)
    named = answers["right"] + answers["alternative"]
    low, high = tool.wilson(named, len(rows))
    wrong = sum(row["answer"] == "wrong" and row["explained"] for row in rows)
    claims = [
        f"{named} of {len(rows)} named, {answers['right']} of them first ({tool.percent(low)} to {tool.percent(high)})",
        tool.claim(f"{wrong} wrong names are called explained", *tool.wilson(wrong, len(rows)), (0.0, 0.05)),
    ]
    print("\n".join(claims))
    return {"claims": claims}


def main() -> int:
    """Run the sets and print the matrix."""
    parser = tool.arguments(__doc__, seeds=2)
    parser.add_argument("--times", type=float, default=4.0, help="size over the ideal one (default: %(default)s)")
    parser.add_argument("--poses", type=int, default=100)
    options = parser.parse_args()
    # Each effect has each seed's arm once; the arms of one effect go round the templates and forms.
    names = [
        f"{kind}-{TEMPLATES[(s + k) % len(TEMPLATES)]}-{KINDS[(s + k) // 2 % len(KINDS)]}-s{s}"
        for s in tool.seeds_of(options)
        for k, kind in enumerate((*EFFECTS, *EXTRA))
        if kind != NO_CAUSE
    ]
    return tool.run_all(names, options, run_set, summary)


if __name__ == "__main__":
    sys.exit(main())
