"""Kinematics of the library's arms as URDFs state them: facts with their sources, in mm and degrees."""

from math import degrees
from typing import NamedTuple

Numbers = tuple[float, float, float]


class UrdfJoint(NamedTuple):
    """Origin and axis of a revolute joint."""

    xyz: Numbers
    axis: str
    rpy: Numbers = (0, 0, 0)


class Facts(NamedTuple):
    """Chain of a URDF from its base frame to its flange."""

    source: str
    joints: tuple[UrdfJoint, ...]
    flange: UrdfJoint
    base_height: float = 0.0
    """Height of the controller's base frame above the mounting face."""
    ratio: float = 0.0
    """Turn of the URDF's joint 3 per turn of the controller's joint 2."""
    reach: float | None = None
    """Published reach, mm."""
    reach_of: str = "wrist"
    """Point that the reach is of: ``wrist`` centre, ``flange``, or the wrist's radius within ``limits``."""


def serial(*rows: tuple[float, float, float, str]) -> tuple[UrdfJoint, ...]:
    """Return joints whose frames are parallel at zero."""
    return tuple(UrdfJoint((x, y, z), axis) for x, y, z, axis in rows)


KUKA = "github.com/ros-industrial/kuka_experimental, "
ABB = "github.com/ros-industrial/abb, "
FANUC = "github.com/ros-industrial/fanuc, "
MOTOMAN = "github.com/ros-industrial/motoman, "
STAUBLI = "github.com/ros-industrial/staubli and staubli_experimental, "
INTERBOTIX = "github.com/Interbotix/interbotix_ros_manipulators, "
DOOSAN = "github.com/doosan-robotics/doosan-robot2, "
_FORWARD = (0, 90, 0)
_FORWARD_X_UP = (180, -90, 0)


def _kuka(file: str, reach: float, d1: float, a1: float, a2: float, up: float, along: float, flange: float) -> Facts:
    rows = ((0, 0, d1, "-z"), (a1, 0, 0, "y"), (a2, 0, 0, "y"), (along, 0, up, "-x"), (0, 0, 0, "y"), (0, 0, 0, "-x"))
    return Facts(KUKA + file, serial(*rows), UrdfJoint((flange, 0, 0), "x", _FORWARD), reach=reach)


def _abb(file: str, reach: float, d1: float, a1: float, a2: float, up: float, along: float, flange: float) -> Facts:
    rows = ((0, 0, d1, "z"), (a1, 0, 0, "y"), (0, 0, a2, "y"), (0, 0, up, "x"), (along, 0, 0, "y"), (0, 0, 0, "x"))
    return Facts(ABB + file, serial(*rows), UrdfJoint((flange, 0, 0), "x", _FORWARD), reach=reach)


def _japanese(
    file: str, reach: float, d1: float, a1: float, a2: float, up: float, along: float, flange: float, ratio: float = 0.0
) -> Facts:
    rows = ((0, 0, d1, "z"), (a1, 0, 0, "y"), (0, 0, a2, "-y"), (along, 0, up, "-x"), (0, 0, 0, "-y"), (0, 0, 0, "-x"))
    end = UrdfJoint((flange, 0, 0), "x", _FORWARD_X_UP)
    return Facts((FANUC if ratio else MOTOMAN) + file, serial(*rows), end, d1, ratio, reach)


def _staubli(
    file: str, reach: float, d1: float, a1: float, a2: float, side: float, along: float, flange: float
) -> Facts:
    rows = ((0, 0, d1, "z"), (a1, 0, 0, "y"), (0, side, a2, "y"), (0, 0, 0, "z"), (0, 0, along, "y"), (0, 0, 0, "z"))
    return Facts(STAUBLI + file, serial(*rows), UrdfJoint((0, 0, flange), "z"), d1, 0.0, reach, "flange")


