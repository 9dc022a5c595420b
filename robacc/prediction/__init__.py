"""Accuracy predicted from tolerances, equations (6) to (8), and comparison of the prediction with measured poses."""

DEFAULT_SAMPLES = 1000
"""Default number of configurations at which an arm is predicted."""
