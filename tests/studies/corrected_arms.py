#!/usr/bin/env python3
"""Real arms driven to corrected targets: is the error what noise and model uncertainty allow, and does the bound hold.

Each set is a random arm (`arm.py`: 5, 6, 7 axes, slides, both table conventions, URDF) whose geometry is a few
tenths wrong, with three effects of the catalogue. `robacc calibrate` fits them to simulated measurements, `robacc
correct` computes the commands for fresh targets, and the simulator drives the real arm to them. Judged are

ratio      RMS error as measured there, over the root of noise and expected error (`after_rms_m`): at most 1.2
coverage   share of targets whose error lies within `after_bound95_m`: 93 to 97 %. Where the noise is known (columns of
           the file, or repeats that separate it from the scatter of the joints) the error is the true one. Else it is
           the measured one: no data tell the instrument's noise from the arm's own error, and the bound has both.

A set's name is its number, arm and form; everything else is drawn by the name.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import tool
from arm import (
    EFFECTS,
    KINDS,
    TEMPLATES,
    Pose,
    RealArm,
    Truth,
    measured,
    nominal,
    positions,
    random_arm,
    random_truth,
    read_csv,
    request,
    write_csv,
    write_robot,
)
from scipy.spatial.transform import Rotation

SETS, TARGETS = 100, 60
GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
NEEDS = {
    "backlash": "direction", "friction_windup": "direction", "approach_lag": "speed", "payload_compliance": "payload",
    "thermal_expansion": "temperature", "frame_drift": "time", "step": "time",
}  # fmt: skip


def all_names(options: argparse.Namespace) -> list[str]:
    """The whole design: every template in every form, three effects of a list that goes round."""
    numbers = range(SETS * options.first_seed, SETS * (options.first_seed + options.seeds))
    return [f"{k:03d}-{TEMPLATES[k % len(TEMPLATES)]}-{KINDS[k // len(TEMPLATES) % len(KINDS)]}" for k in numbers]


def effects_of(number: int) -> list[str]:
    """Three effects; drift and step are not put together, nor the instrument's scale with the growth of the links."""
    order = np.random.default_rng(18 + number // len(EFFECTS)).permutation(len(EFFECTS))
    chosen = [EFFECTS[order[(3 * number + i) % len(EFFECTS)]] for i in range(3)]
    for first, second in (("frame_drift", "step"), ("instrument_scale", "thermal_expansion")):
        if first in chosen and second in chosen:
            chosen.remove(second)
    return chosen


def circumstances(q: np.ndarray, rng: np.random.Generator, ordered: bool) -> Pose:
    """Circumstances of poses: approach at random, or from the order of the commands (none for the first)."""
    n, moves = len(q), np.diff(q, axis=0, prepend=q[:1])
    speed = moves / np.maximum(np.abs(moves).max(axis=1, keepdims=True), 1e-12)
    if not ordered:
        speed = rng.uniform(-1, 1, q.shape)
    return Pose(
        direction=np.sign(speed),
        speed=speed,
        time=np.linspace(0.0, 3600.0, n),
        temperature=rng.uniform(18.0, 28.0, n),
        payload=rng.choice([0.0, 2.0, 6.0], n),
    )


def columns_of(pose: Pose, effects: Sequence[str], measured_poses: bool) -> dict[str, np.ndarray]:
    """Columns of circumstances that the effects need; the approach to targets follows from their order."""
    needs = {NEEDS[effect] for effect in effects if effect in NEEDS}
    columns = {}
    if "temperature" in needs:
        columns["temperature_c"] = pose.temperature
    if "payload" in needs:
        columns["payload_kg"] = pose.payload
    if not measured_poses:
        return columns
    if "time" in needs:
        columns["time_s"] = pose.time
    for kind, label in (("direction", "dir"), ("speed", "speed")):
        if kind in needs:
            rows = pose.direction if kind == "direction" else pose.speed
            columns |= {f"{label}_q{i + 1}": row for i, row in enumerate(rows.T)}
    return columns


def numbers(columns: dict[str, list[str]], names: Sequence[str]) -> np.ndarray:
    """Return columns as (N, len(names))."""
    return np.array([[float(x) for x in columns[name]] for name in names]).T


def quaternions(turned: np.ndarray) -> np.ndarray:
    """Unit quaternions (4, N), w first."""
    return Rotation.from_matrix(turned).as_quat()[:, [3, 0, 1, 2]].T


class Study:
    """One set: the arm, its measurements, its targets, and where it really goes."""

    def __init__(self, name: str, noise: float | None) -> None:
        number, template, form = name.split("-")
        self.rng = rng = tool.generator(name)
        self.arm: RealArm = random_arm(template, form, rng)
        self.effects = effects_of(int(number))
        self.truth: Truth = random_truth(self.arm, self.effects, rng)
        self.noise = float(rng.choice([2e-5, 5e-5, 1e-4])) if noise is None else noise
        self.angle = 2.0 * self.noise
        self.known = str(rng.choice(["columns", "repeats", "unknown"]))
        self.full = bool(rng.integers(2))
        self.cycles = 3 if self.known == "repeats" else 1
        self.scatter = float(rng.choice([0.0, 1e-5])) if self.cycles > 1 and noise is None else 0.0
        self.count = int(rng.choice([60, 100, 160]))
        self.kind = str(rng.choice(["joints", "poses"]))

    def drawn(self, n: int, share: float) -> np.ndarray:
        """Joints over a share of their ranges."""
        low, high = self.arm.limits.T
        middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
        return middle + half * self.rng.uniform(-1, 1, (n, len(low)))

    def shaken(self, q: np.ndarray) -> np.ndarray:
        """Joints as they settle: commanded, and their own scatter."""
        return q + self.scatter * self.rng.standard_normal(q.shape)

    def measurements(self) -> dict[str, np.ndarray]:
        """Columns of the measured poses."""
        once = self.drawn(self.count // self.cycles, 1.0)
        q = np.tile(once, (self.cycles, 1))
        pose = circumstances(q, self.rng, ordered=False)
        if self.cycles > 1:  # repeats come from the same side, or they would not be repeats
            again = {key: np.tile(getattr(pose, key)[: len(once)], (self.cycles, 1)) for key in ("direction", "speed")}
            pose = Pose(**{**pose.__dict__, **again})
        place, turned = measured(self.arm, self.truth, self.shaken(q), pose)
        place = place + self.noise * self.rng.standard_normal(place.shape)
        columns = {f"q{i + 1}": row for i, row in enumerate(q.T)} | dict(zip("xyz", place.T, strict=True))
        if self.full:
            turned = Rotation.from_rotvec(self.angle * self.rng.standard_normal((len(q), 3))).as_matrix() @ turned
            columns |= dict(zip(("qw", "qx", "qy", "qz"), quaternions(turned), strict=True))
        if self.cycles > 1:
            columns |= {"pose": np.tile(np.arange(len(once)), self.cycles)}
            columns |= {"cycle": np.repeat(np.arange(self.cycles), len(once))}
        if self.known == "columns":
            columns |= {f"sigma_{axis}": np.full(len(q), self.noise) for axis in "xyz"}
            columns |= {"sigma_r": np.full(len(q), self.angle)} if self.full else {}
        return columns | columns_of(pose, self.effects, True)

    def targets(self) -> dict[str, np.ndarray]:
        """Columns of the targets: joints, or poses in the measuring frame with joints beside."""
        q = self.drawn(TARGETS, 0.85)
        self.target_pose = circumstances(q, self.rng, ordered=True)
        columns = {f"q{i + 1}": row for i, row in enumerate(q.T)}
        if self.kind == "poses":
            place, turned = nominal(self.arm, self.truth.base, self.arm.tool + self.truth.tool, q)
            columns |= dict(zip(("cmd_x", "cmd_y", "cmd_z"), place.T, strict=True))
            if len(self.arm.joints) >= 6:
                columns |= dict(zip(("cmd_qw", "cmd_qx", "cmd_qy", "cmd_qz"), quaternions(turned), strict=True))
        return columns | columns_of(self.target_pose, self.effects, False)

    def reached(self, q: np.ndarray) -> np.ndarray:
        """Positions (N, 3) that the real arm reaches at commands ``q`` in their order."""
        given, driven = self.target_pose, circumstances(q, self.rng, ordered=True)
        pose = Pose(driven.direction, driven.speed, given.time, given.temperature, given.payload)
        return positions(self.arm, self.truth, self.shaken(q), pose)[0]


def run_set(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, calibrate, correct, drive and judge one set."""
    study = Study(name, options.noise)
    row: dict[str, Any] = {"name": name, "effects": study.effects, "noise": study.noise, "known": study.known,
                           "full": study.full, "poses": study.count, "kind": study.kind,
                           "axes": len(study.arm.joints)}  # fmt: skip
    with tool.folder_of(name, options) as folder:
        robot, model = folder / f"robot.{'urdf' if study.arm.form == 'urdf' else 'yaml'}", folder / "model.yaml"
        write_robot(study.arm, robot)
        write_csv(folder / "poses.csv", study.measurements())
        write_csv(folder / "targets.csv", study.targets())
        geometry = GEOMETRY[:3] if "instrument_scale" in study.effects else GEOMETRY
        fitted = [*geometry, *(request(kind, study.truth, study.arm) for kind in study.effects)]
        words = tool.command(options)
        fit = [*words, "calibrate", str(folder / "poses.csv"), "--robot", str(robot), "--fit", ",".join(fitted)]
        answer = tool.run([*fit, "--write-model", str(model)], options.limit)
        row |= {"seconds": answer.seconds}
        if answer.result is None or not model.exists():
            return row | {"error": f"calibrate: status {answer.status}: {answer.error[-300:]}"}
        corrected, details = folder / "corrected.csv", folder / "details.csv"
        ask = [*words, "correct", str(folder / "targets.csv"), "--model", str(model), "--nominal", str(robot)]
        done = tool.run([*ask, "--per-target", str(details), "--output", str(corrected)], options.limit)
        row |= {"seconds": answer.seconds + done.seconds}
        if done.result is None:
            return row | {"error": f"correct: status {done.status}: {done.error[-300:]}"}
        if study.known == "repeats" and "repeatability: {}" in model.read_text():
            study.known = row["known"] = "not separated"
        held_out = answer.result["after"]["held_out"]["position"]
        return row | judged(study, read_csv(corrected), read_csv(details)) | {"fit_mm": 1e3 * held_out["rms_m"]}


def judged(study: Study, corrected: dict[str, list[str]], details: dict[str, list[str]]) -> dict[str, Any]:
    """Figures of the corrected targets; the first has no approach where the approach matters."""
    q = numbers(corrected, [f"q{i + 1}" for i in range(len(study.arm.joints))])
    wanted = numbers(corrected, ("cmd_x", "cmd_y", "cmd_z"))
    error = study.reached(q) - wanted
    as_measured = error + study.noise * study.rng.standard_normal(error.shape)
    kept = np.array([flag == "yes" for flag in details["corrected"]])
    reasons = sorted({reason.split(" ")[0] for reason in details["reason"] if reason})
    if set(study.effects) & {"backlash", "friction_windup", "approach_lag"}:
        kept[0] = False
    if not kept.any():
        return {"error": f"no target is corrected: {reasons}"}
    rms, bound = numbers(details, ("after_rms_m", "after_bound95_m"))[kept].T
    true, seen_there = (np.linalg.norm(e, axis=1)[kept] for e in (error, as_measured))
    # Without knowledge of the noise, the expected error contains it.
    noise = 3.0 * study.noise**2 if study.known in ("columns", "repeats") else 0.0
    expected = float(np.sqrt(noise + np.mean(rms**2)))
    judged_error = true if study.known in ("columns", "repeats") else seen_there
    return {
        "corrected": int(kept.sum()),
        "refused": reasons,
        "ratio": float(np.sqrt(np.mean(seen_there**2))) / expected,
        "expected_mm": 1e3 * expected,
        "true_mm": 1e3 * float(np.sqrt(np.mean(true**2))),
        "uncertainty_mm": 1e3 * float(np.sqrt(np.mean(rms**2))),
        "covered": (judged_error <= bound).tolist(),
        "covered_true": (true <= bound).tolist(),
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print the table and the claims."""
    header = ("", "sets", "targets", "coverage", "bounds", "ratio", "worst", "true mm", "expected mm", "s")
    groups = {"all": rows}
    for key in (lambda row: f"{row['axes']} axes", lambda row: "noise " + row["known"],
                lambda row: row["name"].split("-")[1], lambda row: row["name"].split("-")[2],
                lambda row: "full" if row["full"] else "positions"):  # fmt: skip
        groups |= tool.groups(rows, key)
    for effect in EFFECTS:
        groups[effect] = [row for row in rows if effect in row["effects"]]
    print(tool.table(header, [line(label, members) for label, members in groups.items() if members]))
    share, low, high, _ = tool.coverage([row["covered"] for row in rows])
    ratios = np.array([row["ratio"] for row in rows])
    above = tool.wilson(int(np.sum(ratios > 1.2)), len(ratios))
    claims = [
        tool.claim(f"{tool.percent(share)} of the errors lie within the 95 % bound", low, high, (0.93, 0.97)),
        f"error at most 1.2 times noise and uncertainty: {int(np.sum(ratios <= 1.2))} of {len(ratios)} arms, "
        f"largest {ratios.max():.2f}; at most {tool.percent(above[1])} of all arms above",
    ]
    print("\n".join(claims))
    return {"claims": claims}


def line(label: str, rows: list[dict[str, Any]]) -> list[str]:
    """One line of the table."""
    share, low, high, n = tool.coverage([row["covered"] for row in rows])
    ratio = [row["ratio"] for row in rows]
    figures = [tool.median([row[key] for row in rows]) for key in ("true_mm", "uncertainty_mm")]
    return [
        label, str(len(rows)), str(n), tool.percent(share), f"{100 * low:.1f}-{100 * high:.1f}",
        f"{tool.median(ratio):.2f}", f"{max(ratio):.2f}", *(f"{figure:.4f}" for figure in figures),
        f"{tool.median([row['seconds'] for row in rows]):.1f}",
    ]  # fmt: skip


def main() -> int:
    parser = tool.arguments(__doc__, seeds=1)
    parser.add_argument("--noise", type=float, help="noise of every set, m: 1e-9 checks that the fit has the truth")
    options = parser.parse_args()
    return tool.run_all(all_names(options), options, run_set, summary, shown)


def shown(row: dict[str, Any]) -> str:
    """One set in a line."""
    head = f"{row['name']} {','.join(row['effects'])} {row['known']} {row['poses']} {'full' if row['full'] else 'xyz'}"
    if row.get("error"):
        return f"{head}: {row['error']}"
    return (
        f"{head} {row['kind']}: {row['corrected']} corrected {row['refused']}, ratio {row['ratio']:.2f}, covered "
        f"{tool.percent(float(np.mean(row['covered'])))}, true {row['true_mm']:.4f} of {row['uncertainty_mm']:.4f} mm, "
        f"noise {1e3 * row['noise']:.3f}, fit {row['fit_mm']:.3f} mm, {row['seconds']:.1f} s"
    )


if __name__ == "__main__":
    sys.exit(main())
