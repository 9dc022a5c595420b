"""What a search finds on poses of the independent arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from independent_arm import DECLARED, robot

from robacc.effects.base import Effect
from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.search import search

ARM = Arm.of(robot())


class SearchEnd(NamedTuple):
    """Effects that a search finds, and the fit of them."""

    effects: list[Effect]
    values: dict[str, float]
    """Coefficients by name."""
    error: float
    """RMS position error at other poses without noise, m."""


def searched(data: Measurements, fresh: Measurements) -> SearchEnd:
    """Search on ``data`` beside geometry, and predict ``fresh`` with what is found."""
    declared = build(parse_requests(DECLARED), ARM, data)
    effects = search(Model(ARM, free=declared), data).effects
    result = fit(Model(ARM, free=(*declared, *effects)), data, Options())
    predicted = result.model.bind(fresh).poses(result.theta).translation
    error = float(np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0))))
    return SearchEnd(list(effects), dict(zip(result.names, result.theta.tolist(), strict=True)), error)
