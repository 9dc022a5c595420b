#!/usr/bin/env python3
"""Do 95 % intervals hold the truth where errors are awkward, and how good is the model elsewhere?

Each study is a design and a way to draw a set. The tool fits the declared coefficients; its intervals should hold the
truth.

waves    POSES-RATIO-ARM-NOISE_UM-sSEED: zeros and lengths 0.3 mrad and 0.3 mm wrong; the target is off by six waves of
         single joints' angles, half to two periods over the range, RATIO times the noise, which the model lacks
awkward  KIND-ARM-NOISE_UM-sSEED: as `waves` with errors that break an assumption, and no effect of the catalogue. The
         tool traces; findings are worse if fresh poses have a larger error with them than with `robacc calibrate`:

gauss        independent and normal, to compare
heavy        Student's t with 2.5 degrees of freedom
range        a tracker: transverse noise grows with the square of the distance
path         rows on a path through the joints' ranges, noise that wanders with it (correlation 0.9 from row to row)
depth        noise four times as large along z of the measuring frame
instruments  two instruments, each for half of the first joint's range; one has eight times the other's noise
camera       six times the noise where the tool turns away from the camera
warming      the first ten rows or so are off, in a direction of their own
stick        one joint scatters by 0.3 mrad in the upper half of its range
tails        all joints scatter with Student's t, 2 degrees of freedom, 0.02 mrad
rounded      joints logged to 0.1 mrad
tiny         all poses within 0.12 rad
encoder      25 poses visited four times, joints as read, no pose column; each pose has an error of the joints
clusters     ten groups of eight poses, with an error of the joints common to each group

`path` and `warming` wander in time: drifts and steps are not false there.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import tool
from arm import ARMS, SIX_JOINTS, Setup, write_poses, write_robot

EFFECTS = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
WANDERS = ("frame_drift", "step", "instrument_scale")
"""Effects that describe errors that wander."""
POSES, FRESH = 60, 200
Rows = list[dict[str, Any]]


@dataclass
class Campaign:
    """Joints as logged and as they were, errors of the instrument (N, 3), further columns, and fresh joints."""

    setup: Setup
    noise: float
    truth: np.ndarray
    q: np.ndarray
    arrived: np.ndarray
    error: np.ndarray
    columns: dict[str, Any] = field(default_factory=dict)
    fresh: np.ndarray | None = None


def plain(setup: Setup, um: str, rng: np.random.Generator, q: np.ndarray | None = None) -> Campaign:
    """Return poses with independent normal noise, directions and times."""
    truth, noise = setup.erring(rng, 3e-4), 1e-6 * float(um)
    q = rng.uniform(*setup.span.T, (POSES, setup.n)) if q is None else q
    direction = rng.choice((-1, 1), q.shape)
    columns = {"time_s": 30 * np.arange(len(q))} | {f"dir_q{j + 1}": row for j, row in enumerate(direction.T)}
    return Campaign(setup, noise, truth, q, q.copy(), noise * rng.standard_normal((len(q), 3)), columns)


def waves(name: str, rng: np.random.Generator) -> Campaign:
    count, ratio, arm, um, _ = name.split("-")
    setup, number = Setup(ARMS[arm]), 6
    out = plain(setup, um, rng, rng.uniform(*setup.span.T, (int(count), setup.n)))
    for _ in range(number):
        joint = rng.integers(setup.n)
        angle = 2 * np.pi * (rng.uniform(0.5, 2) * out.q[:, joint] / np.ptp(setup.span[joint]) + rng.uniform())
        size = float(ratio) * out.noise * np.sqrt(2 / number)
        out.error += size * np.cos(angle)[:, None] * rng.standard_normal(3)
    out.columns = {}
    return out


def awkward(name: str, rng: np.random.Generator) -> Campaign:
    kind, arm, um, _ = name.split("-")
    setup = Setup(ARMS[arm])
    out = SPECIAL[kind](setup, um, rng) if kind in SPECIAL else plain(setup, um, rng)
    if kind in CHANGES:
        CHANGES[kind](out, rng)
    out.fresh = rng.uniform(out.q.min(axis=0), out.q.max(axis=0), (FRESH, setup.n))
    return out


def on_a_path(setup: Setup, um: str, rng: np.random.Generator) -> Campaign:
    """Each pose is the nearest to the last one that is left."""
    q = list(rng.uniform(*setup.span.T, (POSES, setup.n)))
    path = [q.pop()]
    while q:
        path.append(q.pop(int(np.argmin([np.abs(other - path[-1]).max() for other in q]))))
    out = plain(setup, um, rng, np.array(path))
    out.error *= 0.5
    wander = rng.standard_normal(3)
    for error in out.error:
        error += 2 * out.noise * wander
        wander = 0.9 * wander + np.sqrt(1 - 0.81) * rng.standard_normal(3)
    return out


def within(setup: Setup, um: str, rng: np.random.Generator) -> Campaign:
    middle = rng.uniform(*(setup.span + np.array([0.3, -0.3])).T, setup.n)
    return plain(setup, um, rng, middle + rng.uniform(-0.12, 0.12, (POSES, setup.n)))


def grouped(count: int, size: int, extent: float) -> Callable[[Setup, str, np.random.Generator], Campaign]:
    """Groups of poses, with an error of the joints common to each group."""

    def draw(setup: Setup, um: str, rng: np.random.Generator) -> Campaign:
        centres = np.repeat(rng.uniform(*setup.span.T, (count, setup.n)), size, axis=0)
        error = np.repeat(5e-5 * rng.standard_normal((count, setup.n)), size, axis=0)
        out = plain(setup, um, rng, centres + rng.normal(0, extent, centres.shape))
        out.arrived = out.q + error
        return out

    return draw


SPECIAL = {"path": on_a_path, "tiny": within, "encoder": grouped(25, 4, 2e-5), "clusters": grouped(10, 8, 0.03)}


def heavy(out: Campaign, rng: np.random.Generator) -> None:
    out.error = out.noise * rng.standard_t(2.5, out.error.shape)


def ranged(out: Campaign, rng: np.random.Generator) -> None:
    sight = out.setup.positions(out.truth, out.arrived) - [2.5, 1.0, 0.5]
    distance = np.linalg.norm(sight, axis=1)[:, None]
    along = np.sum(out.error * sight, axis=1)[:, None] * sight / distance**2
    out.error = 3 * (distance / 2) ** 2 * (out.error - along) + 0.5 * along


def instruments(out: Campaign, rng: np.random.Generator) -> None:
    out.error *= np.where(out.q[:, 0] > np.median(out.q[:, 0]), 8, 1)[:, None]


def depth(out: Campaign, rng: np.random.Generator) -> None:
    out.error[:, 2] *= 4


def camera(out: Campaign, rng: np.random.Generator) -> None:
    towards = out.setup.frames(out.truth, out.q)[-1][:, 2, 2]
    out.error *= np.where(towards > 0.3, 6, 1)[:, None]


def warming(out: Campaign, rng: np.random.Generator) -> None:
    out.error += (8 * out.noise * np.exp(-np.arange(POSES) / 8))[:, None] * rng.standard_normal(3)


def stick(out: Campaign, rng: np.random.Generator) -> None:
    upper = out.q[:, 2] > out.q[:, 2].mean()
    out.arrived[:, 2] += np.where(upper, 3e-4, 0) * rng.standard_normal(POSES)


def tails(out: Campaign, rng: np.random.Generator) -> None:
    out.arrived += 2e-5 * rng.standard_t(2, out.q.shape)


def rounded(out: Campaign, rng: np.random.Generator) -> None:
    out.q = np.round(out.q, 4)


CHANGES: dict[str, Callable[[Campaign, np.random.Generator], None]] = {
    change.__name__: change for change in (heavy, instruments, depth, camera, warming, stick, tails, rounded)
} | {"range": ranged}
KINDS = ("gauss", *CHANGES, *SPECIAL)


def run_set(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, run and judge one set."""
    study = STUDIES[options.study]
    out = study.draw(name, tool.generator(name))
    setup, mask = out.setup, out.setup.declared(EFFECTS)
    true, errors = setup.positions(out.truth, out.arrived), {}
    with tool.folder_of(name, options) as folder:
        write_robot(setup.arm, folder / "robot.yaml")
        write_poses(folder / "poses.csv", out.q, true + out.error, out.columns)
        if out.fresh is not None:
            there = setup.positions(out.truth, out.fresh)
            middle = {key: np.full(FRESH, 15 * len(out.q) if key == "time_s" else 1) for key in out.columns}
            write_poses(folder / "test.csv", out.fresh, there, middle)
        answer, test = tool.fit_and_test((*study.asked, ",".join(EFFECTS)), folder, options)
        result = answer.result
        if result is None or (test is not None and test.result is None):
            return {"name": name, "error": f"status {answer.status}: {answer.error[-200:]}; {test and test.error}"}
        if result.get("findings"):
            _, without = tool.fit_and_test(("calibrate", "--fit", ",".join(EFFECTS)), folder, options)
            errors["declared"] = without.result["position"]["rms_m"] if without and without.result else math.inf
    rows = tool.intervals(setup, result, out.q, out.truth, mask, tolerance=0.05 * out.noise)
    return {
        "name": name,
        "seconds": answer.seconds,
        "covered": tool.covered(rows),
        "mm": {key: 1e3 * error for key, error in errors.items()},
        "test_mm": test and 1e3 * test.result["position"]["rms_m"],
        "verdict": result.get("verdict", "-"),
        "findings": [[f["effect"], f.get("joints"), f["p_value"]] for f in result.get("findings") or []],
        "told": any("a trace searches" in text for text in result["warnings"]),
    }


