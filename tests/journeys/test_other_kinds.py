"""Measurements that are no positions: sockets, planes, anchors, distances; arm simulated independently."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from commands import run
from independent_arm import DECLARED, LIMITS, robot, target

import robacc
from robacc.api.inputs import with_measured_targets
from robacc.effects.base import effect_class
from robacc.errors import InputError
from robacc.measurements import Measurements
from robacc.modelling.model import Model

# Measurements that are no positions: sockets, planes, anchors, distances; arm simulated independently.

ZEROS = np.array([0.0, 6e-3, -5e-3, 4e-3, 5e-3, 0.0])

"""Errors of the joint zeros, rad."""

NOISE = 1e-5

"""m"""

LOW, HIGH = 0.6 * np.array(LIMITS).T

SOCKETS = {"a": np.array([0.85, -0.2, 0.3]), "b": np.array([0.6, 0.5, 0.35]), "c": np.array([0.7, 0.1, 0.8])}

PLANES = {"table": (np.array([0.05, -0.02, 1.0]), 0.3), "wall": (np.array([1.0, 0.1, 0.05]), 0.9)}

ANCHORS = {"p": np.array([1.2, 0.9, 0.1]), "q": np.array([0.3, -1.1, 0.2])}

Row = dict[str, object]


def reached(gap: Callable[[np.ndarray], np.ndarray], q: np.ndarray, within: float = 1.0) -> np.ndarray | None:
    """Joints near ``q`` at which the ``gap`` of the target's position is zero; None if there are none ``within``."""
    for _ in range(40):
        if np.abs(gap(target(q + ZEROS))).max() < 1e-13:
            break
        slope = np.array([(gap(target(q + ZEROS + e)) - gap(target(q + ZEROS - e))) / 2e-6 for e in 1e-6 * np.eye(6)])
        q = q - np.clip(np.linalg.pinv(slope.T) @ gap(target(q + ZEROS)), -0.2, 0.2)
    is_reached = np.abs(gap(target(q + ZEROS))).max() < 1e-9 and np.all((q > within * LOW) & (q < within * HIGH))
    return q if is_reached else None


def rows_of(kind: str, count: int, generator: np.random.Generator, noise: float = NOISE) -> Iterator[Row]:
    """Rows of a pose file: joints, what they are measured from, and the measured number."""
    start: np.ndarray | None = None
    found = 0
    while found < count:
        q: np.ndarray | None = generator.uniform(LOW, HIGH)
        name, reading = "", float(generator.uniform(-2e-3, 2e-3))
        error = noise * generator.standard_normal()
        row: Row = {"kind": kind, "pose": f"{kind} {found}"}
        if kind == "point":
            name = list(SOCKETS)[found % 3]
            q = reached(lambda p, name=name: p - SOCKETS[name], q)
            row |= {"socket": name}
        elif kind == "plane":
            name = list(PLANES)[found % 2]
            normal, height = PLANES[name]
            unit = normal / np.linalg.norm(normal)
            q = reached(lambda p, unit=unit, height=height, reading=reading: np.array([unit @ p - height - reading]), q)
            row |= {"plane": name, "reading_mm": 1e3 * (reading + error)}
        elif kind == "anchor":
            name = list(ANCHORS)[found % 2]
            row |= {"kind": "distance", "anchor": name}
            row |= {"distance_mm": 1e3 * (np.linalg.norm(target(q + ZEROS) - ANCHORS[name]) + error)}
        elif kind == "from" and found % 2 == 0:
            row, start = {**row, "kind": "distance"}, q
        elif kind == "from":
            length = np.linalg.norm(target(q + ZEROS) - target(start + ZEROS)) + error
            row |= {"kind": "distance", "from": f"from {found - 1}", "distance_mm": 1e3 * length}
        else:
            row |= dict(zip("xyz", target(q + ZEROS) + noise * generator.standard_normal(3), strict=True))
        if q is not None:
            found += 1
            yield {**{f"q{i}": angle for i, angle in enumerate(q, 1)}, **row}


