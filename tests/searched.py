"""Fits and searches beside frames, zeros and geometry, on poses of the independent arm."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from independent_arm import DECLARED, robot

from robacc.effects.base import Effect
from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.search import search

ARM = Arm.of(robot())


def model(data: Measurements, arm: Arm = ARM, effects: Sequence[Effect] = (), declared: str = DECLARED) -> Model:
    """The model whose declared effects and ``effects`` are free."""
    return Model(arm, free=(*build(parse_requests(declared), arm, data), *effects))


def found(data: Measurements, arm: Arm = ARM) -> tuple[Effect, ...]:
    """What a search finds beside the declared effects."""
    return tuple(search(model(data, arm), data).effects)


def fitted(data: Measurements, effects: Sequence[Effect] = (), arm: Arm = ARM, declared: str = DECLARED) -> Fit:
    """The fit of the declared effects and of ``effects``."""
    return fit(model(data, arm, effects, declared), data, Options())


def values_of(result: Fit) -> dict[str, float]:
    """Coefficients by name."""
    return dict(zip(result.names, result.theta.tolist(), strict=True))


def error_at(result: Fit, fresh: Measurements) -> float:
    """RMS position error at poses that the fit has not seen and that have no noise, m."""
    predicted = result.model.bind(fresh).poses(result.theta).translation
    return float(np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0))))


class SearchEnd(NamedTuple):
    """Effects that a search finds, and the fit of them."""

    effects: tuple[Effect, ...]
    values: dict[str, float]
    """Coefficients by name."""
    error: float
    """RMS position error at other poses without noise, m."""


def searched(data: Measurements, fresh: Measurements, arm: Arm = ARM) -> SearchEnd:
    """Search on ``data`` beside geometry, and predict ``fresh`` with what is found."""
    effects = found(data, arm)
    result = fitted(data, effects, arm)
    return SearchEnd(effects, values_of(result), error_at(result, fresh))
