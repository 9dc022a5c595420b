"""Pose criteria of ISO 9283:1998 from cycles of commanded poses, and the poses to measure them at."""
