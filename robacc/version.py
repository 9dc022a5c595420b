"""The version of this robacc: below everything, so that results can name it."""

__version__ = "0.1.0"
