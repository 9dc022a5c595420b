"""Fits of a search: each starts at a similar fit, and converges less far than a reported one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from robacc.effects.base import Effect
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements

SEARCH = Options(tolerance=1e-4, settled=1e-2)
"""Options of the fits that a selection is made on; reported fits converge further."""


def refit(like: Fit, free: Sequence[Effect], data: Measurements, options: Options) -> Fit:
    """Fit a model with the effects ``free``, starting at a similar fit and with that fit's registered base and tool.

    Coefficients that the similar fit lacks start at zero. The first step is always taken, so the poses of ``data``
    decide.
    """
    model = dataclasses.replace(like.model, free=tuple(free))
    keys = [effect.key() for effect in like.model.free]
    previous = {
        (keys[owner], name): value
        for owner, name, value in zip(like.owners, like.names, like.theta.tolist(), strict=True)
    }
    # A term's name does not depend on the poses, so the first row is enough to list them.
    first_row = data.subset(np.arange(1))
    start = [
        previous.get((key, term.name), 0.0)
        for effect, key in ((effect, effect.key()) for effect in free)
        for term in effect.terms(model.arm, first_row)
    ]
    # Outliers are known from the similar fit; on the same rows they start left out.
    inliers = like.inliers if options.robust and like.inliers.size == data.n else None
    warm_start = dataclasses.replace(options, start=np.array(start), inliers=inliers, group_stds=like.group_stds)
    return fit(model, data, warm_start)


def frames_first(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects with frames first, so that frames keep their parameters if poses cannot distinguish two."""
    return tuple(sorted(effects, key=lambda effect: not effect.traits.is_frame))