def _doosan(file: str, reach: float, d1: float, side: float, a2: float, d4: float, d6: float) -> Facts:
    joints = (
        UrdfJoint((0, 0, d1), "z"),
        UrdfJoint((0, side, 0), "z", (0, -90, -90)),
        UrdfJoint((a2, 0, 0), "z", (0, 0, 90)),
        UrdfJoint((0, -d4, 0), "z", (90, 0, 0)),
        UrdfJoint((0, 0, 0), "z", (-90, 0, 0)),
        UrdfJoint((0, -d6, 0), "z", (90, 0, 0)),
    )
    return Facts(DOOSAN + file, joints, UrdfJoint((0, 0, 0), "z"), reach=reach, reach_of="shoulder to flange")


def _rotated(source: str, *origins: tuple[Numbers, Numbers]) -> Facts:
    """Return the facts of origins ``xyz``, ``rpy`` with all axes z; the last is the flange."""
    *joints, flange = [UrdfJoint(xyz, "z", rpy) for xyz, rpy in origins]
    return Facts(source, tuple(joints), flange)


def _interbotix(
    file: str, heights: tuple[float, float], elbow: tuple[float, float], forearm: Numbers, tip: float
) -> Facts:
    rows = [(0, 0, heights[0], "z"), (0, 0, heights[1], "y"), (elbow[0], 0, elbow[1], "y")]
    rows += [(x, 0, 0, axis) for x, axis in zip(forearm, "xyx", strict=True)]
    return Facts(INTERBOTIX + file, serial(*rows), UrdfJoint((tip, 0, 0), "x"))


