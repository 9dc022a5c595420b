"""Accuracy predicted from tolerances, equations (6) to (8), and the prediction held against measured poses."""

DEFAULT_SAMPLES = 1000
"""Configurations that an arm is predicted at where nothing says which."""
