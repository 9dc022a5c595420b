"""Derivatives of the poses to the scalars of single motions of the chain."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.effects.base import Part, Term
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model


def motion_columns(model: Model, data: Measurements, motions: tuple[int, ...]) -> Array:
    """Return the derivative ``(6, len(motions), n)`` of the poses to the scalars of some motions."""
    bound = dataclasses.replace(model, free=()).bind(data)
    terms = tuple(Term(f"motion{motion}", "", 1.0, (Part(motion),)) for motion in motions)
    moved = dataclasses.replace(bound, terms=terms, owners=tuple(range(len(terms))))
    return moved.linearise(np.zeros(len(terms)))[1]
