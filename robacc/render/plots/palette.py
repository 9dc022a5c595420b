"""Colours by their role, in a light and a dark set.

The colours of data are from M. Okabe and K. Ito, "Color Universal Design" (2008), distinguishable with any kind of
colour vision. Shape or line style carries the same information, for prints in grey.
"""

from __future__ import annotations

from typing import Final

LIGHT: Final = {
    "ink": "#1b2530",
    "muted": "#59636e",
    "grid": "#dde2e7",
    "paper": "#fffffe",
    "nominal": "#7a838c",
    "before": "#d55e00",
    "after": "#0072b2",
    "third": "#009e73",
    "fourth": "#cc79a7",
    "limit": "#1b2531",
}
"""Colours in files and on light pages; all differ, so that a page can substitute each with its own variable."""

DARK: Final = {
    "ink": "#e6e9ec",
    "muted": "#a3adb7",
    "grid": "#343c45",
    "paper": "#161b21",
    "nominal": "#8f99a3",
    "before": "#e69f00",
    "after": "#56b4e9",
    "third": "#2fbf94",
    "fourth": "#e09cc4",
    "limit": "#e6e9ec",
}


def css_variables(colours: dict[str, str]) -> str:
    """Return the declarations ``--c-ink: …; …``."""
    return " ".join(f"--c-{role}: {value};" for role, value in colours.items())
