"""Pose criteria of ISO 9283:1998 from cycles of commanded poses, and the poses to measure them at."""

ORIENTATION_TEXT = {
    "down": "the tool's z axis pointing straight down",
    "forward": "the tool's z axis pointing level, away from the base",
    "own": "the tool's orientation constant, as the arm reaches the cube's centre",
    "free": "the tool's orientation different at each pose",
}
"""Orientations of the tool at the poses of a cube; they stand here since views of an estimate need them too."""
