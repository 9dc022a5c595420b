"""Keys of results that a criterion may test, in their short form: ``position.p95`` for ``position.p95_m``."""

from __future__ import annotations

import difflib
import re
from itertools import product
from typing import Literal

Kind = Literal["length", "angle", "number", "grade", "word"]
"""Kind of a key's value: a quantity in m or rad, a bare number, a grade of a scale, or a word."""

_STATISTICS = ("rms", "mean_error", "p95", "max")
_QUANTITIES: tuple[tuple[str, Kind], ...] = (("position", "length"), ("orientation", "angle"))
_ISO = re.compile(r"iso9283(\.[A-Za-z]\w*)+")
"""Keys of an ISO 9283 result, which depend on the criteria that its data support."""


def _known_keys() -> dict[str, Kind]:
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
        keys[f"coverage.{quantity}.share"] = "number"
        for statistic in ("rms", "max"):
            keys[f"correction.{quantity}.{statistic}"] = kind
        for stage, statistic in product(("before", "after"), ("rms", "max", "expected_rms", "largest_bound95")):
            keys[f"expected.{stage}.{quantity}.{statistic}"] = kind
    for name in ("n_targets", "n_corrected", "n_refused"):
        keys[name] = "number"
    for name in ("verdict", "against.verdict", "grade.demonstrated", "unexplained.structured"):
        keys[name] = "word"
    for name in ("unexplained.rms", "unexplained.noise_rms"):
        keys[name] = "length"
    for name in ("unexplained.p_value", "noise.residual_over_noise", "identifiability.condition_number"):
        keys[name] = "number"
    return keys


KEYS = _known_keys()
"""Kind of every key except those of ISO 9283 results."""
LARGER_IS_BETTER = frozenset(
    {"gain", "n_poses", "n_corrected"}
    | {f"{q}.n_commanded_poses" for q, _ in _QUANTITIES}
    | {f"coverage.{q}.share" for q, _ in _QUANTITIES}
)


def is_known(key: str) -> bool:
    """Return whether the result of a command can have the key."""
    return key in KEYS or _ISO.fullmatch(key) is not None


def kind_of(key: str) -> Kind | None:
    """Return the kind of a known key; None for a key of ISO 9283, whose unit the result states."""
    return KEYS.get(key)


def nearest_key(key: str) -> str:
    """Return a hint with the known key most similar to an unknown key, or with examples of keys."""
    known = [*KEYS, "iso9283.AP.max", "iso9283.RP.max"]
    similar = [name for name in known if name.startswith(key)] or difflib.get_close_matches(key, known, 1, 0.5)
    if similar:
        return f"did you mean {similar[0]}?"
    return "for example position.p95, orientation.max, after.held_out.position.rms, gain, grade, verdict"
