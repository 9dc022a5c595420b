"""Record of a fit in a model file: the part ``fit:`` that ``write_model`` adds to a robot file, in m and rad.

It holds what a prediction of the calibrated arm's accuracy needs: the covariance of the coefficients, the repeatability
of the joints, and the covariance of the error that the model does not explain. Commands that need none of it ignore it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import Effect, effect_class
from robacc.errors import InputError, Problem, RobaccError
from robacc.geometry import Array
from robacc.robots.description import Robot

_FIX = "`write_model` of a trace or a calibration writes it; do not change it, or remove this part completely"


@dataclass(frozen=True)
class ModelFit:
    """What a model file knows of its own fit."""

    effects: tuple[Effect, ...]
    """Effects that were fitted."""
    coefficients: tuple[str, ...]
    """Names of the identifiable coefficients, P of them."""
    covariance: Array
    """``(P, P)`` of the coefficients, SI."""
    nominal: Mapping[str, Mapping[str, float]]
    """Numbers of the joints before the fit, where they differ, by joint; m and rad."""
    repeatability: Mapping[str, float]
    """Standard deviation of the scatter of each joint, rad or m, as far as it is identifiable."""
    unexplained: Array
    """``(M, M)`` covariance of the unexplained error in the target's frame; M is 3 for positions alone, else 6."""
    noise: tuple[float, float | None]
    """Standard deviation of the measurement noise, m and rad; where it is not separate, of all that is unexplained."""
    noise_is_separate: bool
    """``unexplained`` has no measurement noise: the poses of the fit state it, or it was separated from the scatter."""
    bound_factor: tuple[float, float]
    """Factor of the bounds of position and orientation errors that gives them their coverage on held-out poses."""
    largest_correction: tuple[float, float]
    """Largest difference between model and nominal robot on the poses of the fit, m and rad."""
    ranges: Mapping[str, tuple[float, float]]
    """Lowest and highest value over the poses of the fit, by joint and by column of circumstances."""
    n_poses: int
    suspicions: tuple[str, ...] = ()
    """Data mistakes that the fit made likely, in words."""

    def entry(self) -> dict[str, Any]:
        """Return the part of the robot file as plain values."""
        return {
            "effects": [
                {
                    "effect": effect.name,
                    **({"joints": list(effect.joints)} if effect.joints else {}),
                    **effect.settings(),
                }
                for effect in self.effects
            ],
            "coefficients": list(self.coefficients),
            "covariance": [_text(row[: i + 1]) for i, row in enumerate(self.covariance)],
            "nominal": {joint: dict(numbers) for joint, numbers in self.nominal.items()},
            "repeatability": dict(self.repeatability),
            "unexplained": [_text(row[: i + 1]) for i, row in enumerate(self.unexplained)],
            "noise": {
                "position": self.noise[0],
                "orientation": self.noise[1],
                "separate": self.noise_is_separate,
            },
            "bound_factor": {"position": self.bound_factor[0], "orientation": self.bound_factor[1]},
            "largest_correction": {
                "position": self.largest_correction[0],
                "orientation": self.largest_correction[1],
            },
            "ranges": {name: [float(low), float(high)] for name, (low, high) in self.ranges.items()},
            "n_poses": self.n_poses,
            **({"suspected_mistakes": list(self.suspicions)} if self.suspicions else {}),
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return a warning for users of the model whose fit made a data mistake likely."""
        return tuple(f"doubtful model: {text}" for text in self.suspicions)


def model_fit(robot: Robot) -> ModelFit | None:
    """Return the record of a robot's fit; None for a robot without one.

    Raises:
        InputError: The part cannot be read.
    """
    if robot.fit is None:
        return None
    try:
        return _read(robot.fit)
    except (KeyError, TypeError, ValueError, RobaccError) as error:
        message = f"cannot be read: {error}" if not isinstance(error, KeyError) else f"the key {error} is missing"
        raise InputError(Problem(message, robot.name, column="fit", fix=_FIX)) from None


def _read(entry: Mapping[str, Any]) -> ModelFit:
    noise, factor, largest = entry["noise"], entry["bound_factor"], entry["largest_correction"]
    names = tuple(str(name) for name in entry["coefficients"])
    covariance = _symmetric(entry["covariance"])
    if covariance.shape[0] != len(names):
        raise ValueError(f"{len(names)} coefficients, but a covariance of {covariance.shape[0]}")
    orientation = noise["orientation"]
    return ModelFit(
        effects=tuple(
            effect_class(str(item["effect"])).from_settings(
                tuple(item.get("joints", ())), {key: item[key] for key in item if key not in ("effect", "joints")}
            )
            for item in entry["effects"]
        ),
        coefficients=names,
        covariance=covariance,
        nominal={joint: {k: float(v) for k, v in numbers.items()} for joint, numbers in entry["nominal"].items()},
        repeatability={joint: float(std) for joint, std in entry["repeatability"].items()},
        unexplained=_symmetric(entry["unexplained"]),
        noise=(float(noise["position"]), None if orientation is None else float(orientation)),
        noise_is_separate=bool(noise.get("separate", False)),
        bound_factor=(float(factor["position"]), float(factor["orientation"])),
        largest_correction=(float(largest["position"]), float(largest["orientation"])),
        ranges={name: (float(low), float(high)) for name, (low, high) in entry["ranges"].items()},
        n_poses=int(entry["n_poses"]),
        suspicions=tuple(str(text) for text in entry.get("suspected_mistakes", ())),
    )


def _text(row: Array) -> str:
    """Return numbers as one text: a list of each would make the file long and slow to read."""
    return " ".join(f"{value:.12g}" for value in row.tolist())


def _symmetric(rows: Sequence[Any]) -> Array:
    """Return the symmetric matrix whose lower triangle is written row by row."""
    result = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        values = [float(number) for number in str(row).split()]
        if len(values) != i + 1 or not np.all(np.isfinite(values)):
            raise ValueError(f"row {i + 1} of a covariance has {len(values)} numbers, expected {i + 1} finite ones")
        result[i, : i + 1] = result[: i + 1, i] = values
    return result
