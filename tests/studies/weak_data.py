#!/usr/bin/env python3
"""Few poses, much noise, joint zeros far off: are the intervals of `robacc calibrate` right, is its model any good.

Each set is an arm whose joint zeros are 1.5 to 2 degrees wrong, each with a sign drawn at random, and the rest of its
geometry 0.3 mm and 0.3 mrad. 30 or 60 poses, positions only, noise 1, 1.5 or 3 mm per axis.
Fitted are base_frame, tool_frame, joint_offset and link_geometry. The model that it writes is judged by `robacc
estimate` on 200 fresh poses without noise, against plain least squares over the same coefficients (`least_squares.py`).
Intervals are those of the interior joints' offsets; those of plain least squares with the true noise stand beside.

A set's name is its design: ARM-POSES-NOISE_MM-sSEED.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from typing import Any

import numpy as np
import tool
from arm import ARMS, SIX_JOINTS, Setup, write_poses
from least_squares import fit

EFFECTS = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
FRESH = 200


def all_names(options: argparse.Namespace) -> list[str]:
    """The whole design."""
    parts = (SIX_JOINTS, (30, 60), ("1", "1.5", "3"), tool.seeds_of(options))
    return [f"{arm}-{n}-{mm}-s{s}" for arm, n, mm, s in itertools.product(*parts)]


def true_arm(setup: Setup, rng: np.random.Generator) -> np.ndarray:
    """Coefficients of the true arm in its true place."""
    values = setup.placed(rng)
    zeros, links = setup.declared(["joint_offset"]), setup.declared(["link_geometry"])
    n = int(zeros.sum())
    values[zeros] = np.radians(rng.uniform(1.5, 2.0, n)) * rng.choice((-1, 1), n)
    values[links] = rng.normal(0, 3e-4, int(links.sum()))
    return values


def run_set(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, run and judge one set."""
    match = re.fullmatch(r"(\w+)-(\d+)-([\d.]+)-s\d+", name)
    assert match, name
    setup, count, noise = Setup(ARMS[match[1]]), int(match[2]), 1e-3 * float(match[3])
    rng = tool.generator(name)
    truth, mask = true_arm(setup, rng), setup.declared(EFFECTS)
    q, fresh = (rng.uniform(*setup.arm.span.T, (n, setup.arm.n)) for n in (count, FRESH))
    target, one = np.zeros(count, int), np.zeros(FRESH, int)
    xyz = setup.positions(truth, q, target) + noise * rng.standard_normal((count, 3))
    there = setup.positions(truth, fresh, one)
    plain = fit(setup, q, target, xyz, mask)
    row: dict[str, Any] = {"name": name, "plain_mm": 1e3 * tool.rms(setup.positions(plain.values, fresh, one) - there)}
    inner = {f"joint_offset.{joint}" for joint in setup.arm.joints[1:-1]}
    known = np.isin(setup.names, list(inner)) & np.isfinite(plain.std)
    row["covered_plain"] = (np.abs(plain.values - truth)[known] <= 1.96 * noise * plain.std[known]).tolist()
    row |= calibrated(setup, (q, xyz), (fresh, there), truth, noise, name, options)
    if row.get("error"):
        return row
    zeros = [one for one in row.pop("intervals") if one["name"] in inner]
    return row | {"covered": tool.covered(zeros), "wanted": len(inner), "zeros": zeros}


def calibrated(
    setup: Setup,
    poses: tuple[np.ndarray, np.ndarray],
    fresh: tuple[np.ndarray, np.ndarray],
    truth: np.ndarray,
    noise: float,
    name: str,
    options: argparse.Namespace,
) -> dict[str, Any]:
    """What `calibrate` says of joints and positions, and the error of its model at others."""
    with tool.folder_of(name, options) as folder:
        setup.write(folder / "robot.yaml")
        write_poses(folder / "poses.csv", *poses)
        write_poses(folder / "test.csv", *fresh)
        answer, test = tool.fit_and_test(("calibrate", "--fit", ",".join(EFFECTS)), folder, options)
    row = {"seconds": answer.seconds, "status": answer.status}
    if answer.result is None or test.result is None:
        return row | {"error": f"status {answer.status}: {answer.error[-200:]}; {test.error}"}
    target, mask = np.zeros(len(poses[0]), int), setup.declared(EFFECTS)
    found = tool.intervals(setup, answer.result, poses[0], target, truth, mask, tolerance=0.05 * noise)
    return row | {
        "test_mm": 1e3 * test.result["position"]["rms_m"],
        "noise_mm": 1e3 * (answer.result["noise"]["position_m"] or np.nan),
        "intervals": found,
        "covered_all": tool.covered(found),
        "warnings": answer.result.get("warnings"),
    }


def line(label: str, rows: list[dict[str, Any]]) -> list[str]:
    """One line of the table."""
    keys = ("covered", "covered_all", "covered_plain")
    zeros, everything, plain = (tool.coverage([row[key] for row in rows]) for key in keys)
    ratio = [row["test_mm"] / row["plain_mm"] for row in rows]
    given, wanted = sum(len(row["covered"]) for row in rows), sum(row["wanted"] for row in rows)
    figures = [tool.median([row[key] for row in rows]) for key in ("test_mm", "plain_mm")]
    return [
        label,
        str(len(rows)),
        tool.percent(zeros[0]),
        f"{given}/{wanted}",
        tool.percent(everything[0]),
        tool.percent(plain[0]),
        *(f"{figure:.2f}" for figure in figures),
        f"{tool.median(ratio):.2f}",
        f"{max(ratio):.2f}",
        f"{tool.median([row['seconds'] for row in rows]):.1f}",
    ]


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print the table and the claims."""
    header = (
        "",
        "sets",
        "zeros hold",
        "given",
        "all hold",
        "plain hold",
        "robacc mm",
        "plain mm",
        "ratio",
        "worst",
        "s",
    )
    lines = [line("all sets", rows)]
    for key in (
        lambda row: row["name"].split("-")[0],
        lambda row: " poses, ".join(row["name"].split("-")[1:3]) + " mm",
    ):
        lines += [line(label, members) for label, members in sorted(tool.groups(rows, key).items())]
    print(tool.table(header, lines))
    print("hold: share of 95 % intervals with the truth: of interior joints' offsets, of all, of plain least squares'")
    print(
        "offsets; given: intervals of offsets; mm: rms at fresh poses, median; ratio: robacc / plain, median and worst"
    )
    share, low, high, n = tool.coverage([row["covered"] for row in rows])
    middle, lower, upper = tool.mean_ratio([row["test_mm"] / row["plain_mm"] for row in rows])
    claims = [
        tool.claim(f"coverage 92-98 %: {tool.percent(share)} of {n} intervals", low, high, (0.92, 0.98)),
        tool.claim(f"test error at most 1.1 times least squares: {middle:.2f} in the mean", lower, upper, (0.0, 1.1)),
    ]
    print("\n".join(claims))
    return {"table": [header, *lines], "claims": claims}


def main() -> int:
    options = tool.arguments(__doc__, seeds=3).parse_args()
    return tool.run_all(all_names(options), options, run_set, summary, shown)


def shown(row: dict[str, Any]) -> str:
    """One set in a line."""
    held = f"{sum(row.get('covered', []))} of {len(row.get('covered', []))} intervals"
    figures = f"test {row.get('test_mm', np.nan):.2f} mm, plain {row['plain_mm']:.2f} mm, {held}"
    return f"{row['name']} {figures}, {row['seconds']:.1f} s {row.get('error', '')}"


if __name__ == "__main__":
    sys.exit(main())