def is_wrong(row: dict[str, Any]) -> bool:
    """Whether a set has a finding that is none of errors that wander."""
    wanders = row["name"].split("-")[0] in ("path", "warming")
    return any(not (wanders and effect in WANDERS) for effect, _, _ in row["findings"])


def ratios(rows: Rows, reference: str) -> list[float]:
    """Return the error at fresh poses over that of another fit."""
    return [row["test_mm"] / row["mm"][reference] for row in rows if reference in row["mm"]]


def line(label: str, rows: Rows) -> list[str]:
    """Return one line of the table."""
    share = tool.percent(tool.coverage([row["covered"] for row in rows])[0])
    size = "-" if rows[0]["test_mm"] is None else f"{tool.pooled([row['test_mm'] for row in rows]):.3g}"
    against = ratios(rows, "declared")
    ratio = f"{tool.mean_ratio(against)[0]:.2f} / {max(against):.2f}" if against else "-"
    verdicts = tool.groups(rows, lambda row: row["verdict"])
    counts = (sum(map(is_wrong, rows)), sum(x > 1 for x in ratios(rows, "declared")), sum(row["told"] for row in rows))
    return [
        label, str(len(rows)), share, size, ratio, *map(str, counts),
        ", ".join(f"{verdict} {len(some)}" for verdict, some in sorted(verdicts.items())),
        f"{tool.median([row['seconds'] for row in rows]):.1f}",
    ]  # fmt: skip


