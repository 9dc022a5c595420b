"""Forms of elastic effects whose masses are not those of the robot file: the setting, and the base regressors."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Literal

from robacc.effects.term import Part, Term
from robacc.gravity.loads import Load

Masses = Literal["known", "uncertain", "unknown"]

_MASS_STD = 5.0
"""Prior standard deviation of an unknown mass, kg."""
_FIRST_MOMENT_STD = 1.0
"""Prior standard deviation of an unknown first moment of mass, kg m."""


def masses_setting(name: str, settings: Mapping[str, Any], known: Collection[Masses]) -> tuple[Masses, dict[str, Any]]:
    """Return the setting ``masses``, and the other settings.

    Raises:
        ValueError: it is none of its ``known`` values.
    """
    other_settings = dict(settings)
    masses = other_settings.pop("masses", "known")
    if masses not in known:
        raise ValueError(f"{name}: masses must be {' or '.join(known)}, found {masses!r}")
    return masses, other_settings


def base_regressors(
    prefix: str,
    unit: str,
    typical: float,
    loads: Mapping[str, tuple[Load, ...]],
    parts: Callable[[tuple[Load, ...]], tuple[Part, ...]],
    stds: Mapping[str, float] | None = None,
) -> Iterator[Term]:
    """Yield one term for each unit mass and unit first moment of mass, shrunk by a common prior.

    Args:
        prefix: Name of the effect, and of its joint; the terms share it as the name of their prior.
        unit: Unit of the compliance.
        typical: Usual size of the compliance.
        loads: Unit loads by label, as :func:`robacc.gravity.loads.unit_loads` returns them.
        parts: Function that returns what moves under a load.
        stds: Prior standard deviation of each label's mass (kg) or first moment (kg m), where it is not the usual.
    """
    for label, load in loads.items():
        is_mass = label.startswith("m")
        usual = _MASS_STD if is_mass else _FIRST_MOMENT_STD
        std = usual if stds is None else stds.get(label, usual)
        unit_of_term = f"{unit} {'kg' if is_mass else 'kg m'}"
        yield Term(f"{prefix}.{label}", unit_of_term, typical, parts(load), prefix, std)
