"""Arms that come with the package, and their names."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

_FOLDER = Path(__file__).parents[1] / "data"
_SHOWN = 4
"""Names that a message suggests."""


@dataclass(frozen=True, slots=True)
class LibraryArm:
    """Arm of the package: an entry of ``data/robots.yaml`` and its robot file."""

    key: str
    """Name that stands for its file: the file's name without suffix."""
    maker: str
    model: str
    """The maker's name of the arm."""
    axes: int
    reach: float
    """Reach as the maker states it, m; what it is measured to differs between makers."""
    source: str
    path: Path

    def document(self) -> dict[str, Any]:
        """Return the arm's entry of ``robacc.robots/1``."""
        return {
            "name": self.key,
            "maker": self.maker,
            "model": self.model,
            "n_axes": self.axes,
            "reach_m": self.reach,
            "source": self.source,
        }


@cache
def library() -> tuple[LibraryArm, ...]:
    """Return the arms by maker and name."""
    import yaml

    from robacc.io.files import read_text

    text = read_text(_FOLDER / "robots.yaml")
    # The package's own file, so the fast reader is safe.
    entries = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))["robots"]
    return tuple(
        LibraryArm(
            key,
            entry["maker"],
            entry["name"],
            entry["axes"],
            entry["reach"] * 1e-3,
            entry["source"],
            _FOLDER / "robots" / f"{key}.yaml",
        )
        for key, entry in entries.items()
    )


def find_arm(name: str) -> LibraryArm | None:
    """Return the arm with a name, or with the maker's name of it; capitals, blanks and hyphens do not matter.

    A name that fits several arms stands for none: variants of one arm differ by decimetres.
    """
    wanted = _plain(name)
    matches = [
        arm for arm in library() if wanted in (_plain(arm.key), _plain(arm.model), _plain(arm.maker + arm.model))
    ]
    return matches[0] if len(matches) == 1 else None


def similar_arms(name: str) -> tuple[str, ...]:
    """Return the names of arms that a name may mean, the likeliest first."""
    wanted = _plain(name)
    by_name = {_plain(key): arm.key for arm in library() for key in (arm.maker + arm.model, arm.model, arm.key)}
    variants = [key for plain, key in by_name.items() if wanted and wanted in plain]
    if variants:
        return tuple(dict.fromkeys(variants))[:_SHOWN]
    near = [by_name[plain] for plain in difflib.get_close_matches(wanted, by_name, _SHOWN, 0.6)]
    return tuple(dict.fromkeys(near))


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
