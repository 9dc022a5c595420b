"""robacc: how accurate is the arm, why, and what would make it better."""

from robacc.version import __version__ as __version__
