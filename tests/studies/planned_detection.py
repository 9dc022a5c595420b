#!/usr/bin/env python3
"""Are planned detection limits right: is an effect of three times its limit found, and at the limit every second one.

`robacc plan --for trace` plans poses for a six-joint arm and states a detection limit for every effect. A set is one
form of one effect: the arm has it at --times its limit, coefficients of several directions at random, `robacc simulate`
measures the planned poses, and `robacc trace` names the causes. The effect counts as found if it is a finding or a
named alternative of one. Other than in the sibling studies, the tool itself simulates.

A set's name is its design: EFFECT-JOINTS-SETTINGS-sSEED.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import tool
from arm import ARMS, write_robot

ROBOT = """robacc: 1
name: planned arm
convention: standard
units: {length: m, angle: rad}
tool: {xyz: [0.05, 0, 0.12], rpy: [0, 0, 0]}
joints:
  - {name: j1, type: revolute, theta: 0, d: 0.45, a: 0.075, alpha: -1.5707963267948966, limits: [-2.6, 2.6]}
  - {name: j2, type: revolute, theta: -1.5707963267948966, d: 0, a: 0.36, alpha: 0, limits: [-1.0, 1.7]}
  - {name: j3, type: revolute, theta: 0, d: 0, a: 0.09, alpha: -1.5707963267948966, limits: [-2.0, 1.0]}
  - {name: j4, type: revolute, theta: 0, d: 0.38, a: 0, alpha: 1.5707963267948966, limits: [-2.9, 2.9]}
  - {name: j5, type: revolute, theta: 0, d: 0, a: 0, alpha: -1.5707963267948966, limits: [-1.9, 1.9]}
  - {name: j6, type: revolute, theta: 0, d: 0.085, a: 0, alpha: 0, limits: [-2.9, 2.9]}
"""
SKIPPED = ("thermal_expansion", "frame_drift", "joint_warmup", "link_geometry")
"""Their settings depend on the times of a campaign; link_geometry is declared in most campaigns."""


def values(limit: dict[str, Any], size: float, rng: np.random.Generator) -> dict[str, float]:
    """Return the values of an effect by coefficient; of several coefficients, in a random direction."""
    joints, settings = limit["joints"], limit["settings"]
    names = [f"{joint}.{driver}" for joint in joints for driver in settings.get("drivers", [])]
    if "orders" in settings:
        prefixes = [f"{joint}.{tilt}_" for joint in joints for tilt in settings.get("tilts", [])]
        prefixes = prefixes or [f"{joint}." for joint in joints]
        names = [f"{p}{wave}{order:g}" for p in prefixes for order in settings["orders"] for wave in ("cos", "sin")]
    if settings.get("common"):
        names = ["common"]
    names = names or list(joints) or [limit["effect"]]
    direction = rng.normal(size=len(names))
    direction /= np.linalg.norm(direction)
    return {name: float(size * share) for name, share in zip(names, direction, strict=True)}


def set_name(limit: dict[str, Any], seed: int) -> str:
    """Return the name of a set."""
    settings = "+".join(f"{key}{value}" for key, value in limit["settings"].items()).replace(" ", "")
    return f"{limit['effect']}-{'+'.join(limit['joints'])}-{settings}-s{seed}"


def run_set(name: str, limit: dict[str, Any], folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Simulate, trace and judge one set."""
    rng = tool.generator(name)
    entry: dict[str, Any] = {"effect": limit["effect"], **limit["settings"]}
    if limit["joints"]:
        entry["joints"] = limit["joints"]
    entry["values"] = values(limit, options.times * limit["limit"], rng)
    truth, measured = folder / "truth.yaml", folder / "measured.csv"
    truth.write_text(f"{(folder / 'robot.yaml').read_text()}effects:\n  - {json.dumps(entry)}\n")
    words = [*tool.command(options), "simulate", str(truth), "--at", str(folder / "plan.csv"), "--position-only"]
    words += ["--noise", f"{options.noise}mm", "--seed", str(rng.integers(1, 10**6)), "--output", str(measured)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"name": name, "error": done.stderr.strip()[-300:]}
    answer = tool.run(
        [*tool.command(options), "trace", str(measured), "--robot", str(folder / "robot.yaml"), "--ordered"],
        options.limit,
    )
    if answer.result is None:
        return {"name": name, "error": answer.error}
    findings = answer.result["findings"]

    def is_true(found: dict[str, Any]) -> bool:
        return found["effect"] == limit["effect"] and set(limit["joints"]) <= set(found["joints"])

    named = any(is_true(finding) for finding in findings)
    beside = any(is_true(other) for finding in findings for other in finding["alternatives"])
    return {
        "name": name,
        "limit": limit["limit"],
        "rank": len(entry["values"]),
        "named": named,
        "found": named or beside,
        "findings": [f"{f['effect']}[{','.join(f['joints'])}]" for f in findings],
        "seconds": answer.seconds,
    }


def main() -> int:
    """Plan once, then run the sets."""
    parser = tool.arguments(__doc__, 1)
    parser.add_argument("--times", type=float, default=3.0, help="size over the planned limit (default: %(default)s)")
    parser.add_argument("--poses", type=int, default=60)
    parser.add_argument("--noise", type=float, default=0.03, help="mm along each axis (default: %(default)s)")
    parser.add_argument("--arm", choices=list(ARMS), help="arm of the other studies (default: an arm of this one)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = options.keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.yaml").write_text(ROBOT)
        if options.arm:
            write_robot(ARMS[options.arm], folder / "robot.yaml")
        words = [*tool.command(options), "plan", str(folder / "robot.yaml"), "--for", "trace"]
        words += ["--poses", str(options.poses), "--noise", f"{options.noise}mm", "--repeatability", "0mm"]
        words += ["--candidates", "1000", "--output", str(folder / "plan.csv")]
        plan = tool.run(words, options.limit)
        if plan.result is None:
            print(plan.error)
            return 1
        limits = [x for x in plan.result["detection_limits"] if x["limit"] and x["effect"] not in SKIPPED]
        sets = {set_name(limit, seed): limit for limit in limits for seed in tool.seeds_of(options)}
        return tool.run_all(
            list(sets),
            options,
            lambda name, _: run_set(name, sets[name], folder, options),
            lambda rows: summary(rows, options),
        )


def summary(rows: list[dict[str, Any]], options: argparse.Namespace) -> dict[str, Any]:
    """Print how many are found, and the claim."""
    found, named = sum(row["found"] for row in rows), sum(row["named"] for row in rows)
    low, high = tool.wilson(found, len(rows))
    print(f"{found} of {len(rows)} found, {named} named first")
    if options.times == 1.0:
        one = [row for row in rows if row["rank"] == 1]
        print(f"of effects with one coefficient: {sum(row['found'] for row in one)} of {len(one)}")
        print(tool.claim("found at the limit in 35 to 65 %", low, high, (0.35, 0.65)))
    else:
        print(tool.claim(f"found at {options.times:g} limits in at least 95 %", low, high, (0.95, 1.0)))
    return {"found": found / len(rows), "low": low, "high": high}


if __name__ == "__main__":
    sys.exit(main())
