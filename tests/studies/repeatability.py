#!/usr/bin/env python3
"""Clean and faulty arms whose own repeatability is not measurement noise: what `robacc trace` says of them.

Each set is an arm with wrong joint zeros (`zeros`) or with all its geometry wrong (`full`), set up 10 mm and 5 mrad
off, measured at commanded poses x cycles x targets. Each arrival has an error of every joint drawn once (`all…`) or of
one joint alone, four times the instrument's noise at the tool (`one`), and all targets of that arrival share it. The
instrument adds independent noise to each coordinate. Directions of approach and times are logged, so that all
effects are tested.

A set's name is its design: ARM-tTARGETS-cCYCLES-SCATTER-nNOISE_UM-GEOMETRY[-EFFECT-pIDEAL]-sSEED. With --power each
set has one true effect, as large as an ideal test finds with probability IDEAL: a test that knows the effect, its joint
and the true covariance, at 1 % over 200 candidates.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tool
from arm import ARMS, SIX_JOINTS, TARGETS, Setup, write_poses
from least_squares import identifiable
from scipy import optimize, stats

SCATTER = {"all0": 0.0, "all1e-5": 1e-5, "all3e-5": 3e-5, "all1e-4": 1e-4, "all3e-4": 3e-4, "one": None}
EFFECTS = {"compliance": ("joint_compliance", 1), "backlash": ("backlash", 2), "periodic": ("transmission_error", 2)}
ALPHA = 0.01 / 200
DECLARED = {
    "zeros": "base_frame,tool_frame,joint_offset",
    "full": "base_frame,tool_frame,joint_offset,link_geometry",
}


@dataclass(frozen=True)
class Design:
    """One set: everything that its name says."""

    name: str
    arm: str
    targets: int
    cycles: int
    scatter: str
    noise: float
    geometry: str
    effect: str | None
    ideal: float | None


def design(name: str) -> Design:
    """A set's design from its name."""
    pattern = r"(\w+)-t(\d)-c(\d+)-(all[\de-]+|one)-n(\d+)-(zeros|full)(?:-([a-z]+)-p([\d.]+))?-s\d+"
    match = re.fullmatch(pattern, name)
    assert match, name
    arm, targets, cycles, scatter, noise, geometry, effect, ideal = match.groups()
    share = float(ideal) if ideal else None
    return Design(name, arm, int(targets), int(cycles), scatter, 1e-6 * float(noise), geometry, effect, share)


def all_names(options: argparse.Namespace) -> list[str]:
    """The whole design, with --power for each effect and ideal power."""
    parts = (SIX_JOINTS, (1, 3, 5), (1, 3, 30), SCATTER, (5, 20, 50), DECLARED)
    names = []
    for arm, targets, cycles, scatter, noise, geometry in itertools.product(*parts):
        stem = f"{arm}-t{targets}-c{cycles}-{scatter}-n{noise}-{geometry}"
        faults = [""]
        if options.power:
            kinds = [effect for effect in EFFECTS if effect != "compliance" or ARMS[arm].masses]
            faults = [f"-{effect}-p{ideal}" for effect in kinds for ideal in (0.5, 0.9, 0.99)]
        names += [f"{stem}{fault}-s{seed}" for fault in faults for seed in tool.seeds_of(options)]
    return names


@dataclass(frozen=True)
class Sample:
    """One set as measured, and what is true of it; rows are visit by visit, targets within."""

    setup: Setup
    truth: np.ndarray
    mask: np.ndarray
    q: np.ndarray
    xyz: np.ndarray
    target: np.ndarray
    pose: np.ndarray
    cycle: np.ndarray
    visit: np.ndarray
    direction: np.ndarray
    spread: np.ndarray
    size: float


def true_arm(setup: Setup, geometry: str, rng: np.random.Generator) -> np.ndarray:
    """Coefficients of the true arm in its true place."""
    values = np.zeros(len(setup.names))
    values[:3], values[3:6] = rng.normal(0, 6e-3, 3), rng.normal(0, 3e-3, 3)
    places = rng.normal(0, 6e-3, 3) + rng.normal(0, 5e-4, (setup.n_targets, 3))
    values[6 : 6 + 3 * setup.n_targets] = places.ravel()
    wrong = setup.declared(["joint_offset"] if geometry == "zeros" else ["joint_offset", "link_geometry"])
    values[wrong] = rng.normal(0, 3e-4, int(wrong.sum()))
    return values