HEADER = ("", "sets", "hold", "mm", "ratio / worst", "false", "worse", "told",
          "verdicts", "s")  # fmt: skip
LEGEND = """hold: share of 95 % intervals with the truth; mm: rms at fresh poses, pooled; ratio: with the findings over
without them; false: sets with a finding other than errors that wander; worse: fresh poses have a larger error with
the findings; told: sets whose result says that remaining errors follow joints"""


def summary(rows: Rows, study: Study) -> dict[str, Any]:
    """Print the table and the claims."""
    lines = [line("all sets", rows)]
    for part in study.parts:
        members = tool.groups(rows, lambda row, part=part: "-".join(row["name"].split("-")[part]))
        lines += [line(label, some) for label, some in members.items()]
    print(tool.table(HEADER, lines), LEGEND, sep="\n")
    claims = study.claims(rows)
    print("\n".join(claims))
    return {"table": [HEADER, *lines], "claims": claims}


def coverage_claim(rows: Rows, key: str, least: int, label: str = "") -> str:
    share, low, high, n = tool.coverage([row[key] for row in rows])
    words = f"{label}coverage {least}-98 %: {tool.percent(share)} of {n} intervals"
    return tool.claim(words, low, high, (least / 100, 0.98))


def wave_claims(rows: Rows) -> list[str]:
    groups = tool.groups(rows, lambda row: "-".join(row["name"].split("-")[:2]))
    many = {label: some for label, some in groups.items() if int(label.split("-")[0]) >= 200}
    return [coverage_claim(some, "covered", 90, f"{label}: ") for label, some in many.items()]


def false_claims(rows: Rows) -> list[str]:
    hits, n = sum(map(is_wrong, rows)), len(rows)
    return [tool.claim(f"false findings at most 2 %: {hits} of {n}", *tool.wilson(hits, n), (0, 0.02))]


@dataclass(frozen=True)
class Study:
    """Design, draw, command and option of the effects, parts of a name that make groups, claims."""

    seeds: int
    names: Callable[[int], list[tuple[object, ...]]]
    draw: Callable[[str, np.random.Generator], Campaign]
    asked: tuple[str, ...]
    parts: tuple[slice, ...]
    claims: Callable[[Rows], list[str]]


def wave_names(seed: int) -> list[tuple[object, ...]]:
    return [(n, ratio, SIX_JOINTS[seed % 3], 20) for n in (60, 200, 500) for ratio in (0, 1, 3)]


def awkward_names(seed: int) -> list[tuple[object, ...]]:
    return [(kind, SIX_JOINTS[seed % 3], (10, 20, 50)[(seed + seed // 3) % 3]) for kind in KINDS]


STUDIES = {
    "waves": Study(9, wave_names, waves, ("calibrate", "--folds", "2", "--fit"), (slice(2),), wave_claims),
    "awkward": Study(6, awkward_names, awkward, ("trace", "--declared"), (slice(1),), false_claims),
}  # fmt: skip


def main() -> int:
    """Run the sets that are asked for."""
    parser = tool.arguments(__doc__, seeds=None)
    parser.add_argument("study", choices=STUDIES)
    options = parser.parse_args()
    study = STUDIES[options.study]
    options.seeds = options.seeds or study.seeds
    names = ["-".join(map(str, (*cell, f"s{s}"))) for s in tool.seeds_of(options) for cell in study.names(s)]
    return tool.run_all(names, options, run_set, lambda rows: summary(rows, study))


if __name__ == "__main__":
    sys.exit(main())