def written(rows: list[Row], path: Path, left_out: str = "") -> Path:
    """Write a pose file of these rows, without one of the columns."""
    names = [name for name in dict.fromkeys(name for row in rows for name in row) if name != left_out]
    lines = [",".join(names), *(",".join(str(row.get(name, "")) for name in names) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("kinds", "elsewhere"),
    [
        ({"point": 48}, 0.25),
        ({"plane": 60}, 0.25),
        ({"anchor": 70}, 0.05),
        ({"from": 160}, 0.05),
        ({"plane": 30, "point": 21, "from": 40}, 0.1),
        ({"position": 20, "plane": 30}, 0.05),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else None,
)
def test_each_kind_shows_the_joint_zeros(kinds: dict[str, int], elsewhere: float, tmp_path: Path) -> None:
    """``elsewhere`` is the share of the nominal error that may remain elsewhere; without lengths the scale does."""
    generator = np.random.default_rng(3)
    rows = [row for kind, count in kinds.items() for row in rows_of(kind, count, generator)]
    one_kind = len({row["kind"] for row in rows}) == 1
    path = written(rows, tmp_path / "poses.csv", "kind" if one_kind else "")
    result = robacc.calibrate(path, robot=robot(), fit=DECLARED)
    assert any("measures a length" in warning for warning in result.warnings) == (
        not {"anchor", "from", "position"} & {*kinds}
    )
    parameters = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        found = parameters[f"joint_offset.j{number}"]
        assert found.std is not None
        assert abs(found.value - ZEROS[number - 1]) < 3.5 * found.std
    assert result.after.held_out.position.rms < 4.0 * NOISE
    q = generator.uniform(LOW, HIGH, (100, 6)).T
    others = Measurements(np.array([target(angles + ZEROS) for angles in q.T]).T, q=q)
    nominal, calibrated = (
        robacc.estimate(others, robot=arm, align="base_frame").position.mean_error for arm in (robot(), result.robot)
    )
    assert calibrated < elsewhere * nominal


def test_exact_sockets_give_exact_zeros_and_planes_their_place(tmp_path: Path) -> None:
    """An arm of no size would reach every socket exactly."""
    generator = np.random.default_rng(4)
    rows = [*rows_of("point", 36, generator, 0.0), *rows_of("plane", 40, generator, 0.0)]
    result = robacc.calibrate(written(rows, tmp_path / "poses.csv"), robot=robot(), fit="tool_frame,joint_offset")
    values = {parameter.name: parameter.value for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        assert values[f"joint_offset.j{number}"] == pytest.approx(ZEROS[number - 1], abs=1e-9)
    for label, coordinate in zip("xyz", SOCKETS["b"], strict=True):
        assert values[f"base_frame.b.{label}"] == pytest.approx(-coordinate, abs=1e-8)
    _, height = PLANES["table"]
    assert values["base_frame.table.z"] == pytest.approx(-height, abs=1e-8)
    assert result.after.held_out.position.rms < 1e-9


def test_trace_names_what_planes_and_anchors_show(tmp_path: Path) -> None:
    """A gear's error of joint 3, 0.5 mrad once and twice a turn, that nobody declared."""
    generator = np.random.default_rng(6)
    rows = []
    for row in [*rows_of("plane", 70, generator), *rows_of("anchor", 70, generator)]:
        # The joint stands where its gear takes it: the commanded angle differs by the gear's error.
        angle = float(row["q3"])
        rows.append({**row, "q3": angle - 5e-4 * np.sin(2.0 * angle + 0.4)})
    result = robacc.trace(written(rows, tmp_path / "poses.csv"), robot=robot(), declared=DECLARED)
    assert ("transmission_error", ("j3",)) in [(finding.effect, finding.joints) for finding in result.findings]
    assert result.after.held_out.position.rms < 0.5 * result.before.held_out.position.rms


def test_derivatives_of_all_kinds_are_those_of_the_predictions() -> None:
    generator = np.random.default_rng(8)
    n = 12
    q = generator.uniform(LOW, HIGH, (n, 6)).T
    kinds = np.array(["position", "point", "plane", "distance"] * 3)
    fixture = np.array(["", "a", "table", "p"] * 2 + ["", "a", "table", ""])
    earlier = Measurements(np.zeros((3, n)), q=generator.uniform(LOW, HIGH, (n, 6)).T)
    data = Measurements(np.zeros((3, n)), q=q, kind=kinds, fixture=fixture, reference=earlier)
    arm, _ = with_measured_targets(robot(), data)
    effects = [effect_class(name).default(Model.of(arm).arm, data) for name in DECLARED.split(",")]
    bound = Model.of(arm, effects).bind(data)
    theta = 1e-3 * generator.standard_normal(len(bound.terms))
    jacobian = bound.linearise(theta, rows=3)[1]
    for column, step in enumerate(1e-6 * np.eye(theta.size)):
        difference = bound.poses(theta + step).translation - bound.poses(theta - step).translation
        np.testing.assert_allclose(jacobian[:, column], difference / 2e-6, atol=1e-8)
    assert not bound.poses(theta).translation[:2, kinds == "plane"].any()


GOOD = "q1,q2,q3,q4,q5,q6,kind,socket,plane,reading_mm,distance_mm,anchor,from,pose,sigma\n"

JOINTS = "0.1,0.2,0.3,0.4,0.5,0.6"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("point,,,,,,,p1,1e-5", "a row of kind point needs socket, found none"),
        ("plane,,t,x,,,,p1,1e-5", "reading_mm: found 'x', expected a number"),
        ("plane,,t,200000,,,,p1,1e-5", "reading_mm: found 200 m, expected"),
        ("distance,,,,12,a,p0,p1,1e-5", "needs anchor or from, found both"),
        ("distance,,,,12,,p9,p1,1e-5", "from: no earlier row is of the pose 'p9'"),
        ("distance,,,,,a,,p1,1e-5", "distance_mm: the value is missing, expected a number"),
        ("plane,,a,0,,,,p1,1e-5", "a is also the name of a socket"),
        ("photo,,,,,,,p1,1e-5", "found 'photo', expected one of position, point, plane, distance"),
        ("point,a,,,,,,p1,0", "sigma: found 0 m, expected"),
    ],
)
def test_a_row_that_lacks_what_its_kind_needs_is_refused(row: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"{GOOD}{JOINTS},point,a,,,,,,p0,1e-5\n{JOINTS},{row}\n")
    with pytest.raises(InputError) as caught:
        robacc.calibrate(path, robot=robot())
    assert message in str(caught.value)
    assert "poses.csv:3" in str(caught.value)


def test_estimate_says_that_the_rows_are_no_positions(tmp_path: Path) -> None:
    rows = list(rows_of("anchor", 5, np.random.default_rng(1)))
    path = written(rows, tmp_path / "poses.csv")
    arm = tmp_path / "arm.yaml"
    robacc.write_robot(arm, robot())
    done = run("estimate", str(path), "--robot", str(arm))
    assert done.exit_code == 3
    assert "the rows are of kind distance, which are no positions" in done.stderr


def test_a_socket_may_have_any_name(tmp_path: Path) -> None:
    rows = list(rows_of("point", 24, np.random.default_rng(2)))
    renamed = [{**row, "socket": f"{row['socket']}."} for row in rows]
    first, second = (
        robacc.calibrate(written(each, tmp_path / f"{i}.csv"), robot=robot(), fit="tool_frame,joint_offset")
        for i, each in enumerate((rows, renamed))
    )
    assert [p.name for p in second.parameters if "a." in p.name] == [
        "base_frame.a..x",
        "base_frame.a..y",
        "base_frame.a..z",
    ]
    assert second.after.fitted.position.rms == pytest.approx(first.after.fitted.position.rms)


# A calibration without an instrument: the tip of the tool rests in sockets of a plate, arm simulated independently.

PLATE = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.0]])

