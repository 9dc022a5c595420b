"""Accuracy predicted from tolerances, equations (6) to (8), and the prediction held against measured poses."""