def sample(case: Design, poses: int | None, pose_scatter: float) -> Sample:
    """Draw one set."""
    rng = tool.generator(case.name)
    setup = Setup(ARMS[case.arm], case.targets)
    arm = setup.arm
    truth = true_arm(setup, case.geometry, rng)
    count = poses or (100 if case.cycles < 30 else 20)
    visits = count * case.cycles
    at_pose = rng.uniform(*arm.span.T, (count, arm.n))
    commanded = np.tile(at_pose, (case.cycles, 1))
    direction = rng.choice((-1, 1), (visits, arm.n))
    spread = scatter_of(case, setup, truth, at_pose, rng)
    arrived = commanded + spread * rng.standard_normal((visits, arm.n))
    arrived += np.tile(pose_scatter * rng.standard_normal((count, arm.n)), (case.cycles, 1))
    rows = {
        "target": np.tile(np.arange(case.targets), visits),
        "pose": np.repeat(np.tile(np.arange(count), case.cycles), case.targets),
        "cycle": np.repeat(np.arange(case.cycles), count * case.targets),
        "visit": np.repeat(np.arange(visits), case.targets),
    }
    q = commanded[rows["visit"]]
    mask = setup.declared(DECLARED[case.geometry].split(","))
    blank = Sample(setup, truth, mask, q, np.zeros((len(q), 3)), **rows, direction=direction, spread=spread, size=0.0)
    size = 0.0
    if case.effect:
        regressors = fault(case, blank)
        mixture = rng.standard_normal(regressors.shape[0])
        mixture /= np.linalg.norm(mixture)
        shift = np.einsum("k,kn->n", mixture, regressors)
        size = size_found(case, blank, regressors, mixture, pose_scatter)
        arrived[:, EFFECTS[case.effect][1]] += size * shift
    noise = case.noise * rng.standard_normal((len(q), 3))
    xyz = setup.positions(truth, arrived[rows["visit"]], rows["target"]) + noise
    return Sample(setup, truth, mask, q, xyz, **rows, direction=direction, spread=spread, size=size)


