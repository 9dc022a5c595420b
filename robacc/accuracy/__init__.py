"""Accuracy of measured poses: errors of poses, their metrics and statistics, and the grade."""
