"""Accuracy predicted from tolerances, equations (6) to (8), and comparison of the prediction with measured poses."""
