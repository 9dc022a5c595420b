"""Collisions of links: against another transform of the same shapes, and against places that are known."""

from pathlib import Path

import numpy as np
import pytest
from commands import refused
from sample_files import ROOT, saved

import robacc
from robacc import InputError, UsageError, read_robot
from robacc_plugins.collisions import ShapeCollisions, link_collisions

pytest.importorskip("fcl")
# Two long arms in a plane on a mast, a hand with a finger of its own, and shapes of every kind but meshes.
URDF = """<robot name="planar">
  <link name="mast">
    <collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision></link>
  <link name="upper">
    <collision><origin xyz="0.25 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision></link>
  <link name="lower">
    <collision><origin xyz="0.25 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision></link>
  <link name="hand"><collision><geometry><sphere radius="0.08"/></geometry></collision></link>
  <link name="finger">
    <collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.02 0.02"/></geometry></collision></link>
  <joint name="a" type="revolute"><parent link="mast"/><child link="upper"/><origin xyz="0 0 0.35"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>
  <joint name="c" type="revolute"><parent link="lower"/><child link="hand"/><origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="d" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.05 0 0"/></joint>
  <link name="tip"/>
  <joint name="e" type="fixed"><parent link="hand"/><child link="finger"/><origin xyz="0.05 0 0"/></joint>
</robot>
"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    return saved(tmp_path / "planar.urdf", URDF)


def collisions_of(urdf: Path) -> ShapeCollisions:
    return link_collisions(str(urdf), read_robot(str(urdf), tip_link="tip"))


def test_shapes_are_placed_as_another_library_places_them(urdf: Path) -> None:
    """The same poses by the transforms of yourdfpy and the collision manager of trimesh."""
    import trimesh
    from yourdfpy import URDF as Reader

    links = collisions_of(urdf)
    q = np.random.default_rng(0).uniform([[-2], [-3.1], [-1]], [[2], [3.1], [1]], (3, 120))
    model = Reader.load(
        str(urdf), build_scene_graph=False, load_meshes=False, build_collision_scene_graph=True,
        load_collision_meshes=True,
    )  # fmt: skip
    scene = model.collision_scene
    adjacent = [("mast", "upper"), ("upper", "lower"), ("lower", "hand"), ("lower", "finger"), ("hand", "finger")]
    skipped = {frozenset(pair) for pair in adjacent}
    expected = []
    for column in q.T:
        model.update_cfg(column)
        manager = trimesh.collision.CollisionManager()
        for node in scene.graph.nodes_geometry:
            placed, name = scene.graph.get(node)
            manager.add_object(scene.graph.transforms.parents[node], scene.geometry[name], placed)
        touching = manager.in_collision_internal(return_names=True)[1]
        expected.append(any(frozenset(pair) not in skipped for pair in touching))
    assert 10 < sum(expected) < 110
    np.testing.assert_array_equal(links.self_collision(q), expected)


def test_a_box_and_a_side_see_the_thickness(urdf: Path) -> None:
    links = collisions_of(urdf)
    straight = np.zeros((3, 1))
    # The lower arm spans y from -0.05 to 0.05 and x from 0.5 to 1.0 at a height of 0.35.
    box = ((0.6, 0.06, 0.3), (0.9, 0.5, 0.4))
    assert not links.in_box(straight, *box)[0]
    nearer = ((0.6, 0.04, 0.3), (0.9, 0.5, 0.4))
    assert links.in_box(straight, *nearer)[0]
    assert links.in_box(straight, (0.6, -np.inf, -np.inf), (np.inf, np.inf, np.inf))[0]
    assert not links.beyond(straight, (0.0, 1.0, 0.0), 0.081)[0]
    assert links.beyond(straight, (0.0, 1.0, 0.0), 0.079)[0]
    # The turret that turns on the base need not clear it.
    assert not links.in_box(straight, (0.2, -0.01, 0.3), (0.3, 0.01, 0.4))[0]


def test_pairs_that_overlap_by_design_are_named(tmp_path: Path) -> None:
    fat = URDF.replace('sphere radius="0.08"', 'sphere radius="0.6"')
    # Triangles touch where surfaces cross; a fully folded upper arm would be inside the sphere.
    path = saved(tmp_path / "fat.urdf", fat.replace('lower="-3.1" upper="3.1"', 'lower="-1.5" upper="1.5"'))
    assert collisions_of(path).overlapping == (("upper", "hand"),)


def test_the_plan_counts_self_collisions(urdf: Path) -> None:
    more = {"candidates": 150, "poses": 8, "fit": "base_frame,joint_offset", "tip_link": "tip"}
    plan = robacc.plan(urdf, collisions=True, **more)  # type: ignore[arg-type]
    reasons = {entry["reason"]: entry["count"] for entry in plan.candidates.excluded}
    assert reasons["self-collision"] > 10
    assert not collisions_of(urdf).self_collision(plan.visits.q).any()
    assert ["mast", "lower"] in plan.document()["collisions"]["pairs"]
    free = robacc.plan(urdf, **more)  # type: ignore[arg-type]
    assert free.document()["collisions"] is None
    assert collisions_of(urdf).self_collision(free.candidates.q).any()


def test_a_side_that_no_pose_can_keep_is_named(urdf: Path) -> None:
    options = ("--tip-link", "tip", "--collisions", "--candidates", "50", "--min-height", "310mm")
    assert "2000 are excluded by: a point of the arm beyond z>=310mm" in refused("plan", urdf, *options)


def test_the_log_of_the_reader_of_urdfs_is_as_before(urdf: Path, tmp_path: Path) -> None:
    import logging

    logger = logging.getLogger("yourdfpy.urdf")
    collisions_of(urdf)
    assert not logger.disabled
    broken = saved(
        tmp_path / "broken.urdf", urdf.read_text().replace('<sphere radius="0.08"/>', '<mesh filename="hand.stl"/>')
    )
    with pytest.raises(InputError, match="collision mesh"):
        collisions_of(broken)
    assert not logger.disabled


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("".join(part.split("</collision>")[-1] for part in URDF.split("<collision>")), "no collision geometry"),
        (
            URDF.replace('<sphere radius="0.08"/>', '<mesh filename="package://parts/none.stl"/>'),
            r"mesh package://parts/none\.stl is not there",
        ),
        (URDF.replace('<sphere radius="0.08"/>', '<mesh filename="hand.stl"/>'), "has no triangles"),
    ],
)
def test_shapes_that_cannot_be_read(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "hand.stl").write_text("solid nothing")
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(InputError if "mesh" in text else UsageError, match=message):
        robacc.plan(tmp_path / "arm.urdf", collisions=True, tip_link="tip")


def test_a_robot_file_has_no_shapes() -> None:
    with pytest.raises(UsageError, match="give the URDF of the robot"):
        robacc.plan(ROOT / "sample_data" / "robot.yaml", collisions=True)
