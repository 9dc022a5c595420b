"""Calibration: fit the named effects and report the error before and after, on held-out poses too."""
