"""Families of the forms of effects on the poses of a selection, each built once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.tracing.candidates import Batch, OrderGrid
from robacc.tracing.conditioned_columns import Family
from robacc.tracing.step_scans import Adjoints, StepFamily, StepScan, near_places, scan_for
from robacc.tracing.whitened_columns import Columns

_ORDERS_TRIED = 17
"""Orders tried within a span."""

Key = tuple[object, ...]
FormsOf = Callable[[Effect], Sequence[Batch]]
BatchFamily = tuple[Batch, Family]
"""Forms of effects, and the family of their columns."""


class FormFamilies:
    """Families on the poses of one selection. Tests of a finding ask for the same forms again and again."""

    def __init__(
        self,
        system: Columns,
        joint_columns: Array,
        poses: NDArray[np.int64],
        whitening: Whitening,
        step_scans: Sequence[StepScan],
        refinements: FormsOf,
        beside: FormsOf,
    ) -> None:
        """Store what families are built from.

        Args:
            system: Columns and residual on the poses of the selection.
            joint_columns: ``(M, J + 3, N)`` whitened columns of each joint's variable, and of the base's x, y, z.
            poses: ``(N,)`` numbers of the poses among those of the linearisation.
            whitening: Whitening of these poses.
            step_scans: Forms of a step.
            refinements: Function that returns the forms in which a search refines an effect.
            beside: Function that returns the candidates that need an effect.
        """
        self._system, self._joint_columns, self._poses, self._step_scans = system, joint_columns, poses, step_scans
        self._adjoints = Adjoints(whitening)
        self._make_refined, self._make_beside = refinements, beside
        self._refined: dict[Key, Sequence[BatchFamily]] = {}
        self._beside: dict[Key, Sequence[BatchFamily]] = {}
        self._steps_near: dict[Key, tuple[StepScan, StepFamily] | None] = {}
        self._orders_near: dict[tuple[str, float, float], tuple[Array, Family]] = {}

    def orders(self, grid: OrderGrid, orders: Array) -> Family:
        """Return cosine and sine of evenly spaced orders of a joint, each computed from the order before."""
        waves = np.empty((orders.size, grid.angle.size), dtype=np.complex128)
        waves[0] = np.exp(1j * orders[0] * grid.angle)
        waves[1:] = np.exp(1j * (orders[1] - orders[0]) * grid.angle) if orders.size > 1 else 1.0
        np.cumprod(waves, axis=0, out=waves)
        basis = np.stack((waves.real, waves.imag), axis=1)
        return Family(self._system, self._joint_columns[:, grid.number], basis, False)

    def orders_near(self, grid: OrderGrid, order: float, span: float) -> tuple[Array, Family]:
        """Return orders of a joint within ``span`` of ``order``, and their family."""
        key = grid.joint, order, span
        if key not in self._orders_near:
            orders = order + np.linspace(-span, span, _ORDERS_TRIED)
            self._orders_near[key] = orders, self.orders(grid, orders)
        return self._orders_near[key]

    def steps(self, scan: StepScan, places: NDArray[np.int64]) -> StepFamily:
        """Return the steps of a form at the given places."""
        return StepFamily(self._system, scan, places, self._poses, self._adjoints)

    def steps_near(self, effect: Effect) -> tuple[StepScan, StepFamily] | None:
        """Return the steps of the same form at the places near that of ``effect``; None if none is searched."""
        key = effect.key()
        if key not in self._steps_near:
            scan = scan_for(self._step_scans, effect)
            near = None
            if scan is not None:
                places = near_places(scan, self._poses, scan.place_index(effect))
                near = (scan, self.steps(scan, places)) if places.size else None
            self._steps_near[key] = near
        return self._steps_near[key]

    def refined(self, effect: Effect) -> Sequence[BatchFamily]:
        """Return the forms in which a search refines an effect."""
        key = effect.key()
        if key not in self._refined:
            self._refined[key] = self.of(self._make_refined(effect))
        return self._refined[key]

    def beside(self, effect: Effect) -> Sequence[BatchFamily]:
        """Return the candidates that need an effect."""
        key = effect.key()
        if key not in self._beside:
            self._beside[key] = self.of(self._make_beside(effect))
        return self._beside[key]

    def of(self, batches: Sequence[Batch], shrunk: bool = False) -> list[BatchFamily]:
        """Return batches of effects, each with its family."""
        return [
            (batch, Family(self._system, self._joint_columns[:, batch.number], batch.basis, shrunk))
            for batch in batches
        ]
