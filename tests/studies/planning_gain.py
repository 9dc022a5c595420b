#!/usr/bin/env python3
"""Where is planning worth most: predicted error of planned over random poses, by arm, model and candidates.

`robacc plan` states both for the same candidates. `planned_poses.py` computes the ratio for the geometry independently;
`tests/planning/test_realised.py` compares the predictions with fits.
"""

import argparse
import statistics
import sys
from typing import Any

import tool
from arm import ARMS, write_robot

FRAMES = "base_frame,tool_frame"
GEOMETRY = f"{FRAMES},joint_offset,link_geometry"
SIGHT = ("--instrument", "2.5,0,0.8", "--reflector", "0,0,1", "--cone")
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "frames": (FRAMES, ("--poses", "10")),
    "frames, zeros": (f"{FRAMES},joint_offset", ("--poses", "15")),
    "geometry, 15 poses": (GEOMETRY, ("--poses", "15")),
    "geometry, 20 poses": (GEOMETRY, ("--poses", "20")),
    "geometry": (GEOMETRY, ("--poses", "30")),
    "geometry, 60 poses": (GEOMETRY, ("--poses", "60")),
    "geometry, reflector": (GEOMETRY, ("--poses", "30", *SIGHT, "40deg")),
    "geometry, box": (GEOMETRY, ("--poses", "30", "--inside", "x=0.3:0.9,y=-0.4:0.4,z=0.1:1")),
    "and compliance": (f"{GEOMETRY},joint_compliance", ("--poses", "30")),
    "and payload": (f"{GEOMETRY},payload_compliance", ("--poses", "30", "--payload", "0,5")),
    "and orders 1, 2": (f"{GEOMETRY},transmission_error", ("--poses", "40")),
    "and backlash": (f"{GEOMETRY},backlash", ("--poses", "30")),
}


def run_case(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Plan one case on one arm."""
    arm, case = name.split(", ", 1)
    fit, words = CASES[case]
    with tool.folder_of(name, options) as folder:
        write_robot(ARMS[arm], folder / "robot.yaml")
        command = [*tool.command(options), "plan", str(folder / "robot.yaml"), "--fit", fit, *words]
        answer = tool.run([*command, "--candidates", "1000", "--output", str(folder / "plan.csv")], options.limit)
    if answer.result is None or answer.result["accuracy"]["planned"] is None:
        return {"name": name, "error": answer.error}
    planned = answer.result["accuracy"]["planned"]
    ratio = None if planned["random_rms_m"] is None else planned["rms_m"] / planned["random_rms_m"]
    return {"name": name, "arm": arm, "case": case, "ratio": ratio}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print the table."""
    done = {(row["arm"], row["case"]): row["ratio"] for row in rows}
    arms = list(dict.fromkeys(arm for arm, _ in done))
    table = []
    for case in CASES:
        values = [done.get((arm, case)) for arm in arms]
        known = [value for value in values if value is not None]
        if known:
            cells = ["–" if value is None else f"{value:.2f}" for value in values]
            table.append((case, *cells, f"{statistics.mean(known):.2f}"))
    print(tool.table(("case", *arms, "mean"), table))
    return {}


def main() -> int:
    options = tool.arguments(__doc__, 1).parse_args()
    return tool.run_all([f"{name}, {case}" for name in ARMS for case in CASES], options, run_case, summary)


if __name__ == "__main__":
    sys.exit(main())
