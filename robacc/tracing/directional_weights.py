"""Weights by direction, where the noise is larger along one direction than along others (a camera's depth)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Protocol, TypeVar

from robacc.accuracy.stages import Residuals, paired_gain
from robacc.error_model.structure import DirectionalNoise
from robacc.fitting.places import places
from robacc.geometry import Array
from robacc.measurements import Measurements


class HeldOutResult(Protocol):
    """Result of a trace or a calibration, a dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def residuals(self) -> Residuals:
        """Residuals of all poses, and of those that folds held out."""

    @property
    def holdout(self) -> Residuals | None:
        """Residuals of validation poses; None without them."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for readers of the result."""


Result = TypeVar("Result", bound=HeldOutResult)


def with_directional_weights(
    run: Callable[[Measurements], tuple[Result, DirectionalNoise | None]],
    data: Measurements,
    holdout: Measurements | None,
) -> Result:
    """Return the result of ``run``, with weights by direction if the noise differs.

    An error that the model lacks may be larger along a direction, too. With less weight there, the model would be worse
    on other poses; then equal weights stay.

    Args:
        run: Function of the poses, which returns a result and the directional noise that it shows.
        data: Measured poses.
        holdout: Poses that are held out in place of folds of ``data``.
    """
    result, noise = run(data)
    if noise is None:
        return result
    before = _held_out(result)
    if before is not None and data.position_variance is None:
        weighted = run(dataclasses.replace(data, noise_covariance=noise.beyond_least))[0]
        after = _held_out(weighted)
        if (
            after is not None
            and not paired_gain(before, after, places(data if holdout is None else holdout)).high < 0.0
        ):
            return dataclasses.replace(weighted, warnings=(*weighted.warnings, noise.message))
    return dataclasses.replace(result, warnings=(*result.warnings, noise.warning))


def _held_out(result: HeldOutResult) -> Array | None:
    """Return the residuals ``(3 or 6, N)`` of held-out poses; None if there are none."""
    return result.residuals.held_out_after if result.holdout is None else result.holdout.after
