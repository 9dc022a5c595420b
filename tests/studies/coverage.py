#!/usr/bin/env python3
"""Do 95 % intervals hold the truth?

Zeros and link constants are wrong by 0.5 mrad and 0.5 mm and declared; 75 positions, each joint in one half of its
range (`learned`; the other halves are `outside`). Errors of the rows, 30 um on each axis:

white    independent and normal
wander   20 um independent, 22 um that forgets itself over ten rows
visits   25 poses, three visits each: noise, 20 urad of joint scatter at each visit, 20 urad shared by visits of a pose
faint    the same, 10 urad of both
heavy    Student's t, 3 degrees of freedom
axes     four times as large along z

`coefficients`: estimate and std in `parameters`. `position`: each axis of the noise-free position at 20 fresh poses,
standard error from `parameter_covariance`. `bound`: error measured at a fresh pose (in the campaign: same wander),
within radius95 of `robacc predict`; `noise-free`: error of the model alone. `held-out`: intervals of errors of
held-out poses against errors measured at fresh poses. `gain`: of the held-out rms over the registered nominal
model. `causes`: size at the tool.

    OPENBLAS_NUM_THREADS=1 python coverage.py --arms 40 --rows sets.jsonl
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import least_squares
import numpy as np
import tool
from arm import ARMS, SIX_JOINTS, Setup, write_robot

import robacc

DECLARED = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
NOISE, POSES, FRESH = 3e-5, 75, 20
SCATTER = {"visits": 2e-5, "faint": 1e-5}
NOISES = ("white", "wander", "visits", "faint", "heavy", "axes")
MANY, DRAWS = 4000, 5
"""Fresh poses behind the true size of the error, and errors of the row drawn at each."""


def row_errors(kind: str, moved: np.ndarray, rng: np.random.Generator, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (N, 3) of rows, and the wander among them; ``moved`` (N, 3, J) are derivatives by the joints."""
    n, joints = len(moved), moved.shape[2]
    error, wander = NOISE * rng.standard_normal((n, 3)), np.zeros((n, 3))
    if kind == "wander":
        state = rng.standard_normal(3)
        for k in range(n):
            wander[k] = 2.2e-5 * state
            state = np.exp(-0.1) * state + np.sqrt(1 - np.exp(-0.2)) * rng.standard_normal(3)
        error = 2 / 3 * error + wander
    elif kind in SCATTER:
        shared = np.repeat(rng.standard_normal((n // repeats, joints)), repeats, axis=0)
        error += SCATTER[kind] * np.einsum("naj,nj->na", moved, shared + rng.standard_normal((n, joints)))
    elif kind == "heavy":
        error = NOISE / np.sqrt(3) * rng.standard_t(3, (n, 3))
    elif kind == "axes":
        error *= np.array([1, 1, 4]) / np.sqrt(6)
    return error, wander


def run_set(name: str, _: argparse.Namespace) -> dict[str, Any]:
    """Draw, calibrate and judge one arm."""
    kind, arm = name.split("-")[:2]
    rng, setup = tool.generator(name), Setup(ARMS[arm])
    truth, n = setup.erring(rng, 5e-4, 3e-3), setup.n
    repeats = 3 if kind in SCATTER else 1
    low, high = setup.span.T
    upper, middle = rng.integers(2, size=n).astype(bool), 0.5 * (low + high)
    ends = np.where(upper, middle, low), np.where(upper, high, middle)
    others = np.where(upper, low, middle), np.where(upper, middle, high)
    q = np.repeat(rng.uniform(*ends, (POSES // repeats, n)), repeats, axis=0)
    error, wander = row_errors(kind, setup.joint_jacobian(truth, q), rng, repeats)
    data = robacc.Measurements(position=(setup.positions(truth, q) + error).T, q=q.T.copy())
    with tempfile.TemporaryDirectory() as folder:
        write_robot(setup.arm, Path(folder) / "robot.yaml", masses=False)
        fitted = robacc.calibrate(data, robot=f"{folder}/robot.yaml", fit=DECLARED)
        fitted.write_model(f"{folder}/model.yaml")
        result = fitted.payload()
        fresh = {"learned": rng.uniform(*ends, (FRESH, n)), "outside": rng.uniform(*others, (FRESH, n))}
        predicted = {where: robacc.predict(f"{folder}/model.yaml", poses=some.T) for where, some in fresh.items()}
    record = predicted["learned"].robot.fit
    separate = float(record["noise"]["position"]) if record["noise"]["separate"] else 0.0
    mask = setup.declared(DECLARED)
    covered: dict[str, list[bool]] = {}
    rows = tool.intervals(setup, result, q, truth, mask, tolerance=1e-3 * NOISE)
    covered["coefficients"] = tool.covered(rows)
    values = model_values(setup, result)

    def measured(some: np.ndarray, times: int) -> np.ndarray:
        """Errors of the model that an instrument measures at fresh poses, in the campaign's own wander."""
        own = np.tile(setup.positions(values, some) - setup.positions(truth, some), (times, 1))
        drawn, moves = row_errors(kind, np.tile(setup.joint_jacobian(truth, some), (times, 1, 1)), rng, 1)
        return own - drawn + moves - wander[rng.integers(len(wander), size=len(own))]

    for where, some in fresh.items():
        alone = setup.positions(values, some) - setup.positions(truth, some)
        covered[f"position, {where}"] = (np.abs(alone) <= 1.96 * standard_errors(setup, result, values, some)).ravel()
        radius = predicted[where].position.pose_radius95
        if separate:
            radius = bounds(predicted[where].position.covariance, separate, rng)
        covered[f"bound, {where}"] = np.linalg.norm(measured(some, 1), axis=1) <= radius
        covered[f"bound noise-free, {where}"] = np.linalg.norm(alone, axis=1) <= radius
    lengths = np.linalg.norm(measured(rng.uniform(*ends, (MANY, n)), DRAWS), axis=1)
    true = {"rms": np.sqrt(np.mean(lengths**2)), "mean_error": lengths.mean(), "p95": np.quantile(lengths, 0.95)}
    stated = result["after"]["held_out"]["position"]["intervals"]
    for key, size in true.items():
        ends_of = stated[f"{key}_m"]["lower"], stated[f"{key}_m"]["upper"]
        if ends_of != (None, None):  # one end may be unknown: too few poses for an upper end of p95
            covered[f"held-out {key}"] = [bool((ends_of[0] or 0.0) <= size <= (ends_of[1] or np.inf))]
    frames = np.array([label.startswith(("base", "tool")) for label in setup.names])
    registered = least_squares.fit(setup, q, data.position.T, frames).values
    some = rng.uniform(*ends, (MANY, n))
    before = np.sqrt(
        np.mean(np.sum((setup.positions(registered, some) - setup.positions(truth, some)) ** 2, axis=1)) + 3 * NOISE**2
    )
    gain = result["gain_m"]
    covered["gain"] = [bool(gain["low"] <= before - true["rms"] <= gain["high"])]
    covered["causes"] = causes(setup, result, rows, truth, q)
    scatter = np.sqrt(np.mean(np.sum((SCATTER.get(kind, 0.0) * setup.joint_jacobian(truth, q)) ** 2, axis=(1, 2))))
    told = result["repeatability"]
    return {
        "name": name,
        "covered": {key: [bool(flag) for flag in flags] for key, flags in covered.items()},
        "noise": result["noise"]["position_m"] / NOISE,
        "held-out rms": result["after"]["held_out"]["position"]["rms_m"] / true["rms"],
        "repeatability": told["position_m"] / scatter if told and kind in SCATTER else None,
        "place": told["pose_position_m"] / scatter if told and kind in SCATTER else None,
        "dropped": len(setup.names) - len(result["parameter_covariance"]["names"]),
        "terms": [text for text in result["warnings"] if "no cause" in text or "in time" in text or "times as" in text],
        "outliers": len(result["outliers"]),
    }


def model_values(setup: Setup, result: dict[str, Any]) -> np.ndarray:
    """Return the coefficients of the fitted model, as differences from nominal."""
    values, index = np.zeros(len(setup.names)), {label: i for i, label in enumerate(setup.names)}
    for parameter in result["parameters"]:
        if parameter["name"] in index and parameter["value"] is not None:
            values[index[parameter["name"]]] = parameter["value"]
            if parameter["name"].startswith("tool_frame"):
                values[index[parameter["name"]]] -= setup.arm.tool["xyz".index(parameter["name"][-1])]
    return values


def standard_errors(setup: Setup, result: dict[str, Any], values: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return (N, 3) standard errors of positions by the covariance of the coefficients."""
    names, triangle = result["parameter_covariance"]["names"], result["parameter_covariance"]["lower_triangle"]
    chosen = [setup.index(label) for label in names]
    covariance = np.zeros((len(names),) * 2)
    for i, row in enumerate(triangle):
        covariance[i, : i + 1] = covariance[: i + 1, i] = row
    whole = setup.jacobian(values, q, np.ones(len(values), bool))[:, chosen]
    return np.sqrt(np.einsum("np,pq,nq->n", whole, covariance, whole)).reshape(-1, 3)


def bounds(covariance: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Return (N,) the length that 95 % of errors do not exceed, with noise of the instrument beside ``covariance``."""
    drawn = rng.standard_normal((20_000, 3))
    roots = [np.linalg.cholesky(covariance[..., k] + noise**2 * np.eye(3)) for k in range(covariance.shape[2])]
    return np.array([np.quantile(np.linalg.norm(drawn @ root.T, axis=1), 0.95) for root in roots])


def causes(
    setup: Setup, result: dict[str, Any], rows: list[dict[str, Any]], truth: np.ndarray, q: np.ndarray
) -> list[bool]:
    """Return whether the intervals of sizes hold those of the true coefficients, where all of a cause are known."""
    wanted = {row["name"]: row["truth"] for row in rows}
    stds = {p["name"]: p["std"] for p in result["parameters"]}
    flags = []
    for cause in result["causes"]:
        stem = f"{cause['effect']}.{cause['joints'][0]}"
        names = [label for label in stds if (label == stem or label.startswith(f"{stem}.")) and stds[label] is not None]
        if not names or not set(names) <= set(wanted):
            continue
        whole = setup.jacobian(truth, q, np.ones(len(truth), bool))
        shift = whole[:, [setup.index(label) for label in names]] @ [wanted[label] for label in names]
        flags.append(bool(cause["low_m"] <= np.sqrt(3 * np.mean(shift**2)) <= cause["high_m"]))
    return flags


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print the tables."""
    lines = []
    for kind, members in tool.groups(rows, lambda row: row["name"].split("-")[0]).items():
        for figure in dict.fromkeys(key for row in members for key in row["covered"]):
            share, low, high, count = tool.coverage([row["covered"].get(figure, []) for row in members])
            told = "" if low <= 0.98 and high >= 0.92 else "outside 92-98 %"
            error = 100 * (high - share) / 1.96
            lines.append([kind, figure, len(members), f"{100 * share:.1f}", f"{error:.1f}", count, told])
    print(tool.table(("noise", "figure", "arms", "hold, %", "± std", "intervals", ""), lines))
    lines = []
    for kind, members in tool.groups(rows, lambda row: row["name"].split("-")[0]).items():
        for figure in ("noise", "held-out rms", "repeatability", "place"):
            ratio = [row[figure] for row in members if row[figure] is not None]
            if ratio:
                spread = " to ".join(f"{end:.2f}" for end in np.quantile(ratio, (0.05, 0.95)))
                lines.append([kind, figure, len(ratio), f"{np.median(ratio):.2f}", spread])
    print(tool.table(("noise", "figure over its truth", "arms", "median", "5 to 95 %"), lines))
    return {}


def main() -> int:
    parser = tool.arguments(__doc__, 1)
    parser.add_argument("--arms", type=int, default=40, help="arms of each noise")
    options = parser.parse_args()
    names = [f"{kind}-{SIX_JOINTS[seed % 3]}-s{seed}" for seed in range(options.arms) for kind in NOISES]
    return tool.run_all(names, options, run_set, summary)


if __name__ == "__main__":
    sys.exit(main())
