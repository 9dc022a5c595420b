"""Arms, errors, poses and one undeclared effect at its detection limit, all drawn at random."""

import dataclasses
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from arms import arm, model_of
from scipy import stats

from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.periodic import TransmissionError
from robacc.effects.specification import build, entry_of, parse_requests
from robacc.fitting.fit_result import Fit
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, observed_jacobian
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.candidates import Candidate, decisive_test, named_candidates, order_grids
from robacc.tracing.trace import Trace

FRAMES = "base_frame,tool_frame"
GEOMETRY = f"{FRAMES},joint_offset,link_geometry"
ALL_ARMS = ("puma560", "ur10", "irb1600", "panda", "stanford", "scara")
WITH_MASSES = ("puma560", "ur10", "panda", "stanford")


@dataclass(frozen=True)
class Kind:
    """One effect of the catalogue, how it is drawn, and what it is looked for beside."""

    effect: str
    settings: tuple[dict[str, Any], ...] = ()
    """Forms to draw from; empty: any."""
    arms: tuple[str, ...] = ALL_ARMS
    declared: str = GEOMETRY
    temperature: bool = True


KINDS: dict[str, Kind] = {
    "gear_ratio": Kind("gear_ratio"),
    "joint_coupling": Kind("joint_coupling"),
    "order 1": Kind("transmission_error", ({"orders": [1.0]},)),
    "order 2": Kind("transmission_error", ({"orders": [2.0]},)),
    "whole order": Kind("transmission_error", tuple({"orders": [float(n)]} for n in range(3, 25))),
    "fractional order": Kind(
        "transmission_error", tuple({"orders": [n + 0.1 * k]} for n in range(3, 25) for k in (3, 5, 7))
    ),
    "backlash": Kind("backlash"),
    "approach_lag": Kind("approach_lag"),
    "joint_compliance": Kind("joint_compliance", ({},), WITH_MASSES),
    "lateral_compliance": Kind("lateral_compliance", (), WITH_MASSES),
    "payload_compliance": Kind("payload_compliance"),
    "base_compliance": Kind("base_compliance", (), WITH_MASSES),
    "axis_wobble": Kind("axis_wobble", tuple({"orders": [n]} for n in (1.0, 2.0))),
    "thermal_expansion": Kind("thermal_expansion"),
    "warm-up": Kind("thermal_expansion", temperature=False),
    "frame_drift": Kind("frame_drift"),
    "instrument_scale": Kind("instrument_scale", declared=f"{FRAMES},joint_offset"),
    "joint_offset": Kind("joint_offset", declared=FRAMES),
    "link_geometry": Kind("link_geometry", declared=FRAMES),
}


@dataclass(frozen=True)
class Draw:
    """One arm with one effect that nobody declared."""

    where: str
    effect: Effect
    values: dict[str, float]
    """At the detection limit."""
    robot: Robot
    """As delivered."""
    built: Robot
    """As it is, but for the effect."""
    plan: Plan
    declared: str
    left_out: int
    """Draws before it that no size would have shown."""
    level: float
    """Of the F test, corrected for everything that competes."""
    noncentrality: float
    """At the detection limit."""
    freedom: int
    """Degrees of freedom of the residual beside the declared effects."""
    line: float
    """Orders nearer than this are one: half a period apart over the range that the joint was seen in."""

    def measured(self, times: float) -> Measurements:
        """Poses of the arm with the effect so many times its limit."""
        values = {name: times * value for name, value in self.values.items()}
        whole = dataclasses.replace(self.built, effects=(*self.built.effects, entry_of(self.effect, values)))
        return simulate(whole, self.plan).data

    def power(self, times: float) -> float:
        """Of the F test at so many times the limit."""
        rank, freedom = len(self.values), self.freedom - len(self.values)
        critical = stats.f.isf(self.level, rank, freedom)
        return float(stats.ncf.sf(critical, rank, freedom, times**2 * self.noncentrality))

    def model(self, data: Measurements) -> Model:
        """The robot as delivered, with what is declared."""
        return model_of(self.robot, self.declared, data)

    def is_named(self, found: Trace) -> bool:
        """Whether the effect on its joint is the only finding, or an alternative of it."""
        if len(found.findings) != 1:
            return False
        one = found.findings[0]
        return any(
            (other.effect, other.joints) == (self.effect.name, self.effect.joints) and self._is_alike(other.settings)
            for other in (one, *one.alternatives)
        )

    def _is_alike(self, settings: dict[str, Any]) -> bool:
        """The same driver of a coupling, and the order of a periodic error."""
        truth = self.effect.settings()
        (order,) = truth.get("orders", (0.0,))
        return settings.get("drivers") == truth.get("drivers") and any(
            abs(order - other) < self.line for other in settings.get("orders", (order,))
        )


