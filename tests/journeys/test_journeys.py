"""Journeys of new users, command by command, with positions, photos of boards and other kinds of measurements."""

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from commands import missing, run
from homogeneous import shift, turn
from independent_arm import DECLARED, LIMITS, link_frames, robot, target, targets
from refusals import problems_of
from sample_files import saved

import robacc
from robacc.api.inputs import with_measured_targets
from robacc.diagnostics.robot_poses import read_rows
from robacc.effects.base import effect_class
from robacc.errors import InputError
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.poses.reading import PoseFile
from robacc.robots.description import Fixture, Frame
from robacc_plugins.cameras import three_points

# Measurements that are no positions: sockets, planes, anchors, distances; arm simulated independently.
ZEROS = np.array([0.0, 4e-3, -3e-3, 3e-3, 4e-3, 0.0])
"""Errors of the joint zeros, rad."""
NOISE = 1e-5
"""m"""
LOW, HIGH = 0.6 * np.array(LIMITS).T
SOCKETS = {"a": np.array([0.85, -0.2, 0.3]), "b": np.array([0.6, 0.5, 0.35]), "c": np.array([0.7, 0.1, 0.8])}
PLANES = {"table": (np.array([0.05, -0.02, 1.0]), 0.3), "wall": (np.array([1.0, 0.1, 0.05]), 0.9)}
LINES = {
    "edge": (np.array([0.7, 0.0, 0.4]), np.array([0.1, 1.0, 0.05])),
    "rail": (np.array([0.6, 0.3, 0.6]), np.array([1.0, -0.3, 0.4])),
}
SPHERES = {"ball": (np.array([0.8, 0.1, 0.5]), 0.03), "dome": (np.array([0.5, -0.5, 0.4]), 0.15)}
"""Centre and radius, m."""
ANCHORS = {"p": np.array([1.2, 0.9, 0.1]), "q": np.array([0.3, -1.1, 0.2])}
Row = dict[str, object]


FIXTURES = {"point": SOCKETS, "plane": PLANES, "line": LINES, "sphere": SPHERES, "gauge": SPHERES, "anchor": ANCHORS}
Gap = Callable[[np.ndarray, np.ndarray], np.ndarray]


def gap_of(kind: str, name: str) -> Gap:
    """How far targets (..., N, 3) are from what the tip touches, beyond readings or errors (N, 2)."""
    if kind == "point":
        return lambda p, off: p - SOCKETS[name]
    if kind == "plane":
        normal, height = PLANES[name]
        unit = normal / np.linalg.norm(normal)
        return lambda p, off: (p @ unit)[..., None] - height - off[:, :1]
    if kind == "line":
        place, along = LINES[name]
        across = np.linalg.svd(along[None])[2][1:]
        return lambda p, off: (p - place) @ across.T - off
    centre, radius = SPHERES[name]
    return lambda p, off: np.linalg.norm(p - centre, axis=-1, keepdims=True) - radius - off[:, :1]


STEPS = 1e-6 * np.hstack((np.zeros((6, 1)), np.eye(6)))[..., None]