def scatter_of(case: Design, setup: Setup, truth: np.ndarray, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Standard deviation of each joint at an arrival, rad."""
    joint = int(rng.integers(setup.arm.n))
    equal = SCATTER[case.scatter]
    if equal is not None:
        return np.full(setup.arm.n, equal)
    levers = setup.joint_jacobian(truth, q, np.zeros(len(q), int))
    spread = np.zeros(setup.arm.n)
    spread[joint] = 4 * case.noise / np.sqrt(np.mean(np.sum(levers[:, joint].reshape(-1, 3) ** 2, axis=1)))
    return spread


def fault(case: Design, drawn: Sample) -> np.ndarray:
    """Regressors of the true effect at each visit, (K, visits): the joint turns by coefficient x regressor."""
    joint = EFFECTS[str(case.effect)][1]
    _, first = np.unique(drawn.visit, return_index=True)
    q = drawn.q[first]
    if case.effect == "backlash":
        return drawn.direction[:, joint][None].astype(float)
    if case.effect == "periodic":
        return np.array([np.cos(q[:, joint]), np.sin(q[:, joint])])
    return drawn.setup.torques(drawn.truth, q)[:, joint][None]


def whitened(case: Design, drawn: Sample, columns: np.ndarray, pose_scatter: float) -> np.ndarray:
    """Columns (3 rows, P) times the inverse Cholesky factor of the true covariance."""
    levers = drawn.setup.joint_jacobian(drawn.truth, drawn.q, drawn.target)
    group = drawn.pose if pose_scatter else drawn.visit
    order = np.argsort(group, kind="stable")
    size = 3 * len(group) // (int(group.max()) + 1)

    def blocks(array: np.ndarray) -> np.ndarray:
        return array.reshape(len(group), 3, -1)[order].reshape(-1, size, array.shape[1])

    lever, column = blocks(levers), blocks(columns)
    covariance = np.einsum("gij,j,gkj->gik", lever, drawn.spread**2, lever)
    visit = np.repeat(drawn.visit[order], 3).reshape(-1, size)
    covariance *= visit[:, :, None] == visit[:, None, :]
    covariance += pose_scatter**2 * lever @ lever.transpose(0, 2, 1) + case.noise**2 * np.eye(size)
    return np.linalg.solve(np.linalg.cholesky(covariance), column).reshape(-1, columns.shape[1])


def beyond_model(case: Design, drawn: Sample, regressors: np.ndarray, pose_scatter: float) -> np.ndarray:
    """Whitened columns of the effect (3 rows, K), less what the declared coefficients can imitate."""
    joint = EFFECTS[str(case.effect)][1]
    lever = drawn.setup.joint_jacobian(drawn.truth, drawn.q, drawn.target)[:, joint]
    columns = lever[:, None] * np.repeat(regressors[:, drawn.visit], 3, axis=1).T
    model = drawn.setup.jacobian(drawn.truth, drawn.q, drawn.target, drawn.mask)
    both = whitened(case, drawn, np.hstack([model, columns]), pose_scatter)
    left, right = both[:, : model.shape[1]], both[:, model.shape[1] :]
    unit, upper = np.linalg.qr(left / np.maximum(np.linalg.norm(left, axis=0), 1e-300))
    turn, singular, _ = np.linalg.svd(upper)
    base = unit @ turn[:, singular > 1e-7 * singular[0]]
    return right - base @ (base.T @ right)


def size_found(case: Design, drawn: Sample, regressors: np.ndarray, mixture: np.ndarray, pose_scatter: float) -> float:
    """Size of the effect that the ideal test finds with the wanted probability."""
    rest = beyond_model(case, drawn, regressors, pose_scatter) @ mixture
    degrees = len(regressors)
    limit = stats.chi2.isf(ALPHA, degrees)
    wanted = optimize.brentq(lambda x: stats.ncx2.sf(limit, degrees, x) - case.ideal, 1e-3, 1e3)
    return float(np.sqrt(wanted / (rest @ rest)))


def oracle(case: Design, drawn: Sample, pose_scatter: float) -> dict[str, Any]:
    """What a result would say that knew the true covariance, and of the effects only the one that may be there.

    It checks the study itself: its intervals hold the truth in 95 % of cases, and its power is the ideal one.
    """
    error = drawn.xyz - drawn.setup.positions(drawn.truth, drawn.q, drawn.target)
    model = drawn.setup.jacobian(drawn.truth, drawn.q, drawn.target, drawn.mask)
    both = whitened(case, drawn, np.hstack([model, error.reshape(-1, 1)]), pose_scatter)
    left, right = both[:, :-1], both[:, -1]
    scale = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    unit, upper = np.linalg.qr(left / scale)
    inverse = np.linalg.pinv(upper, rcond=1e-7)
    shift, std = inverse @ (unit.T @ right) / scale, np.linalg.norm(inverse, axis=1) / scale
    known = identifiable(model)
    places = dict(zip(drawn.setup.names[6:], TARGETS[: case.targets].ravel(), strict=False))
    parameters = [
        {"name": name, "value": value + places.get(name, 0.0), "std": float(error) if sure else None}
        for name, value, error, sure in zip(
            np.array(drawn.setup.names)[drawn.mask], drawn.truth[drawn.mask] + shift, std, known, strict=True
        )
    ]
    findings = []
    if case.effect:
        rest = beyond_model(case, drawn, fault(case, drawn), pose_scatter)
        base = np.linalg.qr(rest)[0]
        if np.sum((base.T @ right) ** 2) > stats.chi2.isf(ALPHA, rest.shape[1]):
            effect, joint = EFFECTS[case.effect]
            findings.append({"effect": effect, "joints": [drawn.setup.arm.joints[joint]]})
    return {"parameters": parameters, "findings": findings, "verdict": "oracle"}


def write(case: Design, drawn: Sample, folder: Path) -> None:
    """Robot file and measured poses."""
    drawn.setup.write(folder / "robot.yaml")
    columns: dict[str, Any] = {"pose": [f"P{k + 1}" for k in drawn.pose], "cycle": drawn.cycle + 1}
    columns["visit"] = drawn.visit + 1
    if case.targets > 1:
        columns["target"] = [drawn.setup.targets[k] for k in drawn.target]
    columns["time_s"] = 10 * drawn.visit
    columns |= {f"dir_q{j + 1}": drawn.direction[drawn.visit, j] for j in range(drawn.q.shape[1])}
    write_poses(folder / "poses.csv", drawn.q, drawn.xyz, columns)


def ideal_errors(case: Design, drawn: Sample, names: list[str], pose_scatter: float) -> np.ndarray:
    """Standard errors of generalised least squares with the true covariance, of the coefficients named."""
    free = np.isin(drawn.setup.names, names)
    model = whitened(case, drawn, drawn.setup.jacobian(drawn.truth, drawn.q, drawn.target, free), pose_scatter)
    scale = np.linalg.norm(model, axis=0)
    inverse = np.linalg.pinv(np.linalg.qr(model / scale, mode="r"))
    found = dict(zip(np.array(drawn.setup.names)[free], np.linalg.norm(inverse, axis=1) / scale, strict=True))
    return np.array([found[name] for name in names])


def showable(case: Design, drawn: Sample, pose_scatter: float) -> np.ndarray:
    """Smallest relative standard error with which this design can show each s_j: from the Fisher information.

    Where commanded poses have an error of their own, only differences between cycles count.
    """
    if pose_scatter and case.cycles == 1:
        return np.full(drawn.setup.arm.n, np.inf)
    rows = 3 * case.targets
    lever = drawn.setup.joint_jacobian(drawn.truth, drawn.q, drawn.target).reshape(-1, rows, drawn.setup.arm.n)
    covariance = np.einsum("gij,j,gkj->gik", lever, drawn.spread**2, lever) + case.noise**2 * np.eye(rows)
    weight = np.linalg.inv(covariance)
    pushed = weight @ lever
    joints = np.sum((lever.transpose(0, 2, 1) @ pushed) ** 2, axis=0)
    cross = np.sum(pushed**2, axis=(0, 1))
    noise = np.sum(weight**2)
    information = 0.5 * np.block([[noise, cross[None]], [cross[:, None], joints]])
    information *= 1 - 1 / case.cycles if pose_scatter else 1 - int(drawn.mask.sum()) / (3 * len(drawn.q))
    scale = np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    errors = np.sqrt(np.diag(inverse))[1:] / scale[1:]
    with np.errstate(divide="ignore"):
        return np.where(drawn.spread > 0, errors / (2 * drawn.spread**2), np.inf)


def judge(case: Design, drawn: Sample, answer: dict[str, Any], pose_scatter: float) -> dict[str, Any]:
    """Figures of one result."""
    rows = tool.intervals(
        drawn.setup, answer, drawn.q, drawn.target, drawn.truth, drawn.mask, tolerance=0.02 * case.noise
    )
    errors = ideal_errors(case, drawn, [row["name"] for row in rows], pose_scatter) if rows else np.zeros(0)
    hold = tool.covered(rows)
    zeros = [flag for row, flag in zip(rows, hold, strict=True) if row["name"].startswith("joint_offset")]
    findings = answer.get("findings") or []
    names = [(f["effect"], list(f.get("joints") or [])) for f in findings]
    rivals = [(a["effect"], list(a.get("joints") or [])) for f in findings for a in f.get("alternatives") or []]
    held = [((answer.get(k) or {}).get("held_out") or {}).get("position") for k in ("before", "after")]
    out: dict[str, Any] = {
        "verdict": answer.get("verdict"),
        "findings": [[effect, joints] for effect, joints in names],
        "held_out_um": [1e6 * e["rms_m"] if e else None for e in held],
        "noise_ratio": ((answer.get("noise") or {}).get("position_m") or np.nan) / case.noise,
        "converged": answer.get("converged"),
        "covered": hold,
        "covered_zeros": zeros,
        "over_ideal": tool.median([row["std"] / e for row, e in zip(rows, errors, strict=True)]),
        "missed": [row for row, flag in zip(rows, hold, strict=True) if not flag],
        "truth": dict(zip(drawn.setup.arm.joints, drawn.spread.tolist(), strict=True)),
        "repeatability": answer.get("repeatability"),
        "repeatability_ideal": dict(
            zip(drawn.setup.arm.joints, showable(case, drawn, pose_scatter).tolist(), strict=True)
        ),
    }
    if case.effect:
        effect, joint = EFFECTS[case.effect]
        wanted = (effect, [drawn.setup.arm.joints[joint]])
        out |= {"size": drawn.size, "named": wanted in names, "alternative": wanted in rivals, "any": bool(names)}
    return out


def run_set(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, run and judge one set."""
    case = design(name)
    drawn = sample(case, options.poses, options.pose_scatter)
    row: dict[str, Any] = {"name": case.name, "rows": len(drawn.q)}
    if options.oracle:
        answer = oracle(case, drawn, options.pose_scatter)
        return row | {"seconds": 0.0, "status": 0} | judge(case, drawn, answer, options.pose_scatter)
    with tool.folder_of(name, options) as folder:
        write(case, drawn, folder)
        declared = DECLARED[case.geometry]
        asked = ["trace", "--declared"] if not options.calibrate else ["calibrate", "--fit"]
        words = [*tool.command(options), asked[0], str(folder / "poses.csv"), "--robot", str(folder / "robot.yaml")]
        answer = tool.run([*words, asked[1], declared, "--seed", "0"], options.limit)
    row |= {"seconds": answer.seconds, "status": answer.status}
    if answer.result is None:
        return row | {"error": answer.error or f"status {answer.status}"}
    return row | judge(case, drawn, answer.result, options.pose_scatter)


def sizes(rows: list[dict[str, Any]]) -> tuple[list[float], int]:
    """Relative errors of s_j where the design can show it to 10 % (one standard error), and how many there could be."""
    errors, possible = [], 0
    for row in rows:
        found = (row.get("repeatability") or {}).get("joints") or {}
        for joint, limit in row["repeatability_ideal"].items():
            if limit <= 0.1:
                possible += 1
                if found.get(joint) is not None:
                    errors.append(abs(found[joint] / row["truth"][joint] - 1))
    return errors, possible


def worse(row: dict[str, Any]) -> bool:
    """Whether a set with findings has a held-out error no better than before."""
    before, after = row["held_out_um"]
    return bool(row["findings"]) and None not in (before, after) and after >= before


def line(label: str, rows: list[dict[str, Any]]) -> list[str]:
    """One line of the table."""
    errors, possible = sizes(rows)
    named = sum(bool(row["findings"]) for row in rows)
    share = tool.coverage([row["covered"] for row in rows])
    zeros = tool.coverage([row["covered_zeros"] for row in rows])
    return [
        label,
        str(len(rows)),
        f"{named}",
        f"{sum(map(worse, rows))}",
        tool.percent(zeros[0]),
        tool.percent(share[0]),
        f"{tool.median([row['over_ideal'] for row in rows]):.2f}",
        f"{tool.median([row['noise_ratio'] for row in rows]):.2f}",
        f"{sum(e <= 0.2 for e in errors)}/{len(errors)}/{possible}",
        tool.percent(tool.median(errors)),
        f"{tool.median([row['seconds'] for row in rows]):.1f}",
    ]


LEGEND = """named: sets with a finding; worse: of these, held-out error not lower; zeros, all: share of 95 % intervals
of joint_offset, of all declared coefficients, that hold the truth; std/ideal: standard errors over those of least
squares with the true covariance; noise: the instrument's as estimated, over the true one; s: errors of s_j within
20 %, how many given, how many the design shows to 10 %; median: of their relative errors"""
HEADER = ("", "sets", "named", "worse", "zeros", "all", "std/ideal", "noise", "s: good/given/showable", "median", "s")


def summary(rows: list[dict[str, Any]], power: bool) -> dict[str, Any]:
    """Print the tables and the claims."""
    factors = {
        "arm": lambda row: design(row["name"]).arm,
        "targets": lambda row: f"{design(row['name']).targets} targets",
        "cycles": lambda row: f"{design(row['name']).cycles} cycles",
        "scatter": lambda row: design(row["name"]).scatter,
        "noise": lambda row: f"{1e6 * design(row['name']).noise:.0f} um",
        "geometry": lambda row: design(row["name"]).geometry,
    }
    lines = [line("all sets", rows)]
    for key in factors.values():
        lines += [line(label, members) for label, members in sorted(tool.groups(rows, key).items())]
    print(tool.table(HEADER, lines))
    print(LEGEND)
    verdicts = {v: len(members) for v, members in tool.groups(rows, lambda row: str(row["verdict"])).items()}
    print("verdicts:", ", ".join(f"{v} {n}" for v, n in verdicts.items()))
    out: dict[str, Any] = {"verdicts": verdicts, "table": [HEADER, *lines]}
    modelled = [row for row in rows if row.get("named", True)]
    share, low, high, n = tool.coverage([row["covered"] for row in modelled])
    claims = [
        tool.claim(
            f"coverage 92-98 %{' (effect named)' if power else ''}: {tool.percent(share)} of {n} intervals",
            low,
            high,
            (0.92, 0.98),
        )
    ]
    if power:
        out["power"] = power_table(rows)
    else:
        hits = sum(bool(row["findings"]) for row in rows)
        bounds = tool.wilson(hits, len(rows))
        claims.insert(0, tool.claim(f"false findings at most 2 %: {hits} of {len(rows)} sets", *bounds, (0.0, 0.02)))
    errors, possible = sizes(rows)
    bounds = tool.wilson(sum(e > 0.2 for e in errors), len(errors))
    words = f"s_j within 20 % where the design shows it to 10 %: {sum(e <= 0.2 for e in errors)} of {possible}"
    claims.append(f"{words}: no s_j given" if not errors else tool.claim(words, *bounds, (0.0, 0.08)))
    print("\n".join(claims), flush=True)
    return out | {"claims": claims}


def power_table(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Share found against the ideal test's."""
    keys = [lambda row: f"{design(row['name']).effect} {design(row['name']).ideal}"]
    keys.append(lambda row: f"{design(row['name']).scatter} {design(row['name']).ideal}")
    lines = []
    for key in keys:
        for label, members in sorted(tool.groups(rows, key).items()):
            counts = [sum(bool(row[k]) for row in members) for k in ("named", "alternative", "any")]
            low, high = tool.wilson(counts[0], len(members))
            ideal = 100 * float(label.split()[-1])
            found = f"{100 * counts[0] / len(members):.0f} % ({100 * low:.0f}-{100 * high:.0f})"
            lines.append([label, str(len(members)), f"{ideal:.0f} %", found, str(counts[1]), str(counts[2])])
    print(tool.table(("effect, ideal power", "sets", "ideal", "found", "as alternative", "any finding"), lines))
    return lines


def main() -> int:
    parser = tool.arguments(__doc__, seeds=1)
    parser.add_argument("--power", action="store_true", help="one true effect in each set")
    parser.add_argument(
        "--pose-scatter", type=float, default=0.0, metavar="RAD", help="joint error of each commanded pose"
    )
    parser.add_argument("--poses", type=int, metavar="N", help="commanded poses (default: 100; 20 for 30 cycles)")
    parser.add_argument("--calibrate", action="store_true", help="run calibrate, not trace: intervals only")
    parser.add_argument("--oracle", action="store_true", help="judge the study's own ideal fit and test, not robacc")
    options = parser.parse_args()
    return tool.run_all(all_names(options), options, run_set, lambda rows: summary(rows, options.power), shown)


def shown(row: dict[str, Any]) -> str:
    """One set in a line."""
    held = "/".join("-" if x is None else f"{x:.1f}" for x in row.get("held_out_um", []))
    covered = row.get("covered", [])
    return (
        f"{row['name']} {row.get('verdict')} {row.get('findings')} held out {held} um, {sum(covered)} of "
        f"{len(covered)} intervals, {row['seconds']:.1f} s {row.get('error', '')}"
    )


if __name__ == "__main__":
    sys.exit(main())
