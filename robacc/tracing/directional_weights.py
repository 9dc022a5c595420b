"""Weights by direction, where the noise is larger along one direction than along others (a camera's depth)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

from robacc.fitting.directional_noise import DirectionalNoise
from robacc.fitting.places import places
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.tracing.held_out_gain import gain_score

Result = TypeVar("Result")

_WORSE = -2.0
"""Gain of held-out poses, over its standard error, below which equal weights stay."""


def with_directional_weights(
    run: Callable[[Measurements], tuple[Result, DirectionalNoise | None]],
    held_out: Callable[[Result], Array | None],
    with_warning: Callable[[Result, str], Result],
    data: Measurements,
    holdout: Measurements | None,
) -> Result:
    """Return the result of ``run``, with weights by direction if the noise differs.

    An error that the model lacks may be larger along a direction, too. With less weight there, the model would be worse
    on other poses; then equal weights stay.

    Args:
        run: Function of the poses, which returns a result and the directional noise that it shows.
        held_out: Function that returns a result's residuals ``(3 or 6, N)`` of held-out poses; None if there are none.
        with_warning: Function that adds a warning to a result.
        data: Measured poses.
        holdout: Poses that are held out in place of folds of ``data``.
    """
    result, noise = run(data)
    if noise is None:
        return result
    before = held_out(result)
    if data.position_variance is None and before is not None:
        weighted = run(dataclasses.replace(data, noise_covariance=noise.beyond_least))[0]
        after = held_out(weighted)
        if after is not None and gain_score(before, after, places(data if holdout is None else holdout)) >= _WORSE:
            return with_warning(weighted, noise.message)
    return with_warning(result, noise.warning)
