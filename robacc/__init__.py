"""robacc: how accurate is the arm, why, and what would make it better."""

__version__ = "0.1.0"