def reached(gap: Gap, starts: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Joints (6, N) from ``starts`` (6, N), and the largest gap there (N,): Newton's method within the range."""
    q = starts
    for _ in range(20):
        here, *beside = gap(target(q[:, None] + ZEROS[:, None, None] + STEPS), off)
        slope = (np.array(beside) - here) / 1e-6
        step = np.linalg.pinv(np.moveaxis(slope, 0, 2)) @ here[..., None]
        q = np.clip(q - np.clip(step[..., 0].T, -0.2, 0.2), LOW[:, None], HIGH[:, None])
    return np.vstack((q, np.abs(gap(target(q + ZEROS[:, None]), off)).max(axis=1)))


def touching(kind: str, name: str, count: int, noise: float, generator: np.random.Generator) -> np.ndarray:
    """Joints that touch a fixture, and the readings or errors there, (count, 8)."""
    gap, found = gap_of(kind, name), np.empty((0, 8))
    while len(found) < count:
        off = noise * generator.standard_normal((2 * count, 2))
        if kind in ("plane", "gauge"):
            off = generator.uniform(-2e-3, 2e-3, (2 * count, 2))
        q = reached(gap, generator.uniform(LOW, HIGH, (2 * count, 6)).T, off)
        found = np.vstack((found, np.hstack((q[:6].T, off))[q[6] < 1e-9]))
    return found[:count]


def rows_of(kind: str, count: int, generator: np.random.Generator, noise: float = NOISE) -> list[Row]:
    """Rows of a pose file: joints, what they are measured from, and the measured number."""
    q, off = generator.uniform(LOW, HIGH, (count, 6)), np.zeros((count, 2))
    names = [*FIXTURES.get(kind, [""])]
    if kind in ("point", "plane", "line", "sphere", "gauge"):
        for i, name in enumerate(names):
            each = slice(i, None, len(names))
            found = touching(kind, name, len(q[each]), noise, generator)
            q[each], off[each] = found[:, :6], found[:, 6:]
    places, errors = target(q.T + ZEROS[:, None]), noise * generator.standard_normal((count, 3))
    rows = []
    for i, (place, error) in enumerate(zip(places, errors, strict=True)):
        name, reading = names[i % len(names)], 1e3 * (off[i, 0] + error[0])
        row: Row = {**{f"q{joint}": angle for joint, angle in enumerate(q[i], 1)}, "kind": kind, "pose": f"{kind} {i}"}
        if kind == "point":
            row |= {"socket": name}
        elif kind == "plane":
            row |= {"plane": name, "reading_mm": reading}
        elif kind == "gauge":
            row |= {"kind": "sphere", "sphere": name, "reading_mm": reading, "radius_mm": 1e3 * SPHERES[name][1]}
        elif kind in ("line", "sphere"):
            row |= {kind: name}
        elif kind == "anchor":
            length = np.linalg.norm(place - ANCHORS[name]) + error[0]
            row |= {"kind": "distance", "anchor": name, "distance_mm": 1e3 * length}
        elif kind == "from":
            row |= {"kind": "distance"}
            if i % 2:
                length = np.linalg.norm(place - places[i - 1]) + error[0]
                row |= {"from": f"from {i - 1}", "distance_mm": 1e3 * length}
        else:
            row |= dict(zip("xyz", place + error, strict=True))
        rows.append(row)
    return rows


def written(rows: list[Row], path: Path, left_out: str = "") -> Path:
    """Write a pose file of these rows, without one of the columns."""
    names = [name for name in dict.fromkeys(name for row in rows for name in row) if name != left_out]
    lines = [",".join(names), *(",".join(str(row.get(name, "")) for name in names) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def values_of(result: robacc.Calibrated) -> dict[str, float]:
    """Coefficients by name."""
    return {parameter.name: parameter.value for parameter in result.parameters}


def zeros_of(values: dict[str, float]) -> list[float]:
    """Zeros of the joints that any measurement of the target shows, rad."""
    return [values[f"joint_offset.j{number}"] for number in (2, 3, 4, 5)]


@pytest.mark.parametrize(
    ("kinds", "elsewhere"),
    [
        ({"point": 48}, 0.25),
        ({"plane": 60}, 0.25),
        ({"line": 48}, 0.25),
        ({"sphere": 70}, 0.25),
        ({"gauge": 90}, 0.1),
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
        not {"anchor", "from", "position", "gauge"} & {*kinds}
    )
    parameters = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        found = parameters[f"joint_offset.j{number}"]
        assert abs(found.value - ZEROS[number - 1]) < 3.5 * found.std
    assert result.after.held_out.position.rms < 4.0 * NOISE
    # What each kind brought sums to the coefficients less what priors determine.
    shares, fit = result.fit.information(), result.fit
    assert shares.keys() == (set() if one_kind else {"distance" if "radius_mm" in row else row["kind"] for row in rows})
    if shares:
        known = np.trace(np.linalg.solve(fit.gram + np.diag(fit.precision), fit.gram))
        assert sum(shares.values()) == pytest.approx(known, rel=5e-3)  # the last step is not in its matrix
        assert min(shares.values()) > 1.0
        assert f"of each kind of measurement: {max(shares, key=shares.get)} " in str(result.view())
    q = generator.uniform(LOW, HIGH, (100, 6)).T
    others = Measurements(targets(q + ZEROS[:, None]), q=q)
    nominal, calibrated = (
        robacc.estimate(others, robot=arm, align="base_frame").position.mean_error for arm in (robot(), result.robot)
    )
    assert calibrated < elsewhere * nominal


def test_a_gauge_on_a_cube_along_the_axes_of_the_base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readings within 2 mm, on faces whose normals are axes of the base, show an arm whose tool is 20 mm off."""
    cube = {name: (axis, height) for name, axis, height in zip("xyz", np.eye(3), (0.7, 0.1, 0.3), strict=True)}
    monkeypatch.setitem(globals(), "PLANES", cube)
    monkeypatch.setitem(FIXTURES, "plane", cube)
    generator = np.random.default_rng(0)
    rows = rows_of("plane", 42, generator) + rows_of("position", 20, generator)
    x, y, z = robot().tool.xyz
    arm = dataclasses.replace(robot(), tool=Frame((x, y, z - 0.02)))
    result = robacc.calibrate(written(rows, tmp_path / "poses.csv"), robot=arm, fit=DECLARED)
    assert not result.fit.outliers.size
    assert result.after.held_out.position.rms < 4.0 * NOISE


def test_rows_of_several_kinds_show_no_less_than_those_of_one(tmp_path: Path) -> None:
    """Standard errors of joint zeros: of lines, of spheres, and of both, at the same stated noise."""
    generator = np.random.default_rng(5)
    of_kind = {kind: [row | {"sigma": NOISE} for row in rows_of(kind, 40, generator)] for kind in ("line", "sphere")}
    stds = [
        [p.std for p in calibrated.parameters if p.name.startswith("joint_offset")]
        for number, rows in enumerate((*of_kind.values(), [*of_kind["line"], *of_kind["sphere"]]))
        for path in [written(rows, tmp_path / f"{number}.csv")]
        for calibrated in [robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset")]
    ]
    for of_line, of_sphere, of_both in zip(*stds, strict=True):
        if of_both is not None:  # not identifiable from any
            assert of_both <= 1.02 * min(of_line or math.inf, of_sphere or math.inf)
    assert sum(std is not None for std in stds[2]) >= 4


def test_a_sphere_has_a_radius_in_all_rows_or_in_none(tmp_path: Path) -> None:
    row = f"{JOINTS},s"
    path = saved(tmp_path / "poses.csv", f"q1,q2,q3,q4,q5,q6,sphere,radius_mm\n{row},20\n{row},\n")
    assert (
        missing("\n".join(problems_of(robacc.calibrate, path, robot=robot())), "poses.csv:3", "radius_mm: other rows")
        == []
    )


def with_read_joints(rows: Iterable[Row], generator: np.random.Generator) -> list[Row]:
    """Rows with joints as encoders read them."""
    return [
        row | {f"q{i}": float(row[f"q{i}"]) + 5e-5 * generator.standard_normal() for i in range(1, 7)} for row in rows
    ]


def test_poses_in_another_socket_cost_only_themselves(tmp_path: Path) -> None:
    """The tool is unknown by 0.2 m, and link lengths are fitted, as nobody chose effects."""
    generator = np.random.default_rng(12)
    rows = with_read_joints(rows_of("point", 60, generator), generator)
    mistaken = {7: "c", 31: "c", 44: "a"}
    told = [{**row, "socket": mistaken.get(number, row["socket"])} for number, row in enumerate(rows)]
    arm = dataclasses.replace(robot(), tool=Frame((0.1, -0.1, 0.3)))
    fits = [
        robacc.calibrate(written(each, tmp_path / f"{name}.csv", "kind"), robot=arm)
        for name, each in (("right", rows), ("told", told))
    ]
    assert np.flatnonzero(~fits[1].fit.inliers).tolist() == [*mistaken]
    assert any("3 rows, on lines 9, 33, 46" in warning for warning in fits[1].warnings)
    right, other = fits[0].after.held_out.position.rms, fits[1].after.held_out_inliers.position.rms
    assert other < 1.3 * right < 3e-4
    values = [{each.name: each for each in result.parameters} for result in fits]
    for name in (f"joint_offset.j{number}" for number in (2, 3, 4, 5)):
        assert values[1][name].value == pytest.approx(values[0][name].value, abs=3.0 * values[0][name].std)


def test_a_folder_with_a_table_of_joints_for_each_socket(tmp_path: Path) -> None:
    """As MUKCa records them: no header, a file for each socket, and beside it what the controller says of the hand."""
    generator = np.random.default_rng(14)
    rows = with_read_joints(rows_of("point", 45, generator), generator)
    folder = tmp_path / "front"
    folder.mkdir()
    for socket in SOCKETS:
        joints = np.array([[row[f"q{i}"] for i in range(1, 7)] for row in rows if row["socket"] == socket])
        np.savetxt(folder / f"hole_{socket}.csv", joints, delimiter=",")
        turned = np.tile([0.0, 0.6, 0.0, 0.8], (len(joints), 1))
        np.savetxt(folder / f"hole_{socket}_pose.csv", np.hstack((joints[:, :3], turned)), delimiter=",")
    (folder / "comments.txt").write_text("ball of 20 mm\n")
    bad = np.loadtxt(folder / "hole_b.csv", delimiter=",")
    bad[4, 2] += 0.1
    np.savetxt(folder / "hole_b.csv", bad, delimiter=",")
    result = robacc.calibrate(folder, robot=robot(), fit=DECLARED)
    warnings = "\n".join(result.warnings)
    assert "each file is a socket: hole_a (15 poses), hole_b (15 poses), hole_c (15 poses); not read" in warnings
    assert "outliers left out of the fit: 1 row, on pose hole_b:5" in warnings
    assert result.after.held_out_inliers.position.rms < 3e-4
    (folder / "hole_b.csv").write_text("1,2,3,4,5\n")
    with pytest.raises(InputError, match=r"hole_b: has the columns q1, q2, q3, q4, q5, expected q1, .* as hole_a has"):
        robacc.calibrate(folder, robot=robot(), fit=DECLARED)


def test_sockets_in_the_forms_that_programs_write(tmp_path: Path) -> None:
    generator = np.random.default_rng(16)
    rows = with_read_joints(rows_of("point", 45, generator), generator)
    joints = np.array([[float(row[f"q{i}"]) for i in range(1, 7)] for row in rows])
    names = [str(row["socket"]) for row in rows]
    lists = list(zip(joints.tolist(), names, strict=True))
    degrees = (
        ",".join([*map(repr, np.degrees(q).tolist()), f"hole {name}"]) for q, name in zip(joints, names, strict=True)
    )
    forms = {
        "records.json": json.dumps([{"joints": q, "socket": name} for q, name in lists]),
        "states.yaml": "".join(f"- {{positions: {q}, hole_id: {name}}}\n" for q, name in lists),
        "groups.json": json.dumps({f"hole_{key}": [q for q, name in lists if name == key] for key in SOCKETS}),
        "degrees.csv": "\n".join(["j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg,Hole", *degrees]) + "\n",
    }
    order = {"groups.json": sorted(range(len(names)), key=names.__getitem__)}
    for file, text in forms.items():
        data = read_rows(str(saved(tmp_path / file, text)), robot(), planned_kinds=True)
        rows_of_file = order.get(file, [*range(len(names))])
        np.testing.assert_allclose(data.q.T, joints[rows_of_file], atol=1e-12)
        assert [name[-1] for name in data.fixture] == [names[row] for row in rows_of_file], file


def test_joints_alone_are_no_calibration(tmp_path: Path) -> None:
    rows = [{**row, "point": row["socket"]} for row in rows_of("point", 12, np.random.default_rng(2))]
    path = written(
        [{key: row[key] for key in row if key[0] == "q" or key == "point"} for row in rows], tmp_path / "a.csv"
    )
    with pytest.raises(InputError, match=r"x, y, z are missing; expected .*, or of other measurements socket, plane"):
        robacc.calibrate(path, robot=robot())


def test_exact_rows_give_exact_zeros_and_the_place_of_planes_and_spheres(tmp_path: Path) -> None:
    """An arm of no size would reach every socket exactly."""
    generator = np.random.default_rng(4)
    rows = [
        *rows_of("point", 36, generator, 0.0),
        *rows_of("plane", 40, generator, 0.0),
        *rows_of("sphere", 40, generator, 0.0),
    ]
    result = robacc.calibrate(written(rows, tmp_path / "poses.csv"), robot=robot(), fit="tool_frame,joint_offset")
    values = values_of(result)
    assert zeros_of(values) == pytest.approx(ZEROS[1:5], abs=1e-9)
    for label, coordinate in zip("xyz", SPHERES["dome"][0], strict=True):
        assert values[f"base_frame.dome.{label}"] == pytest.approx(-coordinate, abs=1e-8)
    assert values["base_frame.dome.radius"] == pytest.approx(SPHERES["dome"][1], abs=1e-8)
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
    n = 18
    q = generator.uniform(LOW, HIGH, (n, 6)).T
    kinds = np.array(["position", "point", "plane", "line", "sphere", "distance"] * 3)
    fixture = np.array(["", "a", "table", "edge", "ball", "p"] * 2 + ["", "a", "table", "edge", "dome", ""])
    earlier = Measurements(np.zeros((3, n)), q=generator.uniform(LOW, HIGH, (n, 6)).T)
    data = Measurements(np.zeros((3, n)), q=q, kind=kinds, fixture=fixture, reference=earlier)
    arm, _ = with_measured_targets(robot(), data)
    arm = dataclasses.replace(arm, fixtures={**arm.fixtures, "ball": arm.fixtures["ball"]._replace(radius=0.02)})
    names = (*DECLARED.split(","), "instrument_scale")
    effects = [effect_class(name).default(Model.of(arm).arm, data) for name in names]
    bound = Model.of(arm, effects).bind(data)
    theta = 1e-3 * generator.standard_normal(len(bound.terms))
    jacobian = bound.linearise(theta, rows=3)[1]
    for column, step in enumerate(1e-6 * np.eye(theta.size)):
        difference = bound.poses(theta + step).translation - bound.poses(theta - step).translation
        np.testing.assert_allclose(jacobian[:, column], difference / 2e-6, atol=1e-8)
    shown = bound.poses(theta).translation
    assert not shown[:2, np.isin(kinds, ("plane", "sphere"))].any()
    assert not shown[2, kinds == "line"].any()
    smaller = Model.of(dataclasses.replace(arm, fixtures={**arm.fixtures, "ball": Fixture("sphere")}), effects).bind(
        data
    )
    bigger = np.where(fixture == "ball", 0.02, 0.0)
    np.testing.assert_allclose(smaller.poses(theta).translation[2] - shown[2], bigger, atol=1e-12)


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
        ("photo,,,,,,,p1,1e-5", "found 'photo', expected one of position, point, plane, line, sphere, distance"),
        ("point,a,,,,,,p1,0", "sigma: found 0 m, expected"),
    ],
)
def test_a_row_that_lacks_what_its_kind_needs_is_refused(row: str, message: str, tmp_path: Path) -> None:
    path = saved(tmp_path / "poses.csv", f"{GOOD}{JOINTS},point,a,,,,,,p0,1e-5\n{JOINTS},{row}\n")
    problems = "\n".join(problems_of(robacc.calibrate, path, robot=robot()))
    assert missing(problems, message, "poses.csv:3") == []


def test_estimate_says_that_the_rows_are_no_positions(tmp_path: Path) -> None:
    path = written(list(rows_of("anchor", 5, np.random.default_rng(1))), tmp_path / "poses.csv")
    arm = tmp_path / "arm.yaml"
    robacc.write_robot(arm, robot())
    done = run("estimate", str(path), "--robot", str(arm))
    assert done.exit_code == 3
    assert "the rows are of kind distance, which are no positions" in done.stderr


def test_a_socket_may_have_any_name(tmp_path: Path) -> None:
    rows = [{**row, "socket": f"{row['socket']}."} for row in rows_of("point", 24, np.random.default_rng(2))]
    path = written(rows, tmp_path / "poses.csv")
    found = robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset").parameters
    assert [p.name for p in found if "a." in p.name] == [f"base_frame.a..{axis}" for axis in "xyz"]


# Photos of a board, arm and camera simulated independently.
MIDDLE = np.array([0.2, 0.3, -0.2, 0.3, 0.9, 0.1])
"""Joints about which the photos are taken, rad."""
REACH = np.array([0.4, 0.4, 0.4, 0.8, 0.6, 0.8])
TOOL = shift(0.05, -0.03, 0.12) @ turn(2, 0.4) @ turn(0, 0.3)
"""The board, or the camera, on the last link."""
AHEAD = shift(-0.08, -0.06, 0.7) @ turn(0, 0.3)
"""The board in the camera, in the middle."""
BOARD = np.array([(x, y, 0.0) for y in np.arange(4) * 0.04 for x in np.arange(5) * 0.04]).T
FOCAL, CENTRE, DISTORTION = np.array([1400.0, 1410.0]), np.array([960.0, 540.0]), (-0.12, 0.05, 1e-3, -5e-4, 0.01)
LENS = f"fx: 1400\nfy: 1410\ncx: 960\ncy: 540\ndistortion: {list(DISTORTION)}\nsize: [1920, 1080]\n"
Photo = tuple[np.ndarray, np.ndarray]


def image(points: np.ndarray) -> np.ndarray:
    """Pixels (2, K) of points (3, K) before the camera: a pinhole and the distortion of Brown (1971)."""
    x, y = points[:2] / points[2]
    k1, k2, p1, p2, k3 = DISTORTION
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    moved = np.stack(
        (x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x), y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y)
    )
    return (moved.T * FOCAL + CENTRE).T


def base_of(mount: str) -> np.ndarray:
    """The arm's base in the board, or in the camera."""
    at_hand = np.linalg.inv(AHEAD) if mount == "hand" else AHEAD
    return at_hand @ np.linalg.inv(link_frames(MIDDLE + ZEROS)[-1] @ TOOL)


@cache
def photos(mount: str, count: int, number: int = 1) -> tuple[Photo, ...]:
    """Joints (6,) and exact pixels (2, K) of photos in which the whole board is seen, by the camera of a number."""
    generator, found = np.random.default_rng(number), []
    aside = shift(0.05, -0.04, 0.1) @ turn(2, 0.5) if number > 1 else np.eye(4)
    base = base_of(mount)
    while len(found) < count:
        q = MIDDLE + REACH * generator.uniform(-1.0, 1.0, (200, 6))
        target = base @ link_frames((q + ZEROS).T)[-1] @ TOOL
        board = np.linalg.inv(target @ aside) if mount == "hand" else aside @ target
        points = board[:, :3, :3] @ BOARD + board[:, :3, 3:]
        pixels = image(np.moveaxis(points, 1, 0))
        inside = np.all((pixels > 0) & (pixels < 2 * CENTRE[:, None, None]), axis=(0, 2))
        seen = (points[:, 2].min(axis=1) > 0.3) & (board[:, 2, 2] > 0.5) & inside
        found += zip(q[seen], np.moveaxis(pixels, 1, 0)[seen], strict=True)
    return tuple(found[:count])


COLUMNS = "pose,q1,q2,q3,q4,q5,q6,board_x_mm,board_y_mm,u_px,v_px"


def lines(taken: tuple[Photo, ...], noise: float, seed: int = 5) -> Iterator[str]:
    """The rows of a pose file, one for each point."""
    generator = np.random.default_rng(seed)
    for number, (q, pixels) in enumerate(taken):
        joints = ",".join(map(repr, q.tolist()))
        seen = pixels + noise * generator.standard_normal(pixels.shape)
        for (x, y, _), (u, v) in zip(1e3 * BOARD.T, seen.T.tolist(), strict=True):
            yield f"p{number},{joints},{x:.6f},{y:.6f},{u!r},{v!r}"


def written_photos(folder: Path, mount: str, count: int = 20, noise: float = 0.0, lens: str = LENS) -> PoseFile:
    camera, path = folder / "camera.yaml", folder / "points.csv"
    camera.write_text(f"{lens}mount: {mount}\n")
    path.write_text("\n".join([COLUMNS, *lines(photos(mount, count), noise)]) + "\n")
    return PoseFile(path, camera=camera)


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_exact_pixels_give_exact_zeros_and_the_place_of_all(mount: str, tmp_path: Path) -> None:
    result = robacc.calibrate(written_photos(tmp_path, mount), robot=robot(), fit="tool_frame,joint_offset")
    assert zeros_of(values_of(result)) == pytest.approx(ZEROS[1:5], abs=1e-8)
    places = (result.robot.tool, TOOL), (result.robot.base, base_of(mount))
    for place, true in places:
        np.testing.assert_allclose(place.pose.matrices(), true, atol=1e-8)
    assert result.after.held_out.position.rms < 1e-8
    left = robacc.estimate(written_photos(tmp_path, mount), robot=result.robot, align="base_frame,tool_frame")
    assert max(left.position.rms, left.orientation.rms) < 1e-7


def photos_of_two_cameras(folder: Path, signs: np.ndarray | float = 1.0) -> PoseFile:
    """Twelve photos each of a camera on the hand and of one beside; the joints are recorded times ``signs``."""
    mounts = ("hand", "world")
    lens = LENS.replace("\n", "\n    ")
    cameras = "".join(f"  {name}:\n    {lens}mount: {mount}\n" for name, mount in zip("ab", mounts, strict=True))
    (folder / "cameras.yaml").write_text(f"cameras:\n{cameras}")
    rows = [
        f"{name},{name}{line}"
        for number, (name, mount) in enumerate(zip("ab", mounts, strict=True), 1)
        for line in lines(tuple((signs * q, pixels) for q, pixels in photos(mount, 12, number)), 0.0)
    ]
    (folder / "points.csv").write_text("\n".join([f"camera,{COLUMNS}", *rows]) + "\n")
    return PoseFile(folder / "points.csv", camera=folder / "cameras.yaml")


def test_two_cameras_show_the_zeros_together(tmp_path: Path) -> None:
    path = photos_of_two_cameras(tmp_path)
    result = robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset")
    assert zeros_of(values_of(result)) == pytest.approx(ZEROS[1:5], abs=1e-8)
    assert result.after.held_out.position.rms < 1e-8


def test_a_mistake_is_seen_by_each_of_two_cameras(tmp_path: Path) -> None:
    path = photos_of_two_cameras(tmp_path, np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0]))
    with pytest.raises(InputError, match="the sign of joint j3 seems to be reversed"):
        robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset")


def test_noisy_pixels_give_intervals_that_hold(tmp_path: Path) -> None:
    result = robacc.calibrate(written_photos(tmp_path, "world", noise=0.2), robot=robot(), fit=DECLARED)
    parameters = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        found = parameters[f"joint_offset.j{number}"]
        assert found.std < 1e-3
        assert abs(found.value - ZEROS[number - 1]) < 3.5 * found.std
    assert any("400 of 400 points in 20 of 20 photos are 0.2 px" in warning for warning in result.warnings)


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_estimate_has_the_errors_of_the_pose_in_mm(mount: str, tmp_path: Path) -> None:
    """Of the nominal arm they are those of exact poses."""
    q = np.array([joints for joints, _ in photos(mount, 20)]).T
    poses = np.array([base_of(mount) @ link_frames(joints + ZEROS)[-1] @ TOOL for joints in q.T])
    exact = Measurements(poses[:, :3, 3].T, np.moveaxis(poses[:, :3, :3], 0, 2), q=q)
    result, expected = (
        robacc.estimate(each, robot=robot(), align="base_frame,tool_frame")
        for each in (written_photos(tmp_path, mount), exact)
    )
    assert result.n_poses == 20
    assert result.position.rms == pytest.approx(expected.position.rms, rel=1e-6)
    assert result.orientation.rms == pytest.approx(expected.orientation.rms, rel=1e-6)


def test_photos_with_the_board_upside_down_cost_only_themselves(tmp_path: Path) -> None:
    """A detector of chessboards may count the corners from the other end in a photo that is turned."""
    (tmp_path / "right").mkdir()
    right = robacc.calibrate(written_photos(tmp_path / "right", "world", 24, 0.1), robot=robot())
    path, turned = written_photos(tmp_path, "world", 24, 0.1), ("p3", "p11", "p20")
    rows = [row.split(",") for row in Path(path).read_text().splitlines()]
    ends = np.array([[float(cell) for cell in row[7:9]] for row in rows[1:]])
    low_and_high = ends.min(axis=0) + ends.max(axis=0)
    for row, end in zip(rows[1:], ends, strict=True):
        row[7:9] = [f"{x:.6f}" for x in (low_and_high - end if row[0] in turned else end)]
    Path(path).write_text("\n".join(",".join(row) for row in rows) + "\n")
    result = robacc.calibrate(path, robot=robot())
    assert {str(result.fit.data.pose[row]) for row in result.fit.outliers} == {*turned}
    left, expected = result.after.held_out_inliers.position.rms, right.after.held_out.position.rms
    assert left < 1.3 * expected


def test_photos_with_the_joints_of_the_next_are_refused(tmp_path: Path) -> None:
    path = written_photos(tmp_path, "hand", 40, 0.1)
    head, *rows = [row.split(",") for row in Path(path).read_text().splitlines()]
    joints = {row[0]: row[1:7] for row in rows}
    following = dict(zip(joints, [*joints][1:] + [*joints][:1], strict=True))
    rows = [[row[0], *joints[following[row[0]]], *row[7:]] for row in rows]
    Path(path).write_text("\n".join(",".join(row) for row in (head, *rows)) + "\n")
    with pytest.raises(InputError, match=r"shifted by one row .* pair each measured pose with its own joint values"):
        robacc.calibrate(path, robot=robot())


def test_photos_in_their_order_show_the_backlash_of_a_servo(tmp_path: Path) -> None:
    """A fifth of a degree in the third joint, as servos of low-cost arms have it."""
    gap, taken, before = math.radians(0.2), [], MIDDLE
    for reached, pixels in photos("world", 64):
        # The joint stands where its gear leaves it: behind its command by the gap, on the side that it came from.
        q, side = reached.copy(), math.copysign(1.0, reached[2] - before[2])
        if abs(reached[2] - before[2]) > 2 * gap:
            q[2] -= gap * side
            taken.append((q, pixels))
            before = q
    path = written_photos(tmp_path, "world")
    Path(path).write_text("\n".join([COLUMNS, *lines(tuple(taken), 0.2)]) + "\n")
    result = robacc.trace(path, robot=robot(), declared=DECLARED, ordered=True)
    (finding,) = result.findings
    assert (finding.effect, finding.joints) == ("backlash", ("j3",))
    (value,) = (parameter.value for parameter in result.parameters if parameter.name == "backlash.j3")
    assert value == pytest.approx(gap, rel=0.05)


def test_a_wrong_corner_is_left_out(tmp_path: Path) -> None:
    path = written_photos(tmp_path, "hand", noise=0.1)
    rows = Path(path).read_text().splitlines()
    *cells, u, v = rows[47].split(",")
    rows[47] = ",".join([*cells, str(float(u) + 25.0), v])
    Path(path).write_text("\n".join(rows) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert any("399 of 400 points" in warning for warning in result.warnings)


def test_the_photos_show_the_lens_if_the_file_does_not(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    path = written_photos(tmp_path, "hand", lens="")
    result = robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset")
    assert any("of 1400, 1410, 960, 540" in warning for warning in result.warnings)
    assert zeros_of(values_of(result)) == pytest.approx(ZEROS[1:5], abs=2e-5)


def test_derivatives_of_images_are_those_of_the_predictions() -> None:
    generator, n = np.random.default_rng(8), 12
    seen = np.concatenate((generator.uniform(-0.1, 0.1, (3, n)), np.full((1, n), 0.6)))
    kind = np.array(["image", "image from hand"] * 6)
    fixture = np.where(kind == "image", "camera", "board")
    q = (MIDDLE + REACH * generator.uniform(-1.0, 1.0, (n, 6))).T
    data = Measurements(np.zeros((3, n)), q=q, kind=kind, fixture=fixture, seen=seen)
    arm, _ = with_measured_targets(robot(), data)
    effects = [effect_class(name).default(Model.of(arm).arm, data) for name in DECLARED.split(",")]
    bound = Model.of(arm, effects).bind(data)
    theta = 1e-2 * generator.standard_normal(len(bound.terms))
    jacobian = bound.linearise(theta, rows=3)[1]
    near = np.abs(bound.poses(theta).translation).max(axis=0) < 3.0  # Others are seen at more than 75 degrees.
    assert near.sum() >= 6
    for column, step in enumerate(1e-6 * np.eye(theta.size)):
        difference = bound.poses(theta + step).translation - bound.poses(theta - step).translation
        np.testing.assert_allclose(jacobian[:, column, near], difference[:, near] / 2e-6, rtol=1e-6, atol=1e-7)


def test_three_points_show_nearly_as_much_as_the_board() -> None:
    """Information of six numbers of a pose: of all points, and of three that count for as many."""
    points = np.random.default_rng(3).uniform(-0.06, 0.06, (3, 24)) * np.array([[1.0], [0.6], [0.0]])
    tilted = (turn(0, 0.5) @ turn(1, -0.3))[:3, :3]

    def information(of: np.ndarray) -> np.ndarray:
        def seen(step: np.ndarray) -> np.ndarray:
            small = shift(*step[:3]) @ turn(0, step[3]) @ turn(1, step[4]) @ turn(2, step[5])
            at = small[:3, :3] @ tilted @ of + small[:3, 3:] + np.array([[0.0], [0.0], [0.6]])
            return np.asarray((at[:2] / at[2]).ravel())

        slope = np.array([(seen(step) - seen(-step)) / 2e-6 for step in 1e-6 * np.eye(6)]).T
        return np.asarray(slope.T @ slope / of.shape[1])

    whole, three = information(points), information(three_points(points))
    ratio = np.linalg.eigvals(np.linalg.solve(whole, three)).real
    assert np.all((ratio > 0.5) & (ratio < 2.0))


@pytest.mark.parametrize(
    ("lens", "change", "message"),
    [
        ("fx: 1400\n", ("", ""), "camera.yaml:1, fy: is missing"),
        (LENS.replace("1400", "-1400"), ("", ""), "fx: found -1400, expected pixels, above 0 and below 1e+06"),
        (LENS.replace("-0.12", "900.0"), ("", ""), "the lens of the camera cannot show anything at this pixel"),
        (LENS, ("u_px", "u_pixel"), "images need the column u_px, which is missing"),
        (LENS, ("40.000000", "0.000000"), "no photo shows 4 points of a board that are not in a line"),
        (f"{LENS}cameras: {{a: {{mount: hand}}}}\n", ("", ""), "fx: stands beside cameras"),
        (LENS, ("120.000000", "x"), "board_x_mm: found 'x', expected a number"),
    ],
)
def test_bad_images_are_refused(lens: str, change: tuple[str, str], message: str, tmp_path: Path) -> None:
    path = written_photos(tmp_path, "hand", 5, lens=lens)
    text = Path(path).read_text()
    if message.startswith("no photo"):
        rows = [row.split(",") for row in text.splitlines()]
        text = "\n".join(",".join([*row[:8], "0" if i else row[8], *row[9:]]) for i, row in enumerate(rows))
    else:
        text = text.replace(*change) if change[0] else text
    Path(path).write_text(text)
    assert message in "\n".join(problems_of(robacc.calibrate, path, robot=robot()))


def test_the_command_asks_for_the_camera(tmp_path: Path) -> None:
    path, arm = written_photos(tmp_path, "hand", 5), tmp_path / "arm.yaml"
    robacc.write_robot(arm, robot())
    done = run("estimate", str(path), "--robot", str(arm))
    assert done.exit_code == 3
    assert "images need the camera that took them" in done.stderr
    assert "--camera" in done.stderr
    done = run("estimate", str(path), "--robot", str(arm), "--camera", str(tmp_path / "camera.yaml"))
    assert done.exit_code == 0
    assert "Error of 5 measured poses" in done.stdout


def test_what_could_mislead_is_said(tmp_path: Path) -> None:
    path = written_photos(tmp_path, "hand", 8, 0.1, LENS.replace("1400", "1250").replace("-0.12", "0.0"))
    result = robacc.estimate(path, robot=robot())
    assert any("px (rms) off the board" in warning and "check the lens" in warning for warning in result.warnings)
    path = written_photos(tmp_path, "hand", 20, 0.1)
    rows = Path(path).read_text().splitlines()
    Path(path).write_text("\n".join([*rows, *rows[1:41]]) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert result.n_poses == 20
    assert any("40 points repeat pixel and joints of earlier rows" in warning for warning in result.warnings)
    apart = saved(tmp_path / "apart.csv", "\n".join(rows[:41]) + "\n")
    with pytest.raises(InputError, match="validation poses are also among the calibration poses"):
        robacc.calibrate(path, robot=robot(), holdout=PoseFile(apart, camera=tmp_path / "camera.yaml"))
    Path(path).write_text("\n".join(rows[:101] + rows[101:104]) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert result.alignment is not None
    assert any("photos that do not show the board begin at line 102" in warning for warning in result.warnings)
