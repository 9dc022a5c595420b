"""Arms and made-up circumstances that several test modules share."""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np

from robacc import Measurements, Robot, read_robot
from robacc.effects import REGISTRY
from robacc.effects.specification import build, parse_requests
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Frame
from robacc.robots.urdf import parse_urdf
from robacc_plugins.urdf import robot_to_urdf

CONFIGS = Path(__file__).resolve().parents[1] / "configs" / "robots"
CONFIGURED = tuple(sorted(path.stem for path in CONFIGS.glob("*.yaml")))
TOOL = Frame((0.05, 0.02, 0.1), (0.1, -0.2, 0.3))
"""Off the last axis, so that every joint moves the target."""


@cache
def arm(name: str) -> Arm:
    """An arm of ``configs/robots`` with a tool off its axis; ``urdf:`` in front: the same as URDF; ``targets:`` two."""
    kind, _, stem = name.rpartition(":")
    robot = dataclasses.replace(read_robot(CONFIGS / f"{stem}.yaml"), tool=TOOL, effect_units=(1.0, 1.0))
    if kind == "urdf":
        robot = parse_urdf(robot_to_urdf(robot)[0], f"{stem}.urdf")
    if kind == "targets":
        robot = dataclasses.replace(robot, tool=Frame(), targets={"a": TOOL, "b": Frame((0.0, -0.06, 0.12))})
    return Arm.of(robot)


def suited(effect: str, one: Arm) -> Arm:
    """Return ``one``, or the arm with a slide where the effect cannot act on any joint of it."""
    cls = REGISTRY[effect]
    return arm("stanford") if cls.traits.per_joint and not cls.possible_joints(one) else one


def circumstances(robot: Robot, n: int, seed: int = 0) -> Measurements:
    """``n`` poses with every column, all varying."""
    rng = np.random.default_rng(seed)
    low, high = np.array([joint.limits or (-np.pi, np.pi) for joint in robot.variables]).T[..., None]
    shape = (len(robot.variables), n)
    q = rng.uniform(low, high, size=shape)
    return Measurements(
        position=np.zeros((3, n)),
        q=q,
        target=rng.choice(list(robot.targets), n) if robot.targets else None,
        time=rng.uniform(0, 3600, n),
        temperature=rng.uniform(18, 30, n),
        payload=rng.choice([0.0, 2.0, 5.0], n),
        direction=rng.choice([-1.0, 1.0], shape),
        speed=rng.uniform(-1, 1, shape),
        read_back=q + rng.normal(scale=3e-4, size=shape),
    )


def model_of(robot: Robot, asked: str, data: Measurements) -> Model:
    """Return the model of a robot whose free effects are asked for as ``--fit`` names them."""
    return Model.of(robot, build(parse_requests(asked), Arm.of(robot), data))
