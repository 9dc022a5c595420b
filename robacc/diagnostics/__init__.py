"""Checks of residuals and data that calibrate and trace share."""
