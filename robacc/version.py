"""The version of this robacc: below everything, so that results can name it."""

__version__ = "0.2.0"
