"""Which conditions of the standard's protocol are met, not met, unknown, and why."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from robacc.accuracy.estimation import commanded_poses
from robacc.iso_9283.criteria import characteristic, drift, repeatability, visits_of
from robacc.iso_9283.evaluation import five_points, iso9283, protocol
from robacc.measurements import Measurements, motion_between_rows
from robacc.robots.description import Frame, Robot


def cycles(n: int = 30, points: np.ndarray | None = None, **columns: Any) -> Measurements:
    """Visits of five points in turn, by default those of a cube of 630 mm."""
    points = five_points(np.array([0.6, 0.0, 0.5]), 0.63, "x-") if points is None else points
    index = np.tile(np.arange(points.shape[1]), n)
    noise = np.random.default_rng(7).normal(scale=2e-5, size=(3, index.size))
    base = Measurements(
        position=points[:, index] + noise,
        commanded_position=points[:, index],
        pose=np.array([f"P{i + 1}" for i in index]),
    )
    return dataclasses.replace(base, **columns)


def condition(name: str, data: Measurements, rated_load: float | None = None) -> Mapping[str, str]:
    """One condition, without the criteria that it does not look at."""
    commanded = data.commanded_position
    poses = visits_of(data, (None, None) if commanded is None else commanded_poses(data, None), "poses.csv", 0)
    repeated = repeatability(poses, 0.95, 0) if name == "measuring uncertainty" else characteristic("RP", [], 0.95, "")
    shift = drift(poses, 0.95, 0)[2] if name == "warm-up" else characteristic("shift", [], 0.95, "")
    return next(
        entry for entry in protocol([data], poses, None, repeated, shift, rated_load) if entry["condition"] == name
    )


N = 150
ONES = np.ones(N)


Q = np.tile(np.arange(5.0), 30)[None] * np.array([[0.1], [0.2]])
IN_ORDER = dict(zip(("direction", "speed"), motion_between_rows(Q), strict=True), q=Q)
FEW = cycles(4, points=np.random.default_rng(0).uniform(0, 1, (3, 6)))
UPRIGHT = cycles(3, points=np.array([[0, 1, 1, -1, -1], [0, 1, 1, -1, -1], [0, 1, -1, -1, 1]]) * 0.2)
UNKNOWN = cycles(commanded_position=None)
SIZES = "10 % in a cube of 500 mm, not a preferred size; the preferred edges are 250, 400, 630, 1000 mm"


@pytest.mark.parametrize(
    ("name", "columns", "status", "why"),
    [
        ("temperature", {}, "unknown", "no column temperature_c"),
        ("temperature", {"temperature": np.linspace(19, 21, N)}, "met", "19.0 °C to 21.0 °C, within 20 °C ± 2 °C"),
        (
            "temperature",
            {"temperature": np.linspace(24, 26, N)},
            "met",
            "constant within ± 2 °C but not at 20 °C; state it",
        ),
        ("temperature", {"temperature": np.linspace(20, 25, N)}, "not_met", "varies by more than ± 2 °C"),
        ("measuring uncertainty", {}, "unknown", "no columns sigma_x"),
        ("measuring uncertainty", {"sigma_position": np.full((3, N), 1e-6)}, "met", "at most 25 % is allowed"),
        ("measuring uncertainty", {"sigma_position": np.full((3, N), 2e-5)}, "not_met", "of the smallest RP"),
        ("rated load", {}, "unknown", "no column payload_kg"),
        ("rated load", {"payload": 5 * ONES}, "unknown", "5 kg throughout; give `rated_load` to compare"),
        ("rated load", {"payload": np.linspace(1, 5, N)}, "not_met", "varies from 1 kg to 5 kg"),
        ("rated velocity", {}, "unknown", "no speed columns"),
        ("rated velocity", {"speed": np.zeros((2, N))}, "unknown", "every speed is 0"),
        ("rated velocity", {"speed": np.vstack((-ONES, 0.3 * ONES))}, "met", "the fastest joint's last motion: 100 %"),
        ("rated velocity", {"speed": np.full((2, N), 0.5)}, "met", "50 %, an optional step"),
        ("rated velocity", {"speed": np.full((2, N), 0.1)}, "met", "10 %, an optional step"),
        (
            "rated velocity",
            {"speed": np.full((2, N), 0.3)},
            "not_met",
            "30 %; the standard requires 100 %; optional steps are 50 %, 10 %",
        ),
        ("rated velocity", {"speed": np.linspace(0.2, 1, N)[None]}, "not_met", "varies from 20 % to 100 %"),
        ("one approach", {}, "unknown", "approach directions are not known"),
        ("one approach", {"direction": np.ones((2, N))}, "met", "has the same approach direction"),
        ("five poses", {}, "met", "5 commanded poses"),
        ("diagonal plane", {}, "met", "P1 is the centre, and the plane rises at 45° towards x-"),
        ("10 % from the corners", {}, "met", "10.0 % in a cube of 630 mm"),
        ("30 cycles", {}, "met", "30 visits of each commanded pose"),
        ("stabilisation", {}, "unknown", "the time between arrival and measurement is not recorded"),
        ("warm-up", {}, "unknown", "the warm-up is not recorded"),
        ("rated load, 5 kg", {"payload": 5 * ONES}, "met", "5 kg of 5 kg: 100 %"),
        (
            "rated load, 50 kg",
            {"payload": 5 * ONES},
            "met",
            "10 %, an optional step; a test at 100 % load is needed too",
        ),
        (
            "rated load, 10 kg",
            {"payload": 5 * ONES},
            "not_met",
            "50 %; the standard requires 100 %; optional steps are 10 %",
        ),
        ("rated velocity", cycles(**IN_ORDER), "unknown", "they are relative, not absolute"),
        ("one approach", cycles(**IN_ORDER), "met", "has the same approach direction"),
        (
            "one approach",
            cycles(direction=np.where(np.arange(N) < 75, 1.0, -1.0)[None]),
            "not_met",
            "P1, P2, P3 … approached from several directions: AP and RP include vAP",
        ),
        ("30 cycles", FEW, "not_met", "4 visits of each commanded pose"),
        ("30 cycles", cycles(4).subset(np.arange(19)), "not_met", "3 to 4 visits of a commanded pose"),
        ("five poses", FEW, "not_met", "6 commanded poses"),
        ("diagonal plane", FEW, "not_met", "needs five commanded poses"),
        ("diagonal plane", UPRIGHT, "not_met", "the diagonal plane is upright"),
        ("10 % from the corners", UPRIGHT, "unknown", SIZES),
        ("diagonal plane", UNKNOWN, "unknown", "the commanded positions are not known"),
        ("10 % from the corners", UNKNOWN, "unknown", "the commanded positions are not known"),
        (
            "warm-up",
            cycles(position=cycles().position + np.linspace(0, 3e-4, N)),
            "unknown",
            "moved 0.3",
        ),
        (
            "measuring uncertainty",
            cycles(1, sigma_position=np.full((3, 5), 1e-6)),
            "unknown",
            "there is no RP to compare it with",
        ),
    ],
)
def test_conditions(name: str, columns: dict[str, Any] | Measurements, status: str, why: str) -> None:
    name, _, rated = name.partition(", ")
    data = cycles(**columns) if isinstance(columns, dict) else columns
    result = condition(name, data, float(rated.removesuffix(" kg")) if rated else None)
    assert result["status"] == status
    assert why in result["why"]


def test_a_plane_is_judged_in_the_axes_of_the_base() -> None:
    """The base is turned in the measuring frame: in its axes the five poses are a cube, in the frame's they are not."""
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    data = cycles(3, points=turn @ five_points(np.array([0.6, 0.0, 0.5]), 0.63, "x-"))
    assert "not parallel to the axes of the base" in condition("diagonal plane", data)["why"]
    robot = Robot("turned", "standard", (), base=Frame((0.1, 0.2, 0.3), (0, 0, 0.3)))
    poses = visits_of(data, commanded_poses(data, None), "poses.csv", 0)
    conditions = protocol(
        [data], poses, robot, characteristic("RP", [], 0.95, ""), characteristic("shift", [], 0.95, ""), None
    )
    assert next(entry for entry in conditions if entry["condition"] == "diagonal plane")["status"] == "met"


def test_several_files_are_judged_together() -> None:
    warm, unknown = cycles(temperature=20 * ONES), cycles()
    conditions = {entry["condition"]: entry for entry in iso9283([warm, unknown]).protocol}
    assert conditions["temperature"]["status"] == "unknown"
    assert conditions["five poses"]["status"] == "met"