def draw(kind: Kind, seed: int) -> Draw:
    """An arm, its errors, the poses and an effect on some joint at its detection limit, all at random."""
    rng = np.random.default_rng([seed, zlib.crc32(repr(kind).encode())])
    name = kind.arms[int(rng.integers(len(kind.arms)))]
    robot = arm(name).robot
    noise = float(rng.uniform(2e-5, 5e-5))
    plan = Plan(
        int(rng.integers(100, 151)),
        seed=int(rng.integers(1 << 30)),
        noise_position=noise,
        noise_orientation=1e-4,
        orientation=bool(rng.random() < 1 / 3),
        time_step=30.0,
        temperature=(18.0, 30.0) if kind.temperature else None,
        payloads=(0.0, 2.0, 5.0),
    )
    built = erring(robot, rng, "joint_offset" in kind.declared, "link_geometry" in kind.declared)
    blank = simulate(built, plan).data
    declared = fit(model_of(robot, kind.declared, blank), blank)
    forms = list(_forms(kind, declared.model.arm, blank))
    for left_out, number in enumerate(rng.permutation(len(forms))):
        effect, log_prior = forms[number]
        seen = _seen(effect, declared, blank, plan, rng)
        if seen is not None:
            values, square, freedom = seen
            test = decisive_test(len(values), freedom, log_prior)
            needed = test.noncentrality_at_limit
            size = math.sqrt(needed / square)
            if size <= 300 * effect.terms(declared.model.arm, blank)[0].typical:
                at_limit = {key: size * value for key, value in values.items()}
                return Draw(
                    name,
                    effect,
                    at_limit,
                    robot,
                    built,
                    plan,
                    kind.declared,
                    left_out,
                    test.level,
                    needed,
                    freedom,
                    _line(effect, declared.model.arm, blank),
                )
    raise AssertionError(f"no form of {kind.effect} shows on {name}")


def erring(robot: Robot, rng: np.random.Generator, offsets: bool, lengths: bool) -> Robot:
    """The arm as it was built: base and tool elsewhere, and zeros and links off by what is usual."""
    base, tool = (
        Frame(
            tuple(x + float(rng.normal(scale=size)) for x in frame.xyz),  # type: ignore[arg-type]
            tuple(x + float(rng.normal(scale=size)) for x in frame.rpy),  # type: ignore[arg-type]
        )
        for frame, size in ((robot.base, 2e-2), (robot.tool, 2e-3))
    )
    one = Arm.of(robot)
    entries = []
    for cls in (REGISTRY[name] for name, wanted in (("joint_offset", offsets), ("link_geometry", lengths)) if wanted):
        effect = cls.default(one, Measurements(np.zeros((3, 1)), q=np.zeros((len(one.names), 1))))
        terms = effect.terms(one, Measurements(np.zeros((3, 1)), q=np.zeros((len(one.names), 1))))
        scale = {"rad": 1e-3 if cls.name == "joint_offset" else 3e-4, "m": 3e-4}
        values = {t.name: float(rng.normal(scale=scale[t.unit])) for t in terms if not t.name.endswith(".beta")}
        entries.append(entry_of(effect, values))
    return dataclasses.replace(robot, base=base, tool=tool, effects=tuple(entries))


def _forms(kind: Kind, one: Arm, data: Measurements) -> Iterator[tuple[Effect, float]]:
    """Forms of the kind with the log of their prior probability in the trace."""
    if kind.effect == "transmission_error" and kind.settings[0]["orders"][0] > 2:
        for grid in order_grids(one, data):
            for settings in kind.settings:
                (order,) = settings["orders"]
                if grid.orders[0] <= order <= grid.orders[-1]:
                    effect = TransmissionError((grid.joint,), (order,))
                    yield effect, Candidate(effect, effect.terms(one, data), grid.log_prior).log_prior_of_size
        return
    declared = build(parse_requests(kind.declared), one, data)
    for candidate in named_candidates(one, data, declared)[0]:
        settings = candidate.effect.settings()
        if candidate.effect.name != kind.effect:
            continue
        if kind.settings and not any(all(settings.get(k) == v for k, v in s.items()) for s in kind.settings):
            continue
        if len({term.unit for term in candidate.terms}) == 1:
            yield candidate.effect, candidate.log_prior_of_size


def _seen(
    effect: Effect, declared: Fit, data: Measurements, plan: Plan, rng: np.random.Generator
) -> tuple[dict[str, float], float, int] | None:
    """Coefficients of unit length in a random direction, their noncentrality, and the residual's degrees of freedom.

    From columns and noise as they are, by QR, and not from the trace's own algebra. None where the declared effects
    mimic it.
    """
    columns = _columns(declared, effect, data, plan)
    known = declared.identifiability.columns
    basis = np.linalg.qr(columns[:, known])[0]
    own = columns[:, len(declared.terms) :]
    way = rng.normal(size=own.shape[1])
    if effect.traits.is_nonnegative:
        way = np.abs(way)  # No spring rises under a weight: no arm has the effect with a negative coefficient.
    way /= np.linalg.norm(way)
    moved = own @ way
    new = moved - basis @ (basis.T @ moved)
    new -= basis @ (basis.T @ new)
    if new @ new < 1e-6 * (moved @ moved) or moved @ moved == 0:
        return None
    terms = effect.terms(declared.model.arm, data)
    values = {term.name: float(part) for term, part in zip(terms, way, strict=True)}
    return values, float(new @ new), columns.shape[0] - known.size


def _line(effect: Effect, one: Arm, data: Measurements) -> float:
    if data.q is None or not effect.joints:
        return math.inf
    return math.pi / float(np.ptp(data.q[one.number(effect.joints[0])]))


def _columns(declared: Fit, effect: Effect, data: Measurements, plan: Plan) -> Array:
    """``(M N, P + Q)`` columns of the declared effects and of one more, over the noise."""
    bound = declared.model.with_free(effect).bind(data)
    theta = np.concatenate((declared.theta, np.zeros(len(bound.terms) - declared.theta.size)))
    _, jacobian = bound.linearise(theta)
    rows = observed_jacobian(jacobian, declared.residual)
    rows[:3] /= plan.noise_position
    rows[3:] /= plan.noise_orientation
    return np.moveaxis(rows, 1, 2).reshape(-1, rows.shape[1])
