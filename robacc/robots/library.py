"""Arms that come with the package, and the summary of an arm without measurements."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from robacc.geometry import Array
from robacc.robots.arm import Chain, build_chain, low_discrepancy
from robacc.robots.description import Frame, Robot

_FOLDER = Path(__file__).parents[1] / "data"
_SHOWN = 4
"""Names that a message suggests."""


LibraryArm = Mapping[str, Any]
"""Arm of the package by the keys of the result, with the ``path`` of its robot file, whose stem is its ``name``."""


@cache
def library() -> tuple[LibraryArm, ...]:
    """Return the arms by maker and name."""
    import yaml

    from robacc.io.files import read_text

    text = read_text(_FOLDER / "robots.yaml")
    # The package's own file, so the fast reader is safe.
    entries = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))["robots"]
    return tuple(
        {
            "name": name,
            "maker": entry["maker"],
            "model": entry["name"],
            "n_axes": entry["axes"],
            "reach_m": entry["reach"] * 1e-3,
            "source": entry["source"],
            "path": _FOLDER / "robots" / f"{name}.yaml",
        }
        for name, entry in entries.items()
    )


def find_arm(name: str) -> LibraryArm | None:
    """Return the arm with a name, or with the maker's name of it; capitals, blanks and hyphens do not matter.

    A name that fits several arms stands for none: variants of one arm differ by decimetres.
    """
    wanted = _plain(name)
    matches = [arm for arm in library() if wanted in map(_plain, _names(arm))]
    return matches[0] if len(matches) == 1 else None


def similar_arms(name: str) -> tuple[str, ...]:
    """Return the names of arms that a name may mean, the likeliest first."""
    wanted = _plain(name)
    by_name = {_plain(name): arm["name"] for arm in library() for name in _names(arm)}
    variants = [key for plain, key in by_name.items() if wanted and wanted in plain]
    if variants:
        return tuple(dict.fromkeys(variants))[:_SHOWN]
    near = [by_name[plain] for plain in difflib.get_close_matches(wanted, by_name, _SHOWN, 0.6)]
    return tuple(dict.fromkeys(near))


def _names(arm: LibraryArm) -> tuple[str, str, str]:
    return arm["maker"] + arm["model"], arm["model"], arm["name"]


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


# Summary of an arm without measurements: its reach and its moved mass.

SAMPLES = 8192
"""Joint configurations searched for the reach, before the best is refined."""
_STEPS = 65
"""Positions tried along each joint's range in a step of the refinement."""
_ROUNDS = 4


Reach = Mapping[str, float | None]
"""Greatest distance of a target from the robot's base, m, by the keys of the result.

``sampled_m``, the largest distance of the samples, is the reach or slightly less; ``bound_m``, the sum of the lengths,
the reach or more. None where a prismatic joint has no limits.
"""


def summarise(robot: Robot) -> dict[str, Any]:
    """Return the reach and the moved mass of a robot, by the keys of the result.

    The reach is that of each target; a robot without named targets has the target ``tool``. The mass is that of all
    links that have a mass, kg; None where no link has one.
    """
    targets = dict(robot.targets) or {"tool": robot.tool}
    moved = [branch.joint for branch in robot.branches if robot.carrier(branch) is not None]
    masses = [joint.mass for joint in (*robot.joints, *moved) if joint.mass is not None]
    reach = {name: find_reach(robot, frame) for name, frame in targets.items()}
    return {"moved_mass_kg": sum(masses) if masses else None, "reach": reach}


def find_reach(robot: Robot, target: Frame) -> Reach:
    """Return the reach of a target from the base's origin within the joint limits (one turn for a joint without).

    The best of low-discrepancy samples is improved one joint at a time. The bound adds up the lengths between the axes,
    each prismatic joint at its longest.
    """
    chain = build_chain(replace(robot, base=Frame(), tool=target))
    if any(joint.type == "prismatic" and joint.limits is None for joint in robot.variables):
        return {"sampled_m": None, "bound_m": None}
    low, high = np.array([joint.limits or (-np.pi, np.pi) for joint in robot.variables]).T
    q = low[:, None] + (high - low)[:, None] * low_discrepancy(low.size, SAMPLES)
    best = q[:, [int(np.argmax(_distance(chain, q)))]]
    for _ in range(_ROUNDS):
        for i in range(low.size):
            trial = np.repeat(best, _STEPS + 1, axis=1)
            # The best so far stays among the trials, so a step never reduces the reach.
            trial[i, 1:] = np.linspace(low[i], high[i], _STEPS)
            best = trial[:, [int(np.argmax(_distance(chain, trial)))]]
    travel: dict[int, list[float]] = {}
    for drive in chain.drives:
        limits = sorted(drive.coefficient * float(value) for value in (low[drive.joint], high[drive.joint]))
        ends = travel.get(drive.motion, [0.0, 0.0])
        travel[drive.motion] = [end + limit for end, limit in zip(ends, limits, strict=True)]
    total, run = 0.0, np.zeros(3)
    for k, motion in enumerate(chain.motions):
        if motion.kind == "translation":
            run[motion.axis] += max(abs(motion.value + limit) for limit in travel.get(k, [0.0]))
        elif motion.value != 0.0 or k in travel:
            total, run = total + float(np.hypot.reduce(run)), np.zeros(3)
    return {"sampled_m": float(_distance(chain, best)[0]), "bound_m": total + float(np.hypot.reduce(run))}


def _distance(chain: Chain, q: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(np.square(chain.forward(q).translation), axis=0)))
