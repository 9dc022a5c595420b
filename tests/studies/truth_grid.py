#!/usr/bin/env python3
"""A known arm on a lift, few postures, coarse noise: does `robacc calibrate` find the true model as well as others do.

After FIGAROH's truth grid: an arm like TIAGo's (a lift and seven turning joints), 34 training postures, 184 fresh
postures without noise over the joints' whole range, positions only, noise 0.5 or 2 mm per axis. The training postures
span the same range (`wide`) or 60 % of it (`narrow`). The truth has wrong joint zeros alone (`offsets`: 20 mrad) or all
geometry wrong (`full`: zeros and twists 10 mrad, lengths 3 mm, one standard deviation). Compared at the fresh postures:

robacc     calibrate --fit base_frame,tool_frame,joint_offset,link_geometry
plain      least squares over the same coefficients
map        maximum a posteriori: zeros 20 mrad, twists 10 mrad, lengths 3 mm, whatever the truth is
map true   maximum a posteriori with the very distribution that the truth was drawn from: the limit

A set's name is its design: TRUTH-NOISE_MM-RANGE-sSEED.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from typing import Any

import numpy as np
import tool
from arm import TIAGO, Setup
from least_squares import fit
from weak_data import EFFECTS, calibrated

TRAINING, FRESH = 34, 184
KEYS = ("robacc", "plain", "map", "map_true")


def all_names(options: argparse.Namespace) -> list[str]:
    """The whole design."""
    parts = (("offsets", "full"), ("0.5", "2"), ("wide", "narrow"), tool.seeds_of(options))
    return [f"{kind}-{mm}-{span}-s{s}" for kind, mm, span, s in itertools.product(*parts)]


def prior(setup: Setup, kind: str) -> np.ndarray:
    """One standard deviation of each coefficient of the true arm: rad, m; frames are free."""
    angle, length, zero = {"offsets": (0.0, 0.0, 20e-3), "full": (10e-3, 3e-3, 10e-3), "map": (10e-3, 3e-3, 20e-3)}[
        kind
    ]
    out = np.full(len(setup.names), np.inf)
    for i, name in enumerate(setup.names):
        joint, label = name.split(".")[1], name.split(".")[-1]
        if name.startswith("joint_offset"):
            out[i] = zero if setup.arm.joints.index(joint) not in setup.arm.prismatic else length
        elif name.startswith("link_geometry"):
            out[i] = length if label in ("d", "a") else angle
    return out


def run_set(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, run and judge one set."""
    match = re.fullmatch(r"(offsets|full)-([\d.]+)-(wide|narrow)-s\d+", name)
    assert match, name
    setup, kind, noise = Setup(TIAGO), match[1], 1e-3 * float(match[2])
    rng = tool.generator(name)
    mask = setup.declared(EFFECTS)
    width = prior(setup, kind)
    truth = np.where(np.isfinite(width) & mask, width, 0.0) * rng.standard_normal(len(width))
    truth[:9] = setup.placed(rng)[:9]
    q, fresh = (rng.uniform(*setup.arm.span.T, (n, setup.arm.n)) for n in (TRAINING, FRESH))
    if match[3] == "narrow":
        middle = setup.arm.span.mean(axis=1)
        q = middle + 0.6 * (q - middle)
    target, one = np.zeros(TRAINING, int), np.zeros(FRESH, int)
    xyz = setup.positions(truth, q, target) + noise * rng.standard_normal((TRAINING, 3))
    there = setup.positions(truth, fresh, one)
    fits = {
        "plain": fit(setup, q, target, xyz, mask),
        "map": fit(setup, q, target, xyz, mask, prior(setup, "map"), noise),
        "map_true": fit(setup, q, target, xyz, mask & (width > 0), width, noise),
    }
    errors = {key: 1e3 * tool.rms(setup.positions(one_fit.values, fresh, one) - there) for key, one_fit in fits.items()}
    row: dict[str, Any] = {
        "name": name,
        "nominal_mm": 1e3 * tool.rms(setup.positions(0 * truth, fresh, one) - there),
        **errors,
    }
    row |= calibrated(setup, (q, xyz), (fresh, there), truth, noise, name, options)
    if row.get("error"):
        return row
    zeros = [one for one in row.pop("intervals") if one["name"].startswith("joint_offset")]
    return row | {"robacc": row["test_mm"], "covered": tool.covered(zeros), "zeros": zeros}


def pooled(rows: list[dict[str, Any]], key: str) -> float:
    """Root mean square over sets."""
    return float(np.sqrt(np.mean([row[key] ** 2 for row in rows])))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print the table and the claims."""
    header = (
        "",
        "sets",
        "nominal",
        "robacc",
        "plain",
        "map",
        "map true",
        "wins over map",
        "zeros hold",
        "all hold",
        "s",
    )
    lines, claims = [], []
    for label, members in tool.groups(rows, lambda row: row["name"].rsplit("-", 1)[0]).items():
        wins = sum(row["robacc"] <= row["map"] for row in members)
        figures = [f"{pooled(members, key):.2f}" for key in ("nominal_mm", *KEYS)]
        shares = [tool.percent(tool.coverage([row[key] for row in members])[0]) for key in ("covered", "covered_all")]
        seconds = f"{tool.median([row['seconds'] for row in members]):.1f}"
        lines.append([label, str(len(members)), *figures, f"{wins}/{len(members)}", *shares, seconds])
        middle, low, high = tool.mean_ratio([row["robacc"] / row["map"] for row in members])
        claims.append(tool.claim(f"{label}: at least as good as map, ratio {middle:.2f}", low, high, (0.0, 1.0)))
    print(tool.table(header, lines))
    print("rms at fresh postures in mm, pooled over sets; hold: share of 95 % intervals that hold the truth")
    print("\n".join(claims))
    return {"table": [header, *lines], "claims": claims}


def main() -> int:
    options = tool.arguments(__doc__, seeds=5).parse_args()
    return tool.run_all(all_names(options), options, run_set, summary, shown)


def shown(row: dict[str, Any]) -> str:
    """One set in a line."""
    figures = ", ".join(f"{key} {row[key]:.2f}" for key in KEYS if key in row)
    return f"{row['name']} {figures} mm, {row['seconds']:.1f} s {row.get('error', '')}"


if __name__ == "__main__":
    sys.exit(main())