"""Sockets in the frame of the plate, m."""

CORNER, YAW = np.array([0.75, -0.15, 0.3]), 0.4

SCATTER = 3e-5

"""Repeatability of the joints, rad."""


def in_plate(position: np.ndarray) -> np.ndarray:
    c, s = np.cos(YAW), np.sin(YAW)
    return (position - CORNER) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_sockets_give_the_joint_zeros_and_positions_elsewhere() -> None:
    generator = np.random.default_rng(5)
    joints, places = [], []
    while len(joints) < 36:
        place = PLATE[len(joints) % 3]
        q = reached(lambda p, place=place: place - in_plate(p), generator.uniform(LOW, HIGH), 1.6)
        if q is not None:
            joints.append(q + generator.normal(0.0, SCATTER, 6))
            places.append(place)
    result = robacc.calibrate(Measurements(np.array(places).T, q=np.array(joints).T), robot=robot(), fit=DECLARED)
    parameters = {parameter.name: parameter for parameter in result.parameters}
    for number, zero in enumerate(ZEROS[1:5], 2):
        found = parameters[f"joint_offset.j{number}"]
        assert found.std is not None
        assert abs(found.value - zero) < 3.0 * found.std
    q = generator.uniform(LOW, HIGH, (100, 6)).T
    elsewhere = Measurements(np.array([in_plate(target(angles + ZEROS)) for angles in q.T]).T, q=q)
    nominal, calibrated = (
        robacc.estimate(elsewhere, robot=arm, align=frames).position.mean_error
        for arm, frames in ((robot(), "base_frame,tool_frame"), (result.robot, "none"))
    )
    assert nominal > 1e-3
    assert calibrated < 0.25 * nominal