_FRANKA = _rotated(
    "github.com/frankaemika/franka_description, robots/fer/kinematics.yaml",
    ((0, 0, 333), (0, 0, 0)),
    ((0, 0, 0), (-90, 0, 0)),
    ((0, -316, 0), (90, 0, 0)),
    ((82.5, 0, 0), (90, 0, 0)),
    ((-82.5, 384, 0), (-90, 0, 0)),
    ((0, 0, 0), (90, 0, 0)),
    ((88, 0, 0), (90, 0, 0)),
    ((0, 0, 107), (0, 0, 0)),
)
URDF_FACTS = {
    "kr3_r540": _kuka("kr3r540_macro.xacro", 541, 345, 20, 260, 20, 260, 75),
    "kr6_r700_2": _kuka("kr6r700_2_macro.xacro", 726, 400, 25, 335, 25, 365, 90),
    "kr6_r900_sixx": _kuka("kr6r900sixx_macro.xacro", 901, 400, 25, 455, 35, 420, 80),
    "kr10_r1100_sixx": _kuka("kr10r1100sixx_macro.xacro", 1101, 400, 25, 560, 35, 515, 80),
    "kr10_r1420": _kuka("kr10r1420_macro.xacro", 1420, 450, 150, 610, 20, 660, 80),
    "kr16_r2010_2": _kuka("kr16_r2010_2_macro.xacro", 2013, 520, 160, 980, 150, 860, 153),
    "kr120_r2500_pro": _kuka("kr120r2500pro_macro.xacro", 2496, 675, 350, 1150, -41, 1000, 215),
    "kr210_r2700_extra": _kuka("kr210r2700extra_macro.xacro", 2696, 675, 350, 1150, -41, 1200, 215),
    "irb120_3_58": _abb("irb120_3_58_macro.xacro", 580, 290, 0, 270, 70, 302, 72),
    "irb1200_5_90": _abb("irb1200_5_90_macro.xacro", 901, 399.1, 0, 448, 42, 451, 82),
    "irb1200_7_70": _abb("irb1200_7_70_macro.xacro", 703, 399.1, 0, 350, 42, 351, 82),
    "irb1600_6_120": _abb("irb1600_6_12_macro.xacro", 1225, 486.5, 150, 475, 0, 600, 65),
    "irb1600_10_145": _abb("irb1600_10_145_macro.xacro", 1450, 486.5, 150, 700, 0, 600, 65),
    "irb2600_12_165": _abb("irb2600_12_165_macro.xacro", 1653, 445, 150, 700, 115, 795, 85),
    "irb4600_60_205": _abb("irb4600_60_205_macro.xacro", 2051, 495, 175, 900, 175, 960, 135),
    "irb6700_200_260": _abb("irb6700_200_260_macro.xacro", 2600, 780, 320, 1125, 200, 1142.5, 200),
    "lrmate_200id": _japanese("lrmate200id_macro.xacro", 717, 330, 50, 330, 35, 335, 80, 1),
    "lrmate_200id_7l": _japanese("lrmate200id7l_macro.xacro", 911, 330, 50, 440, 35, 420, 80, 1),
    "m20ia": _japanese("m20ia_macro.xacro", 1811, 525, 150, 790, 250, 835, 100, 1),
    "m710ic_50": _japanese("m710ic50_macro.xacro", 2050, 565, 150, 870, 170, 1016, 175, 1),
    "r2000ic_165f": _japanese("r2000ic165f_macro.xacro", 2655, 670, 312, 1075, 225, 1280, 215, 1)._replace(
        reach_of="wrist within limits"
    ),
    "crx10ia_l": Facts(
        FANUC + "crx10ial_macro.xacro",
        serial(
            (0, 0, 245, "z"),
            (0, 0, 0, "y"),
            (0, 0, 710, "-y"),
            (0, 0, 0, "-x"),
            (540, -150, 0, "-y"),
            (160, 0, 0, "-x"),
        ),
        UrdfJoint((0, 0, 0), "x", _FORWARD_X_UP),
        245,
        1,
        1418,
        "flange",
    ),
    "gp7": _japanese("gp7_macro.xacro", 927, 330, 40, 445, 40, 440, 80),
    "gp8": _japanese("gp8_macro.xacro", 727, 330, 40, 345, 40, 340, 80),
    "gp12": _japanese("gp12_macro.xacro", 1440, 450, 155, 614, 200, 640, 100),
    "gp25": _japanese("gp25_macro.xacro", 1730, 505, 150, 760, 200, 795, 100),
    "hc10": Facts(
        MOTOMAN + "hc10_macro.xacro",
        serial(
            (0, 0, 275, "z"), (0, 0, 0, "y"), (0, 0, 700, "-y"), (0, 0, -500, "z"), (0, 162, 0, "-y"), (0, 0, 0, "z")
        ),
        UrdfJoint((0, 0, -130), "z", (180, 0, 0)),
        275,
        0,
        1200,
        "wrist along axis 4",
    ),
    "tx2_60": _staubli("tx2_60_macro.xacro", 670, 375, 0, 290, 20, 310, 70),
    "tx2_90": _staubli("tx2_90_macro.xacro", 1000, 478, 50, 425, 50, 425, 100),
    "rx160": _staubli("rx160_macro.xacro", 1710, 550, 150, 825, 0, 625, 110),
    "rx160l": _staubli("rx160l_macro.xacro", 2010, 550, 150, 825, 0, 925, 110),
    "gen3_7dof": _rotated(
        "github.com/Kinovarobotics/ros_kortex, gen3_macro.xacro",
        ((0, 0, 156.43), (180, 0, 0)),
        ((0, 5.375, -128.38), (90, 0, 0)),
        ((0, -210.38, -6.375), (-90, 0, 0)),
        ((0, 6.375, -210.38), (90, 0, 0)),
        ((0, -208.43, -6.375), (-90, 0, 0)),
        ((0, 0.17505, -105.93), (90, 0, 0)),
        ((0, -105.93, -0.17505), (-90, 0, 0)),
        ((0, 0, -61.525), (180, 0, 0)),
    ),
    "ur30": _rotated(
        "github.com/UniversalRobots/Universal_Robots_ROS2_Description, config/ur30/default_kinematics.yaml",
        ((0, 0, 236.3), (0, 0, 0)),
        ((0, 0, 0), (90, 0, 0)),
        ((-637, 0, 0), (0, 0, 0)),
        ((-503.7, 0, 201), (0, 0, 0)),
        ((0, -159.3, 0), (90, 0, 0)),
        ((0, 154.3, 0), (90, 180, 180)),
        ((0, 0, 0), (0, 0, 0)),
    ),
    "panda": _FRANKA,
    "fr3": _FRANKA,
    "m0609": _doosan("macro.m0609.white.xacro", 900, 100, 6.2, 411, 368, 121),
    "m1013": _doosan("macro.m1013.white.xacro", 1300, 152.5, 34.5, 620, 559, 121),
    "so100": Facts(
        "github.com/TheRobotStudio/SO-ARM100, Simulation/SO100/so100.urdf; its base turned by 90 degrees about z",
        (
            UrdfJoint((45.2, 0, 16.5), "y", (90, 0, 90)),
            UrdfJoint((0, 102.5, 30.6), "x", (degrees(-1.8), 0, 0)),
            UrdfJoint((0, 112.57, 28), "x", (90, 0, 0)),
            UrdfJoint((0, 5.2, 134.9), "x", (degrees(-1), 0, 0)),
            UrdfJoint((0, -60.1, 0), "y", (0, 90, 0)),
        ),
        UrdfJoint((0, 0, 0), "z"),
    ),
    "so101": _rotated(
        "github.com/TheRobotStudio/SO-ARM100, Simulation/SO101/so101_new_calib.urdf",
        ((38.8353, 0, 62.4), (180, 0, 180)),
        ((-30.3992, -18.2778, -54.2), (-90, -90, 0)),
        ((-112.57, -28, 0), (0, 0, 90)),
        ((-134.9, 5.2, 0), (0, 0, -90)),
        ((0, -61.1, 18.1), (90, degrees(0.0486795), 180)),
        ((-7.9, -0.218121, -98.1274), (0, 180, 0)),
    ),
    "koch_v1_1": Facts(
        "github.com/s1lent4gnt/koch-v1-1, simulation/follower.urdf",
        serial(
            (12, 0, 40.9, "-z"),
            (0, -20.9, 15.4, "y"),
            (-14.8, 6.5, 108.3, "y"),
            (-100.48, 0.05, 2.6999, "y"),
            (-45, 13.097, 0, "x"),
        ),
        UrdfJoint((0, 0, 0), "z"),
    ),
    "wx250s": _interbotix("wx250s.urdf.xacro", (72, 38.65), (49.75, 250), (175, 75, 65), 43 + 23 + 27.575),
    "vx300s": _interbotix("vx300s.urdf.xacro", (79, 48.05), (59.55, 300), (200, 100, 69.744), 42.825 + 25.875 + 38.5),
    "mycobot_280": _rotated(
        "github.com/elephantrobotics/mycobot_ros2, mycobot_280_m5.urdf",
        ((0, 0, 131.56), (0, 0, 0)),
        ((0, 0, 0), (0, 90, -90)),
        ((-110.4, 0, 0), (0, 0, 0)),
        ((-96, 0, 64.62), (0, 0, -90)),
        ((0, -73.18, 0), (90, -90, 0)),
        ((0, 45.6, 0), (-90, 0, 0)),
        ((0, 0, 0), (0, 0, 0)),
    ),
    "openarm_v1": Facts(
        "github.com/enactic/openarm_mujoco, v1/openarm.xml",
        serial(
            (0, 0, 62.5, "z"),
            (-30.1, 0, 60, "-x"),
            (30.1, 0, 66.25, "z"),
            (0, 31.5, 153.75, "y"),
            (0, -31.5, 95.5, "z"),
            (37.5, 0, 120.5, "x"),
            (-37.5, 0, 0, "y"),
        ),
        UrdfJoint((0, 0, 100.1), "z"),
    ),
}
