#!/usr/bin/env python3
"""Where is planning worth most: predicted error of planned over random poses, by arm, model and candidates.

`robacc plan` states both for the same candidates. `planned_poses.py` computes the ratio for the geometry independently;
`tests/planning/test_realised.py` compares the predictions with fits.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

import tool
from arm import ARMS, Setup

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


def run_case(name: str, case: str, options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Plan one case on one arm."""
    fit, words = CASES[case]
    setup = Setup(ARMS[name])
    setup.write(folder / "robot.yaml")
    command = [*tool.command(options), "plan", str(folder / "robot.yaml"), "--fit", fit, *words, "--candidates", "1000"]
    answer = tool.run([*command, "--output", str(folder / "plan.csv")], options.limit)
    if answer.result is None or answer.result["accuracy"]["planned"] is None:
        return {"name": f"{name}, {case}", "error": answer.error}
    planned = answer.result["accuracy"]["planned"]
    return {
        "name": f"{name}, {case}",
        "arm": name,
        "case": case,
        "ratio": None if planned["random_rms_m"] is None else planned["rms_m"] / planned["random_rms_m"],
        "error": None,
    }


def main() -> int:
    """Print the table."""
    parser = tool.arguments(__doc__, 1)
    options = parser.parse_args()
    names = tool.chosen([f"{name}, {case}" for name in ARMS for case in CASES], options)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            rows.append(run_case(*name.split(", ", 1), options, Path(folder)))
            if options.v:
                print(rows[-1], flush=True)
    done = {(row["arm"], row["case"]): row["ratio"] for row in rows if not row["error"]}
    arms = list(dict.fromkeys(arm for arm, _ in done))
    table = []
    for case in CASES:
        values = [done.get((arm, case)) for arm in arms]
        known = [value for value in values if value is not None]
        if known:
            cells = ["–" if value is None else f"{value:.2f}" for value in values]
            table.append((case, *cells, f"{statistics.mean(known):.2f}"))
    print(tool.table(("case", *arms, "mean"), table))
    return tool.finish(options, {}, rows)


if __name__ == "__main__":
    sys.exit(main())
