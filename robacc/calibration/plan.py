"""Effects that a calibration fits, and its fits with and without shrinkage to the nominal values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect, effect_class
from robacc.effects.request import Request, build
from robacc.fitting.deflection_model import DeflectionChoice, choose_deflection
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.parsimony import without_idle_rotations
from robacc.fitting.solver import fit
from robacc.fitting.sparse_prior import ShrunkKind, shrink_to_nominal
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.refitting import refit
from robacc.tracing.search import search

_CONSTANTS = ("joint_offset", "link_geometry")
"""Effects whose coefficients all have a nominal value in the robot file."""


@dataclass(frozen=True)
class CalibrationPlan:
    """Requested effects: fixed effects are fitted as given, searched effects on the joints with evidence."""

    robot: Robot
    requests: Sequence[Request]
    priors: Mapping[str, float]
    """Standard deviation about zero, rad or m, by coefficient name; empty without priors."""
    shrink: bool
    """Constants that are requested for all joints are shrunk to nominal where there are no priors."""

    def searched(self, data: Measurements) -> tuple[Effect, ...]:
        """Return the searched effects on the joints with evidence."""
        requests = [request for request in self.requests if is_searched(request)]
        if not requests:
            return ()
        build(requests, Arm.of(self.robot), data)
        return search(Model.of(self.robot, self.fixed(data)), data, only=[r.name for r in requests]).effects

    def fixed(self, data: Measurements) -> tuple[Effect, ...]:
        """Return the effects that are fitted as requested."""
        return build([request for request in self.requests if not is_searched(request)], Arm.of(self.robot), data)

    def with_priors(self, options: Options, effects: Sequence[Effect], data: Measurements) -> Options:
        """Return ``options`` with the priors, infinite for coefficients without a prior."""
        if not self.priors:
            return options
        arm = Arm.of(self.robot)
        names = [term.name for effect in effects for term in effect.terms(arm, data)]
        return dataclasses.replace(options, priors=np.array([self.priors.get(name, np.inf) for name in names]))

    @property
    def all_joint_constants(self) -> tuple[str, ...]:
        """Names of constants that are requested for all joints."""
        return tuple(request.name for request in self.requests if request.name in _CONSTANTS and request.joints is None)

    def unshrunk(
        self, effects: tuple[Effect, ...], data: Measurements, options: Options, near: Fit | None = None
    ) -> tuple[Fit, DeflectionChoice | None]:
        """Return the fit of all effects, with the torque model of elastic effects that the data support.

        Without explicit priors, idle rotations are removed. ``near`` is a fit of the same effects to start from.
        """
        model, options = Model.of(self.robot, effects), self.with_priors(options, effects, data)
        fitted = fit(model, data, options) if near is None else refit(near, effects, data, options)
        chosen, model, deflection = choose_deflection(fitted, model, data, options)
        if self.priors:
            return chosen, deflection
        return without_idle_rotations(chosen, model, data, options), deflection

    def shrunk(self, chosen: Fit, data: Measurements, options: Options) -> tuple[Fit, tuple[ShrunkKind, ...]]:
        """Return the fit with constants shrunk to nominal, unless there are priors or the plan has no shrinkage."""
        if self.priors or not self.shrink:
            return chosen, ()
        return shrink_to_nominal(chosen, data, options, self.all_joint_constants)


def is_searched(request: Request) -> bool:
    """Return whether the joints of the requested effect are chosen by evidence."""
    cls = effect_class(request.name)
    return request.joints is None and cls.per_joint and not cls.is_constant
