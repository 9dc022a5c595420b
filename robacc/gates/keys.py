"""The keys of results that a criterion may be about, in their short form: ``position.p95`` for ``position.p95_m``."""

from __future__ import annotations

import difflib
import re
from itertools import product
from typing import Literal

Kind = Literal["length", "angle", "number", "grade", "word"]
"""What a key's value is: a quantity in m or rad, a bare number, a grade of a scale, or a word."""

_STATISTICS = ("rms", "mean_error", "p95", "max")
_QUANTITIES: tuple[tuple[str, Kind], ...] = (("position", "length"), ("orientation", "angle"))
_ISO = re.compile(r"iso9283(\.[A-Za-z]\w*)+")
"""An ISO 9283 result's keys are its criteria's: which of them there are depends on the data."""


def _known() -> dict[str, Kind]:
    keys: dict[str, Kind] = {"grade": "grade", "gain": "length", "n_poses": "number"}
    for quantity, kind in _QUANTITIES:
        for statistic in _STATISTICS:
            keys[f"{quantity}.{statistic}"] = kind
            keys[f"unaligned.{quantity}.{statistic}"] = kind
            for stage, poses in product(("nominal", "before", "after"), ("fitted", "held_out")):
                keys[f"{stage}.{poses}.{quantity}.{statistic}"] = kind
        for mean in ("zero_mean", "fitted_mean"):
            keys[f"{quantity}.radius95.{mean}.radius"] = kind
        keys[f"{quantity}.max_radius95"] = kind
        keys[f"{quantity}.n_commanded_poses"] = "number"
        keys[f"{quantity}.worst.rms"] = keys[f"{quantity}.worst.radius95"] = kind
        keys[f"against.measured.{quantity}_rms"] = kind
        keys[f"noise.{quantity}"] = kind
    for word in ("verdict", "against.verdict", "grade.demonstrated", "unexplained.structured"):
        keys[word] = "word"
    for length in ("unexplained.rms", "unexplained.noise_rms"):
        keys[length] = "length"
    for number in ("unexplained.p_value", "noise.residual_over_noise", "identifiability.condition_number"):
        keys[number] = "number"
    return keys


KEYS = _known()
"""Kind of every key but those of ISO 9283 results."""
LARGER_IS_BETTER = frozenset({"gain", "n_poses", "position.n_commanded_poses", "orientation.n_commanded_poses"})


def is_known(key: str) -> bool:
    """Whether some kind of result may hold the key."""
    return key in KEYS or _ISO.fullmatch(key) is not None


def kind_of(key: str) -> Kind | None:
    """What a known key's value is; None for a key of ISO 9283, whose unit the result itself says."""
    return KEYS.get(key)


def nearest_key(key: str) -> str:
    """The known key that a wrong one most resembles; all of its leaves' names where none does."""
    known = [*KEYS, "iso9283.AP.max", "iso9283.RP.max"]
    near = [one for one in known if one.startswith(key)] or difflib.get_close_matches(key, known, 1, 0.5)
    if near:
        return f"did you mean {near[0]}"
    return "for example position.p95, orientation.max, after.held_out.position.rms, gain, grade, verdict"
