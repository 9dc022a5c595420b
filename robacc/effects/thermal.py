"""Effects of temperature and of time: links that grow, joints that warm up, a base that drifts."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE, Scalar
from robacc.effects.base import (
    TIME,
    About,
    Beyond,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    commanded,
    needed,
    register,
    setting,
    varies,
)
from robacc.effects.frames import frame_terms
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_SHARES = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Time constants of the candidates, as shares of the time span of the poses."""


@register
@dataclass(frozen=True)
class ThermalExpansion(Effect):
    """Every length of the arm in proportion to itself times T - T_ref, or 1 - exp(-t / t0) while it warms up."""

    reference: float = setting(20.0, key="reference_c", written=lambda expansion: expansion.time_constant is None)
    """Degrees Celsius, at which lengths have their nominal value; that of ISO 1."""
    time_constant: float | None = setting(None, key="time_constant_s", above=0.0)
    """s; None: by temperature."""
    slides: bool = setting(True)
    """True if a slide's travel grows as the links do; False if its scale does not grow."""

    name = "thermal_expansion"
    traits = Traits(
        per_joint=False,
        needs=(
            Need(
                "neither temperature_c nor time_s varies",
                lambda arm, data: varies(data.temperature) or varies(data.time),
            ),
        ),
        implausible_factor=3.0,
    )
    about = About(
        summary="the links grow with temperature, or as the arm warms up where no temperature was logged",
        equation="d_j, a_j (1 + k (T - T_ref)), all j, a slide's travel with them unless slides: false; or (1 + k (1 - "
        "exp(-t / t0))) with t0 searched",
        unit="1/K (1 by time)",
        usual_size="1.2e-5 (steel) to 2.4e-5 (aluminium) per K",
        usual_range=(1.2e-05, 2.4e-05),
        needs="temperature_c that varies, else time_s",
        confused_with="instrument_scale at one temperature, frame_drift in one region of the workspace",
        source="ISO 1 for the reference temperature; Renders et al. 1991 for the size",
        example="{effect: thermal_expansion, reference_c: 20, values: {value: 1.2e-5}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the expansion by temperature if it was logged, else a warm-up over a third of the time."""
        if data.temperature is not None or data.time is None:
            return cls()
        return cls(time_constant=float(np.ptp(data.time)) / 3 or 1.0)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the expansion by temperature, else warm-ups of several time constants; slides grow or not."""
        constants: list[float | None] = [None]
        if not varies(data.temperature):
            span = float(np.ptp(needed(data.time, "time_s", cls.name)))
            constants = [span * share for share in (*_SHARES, 1.6)]
        for slides in (True, False) if _travels(arm) else (True,):
            yield from (cls(time_constant=constant, slides=slides) for constant in constants)

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the temperature, or the time of a warm-up."""
        return ("temperature_c" if self.time_constant is None else "time_s",)

    def chart(self) -> Over:
        """Return the same."""
        return Over("temperature_c" if self.time_constant is None else "time_s", is_only=False)

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that a warm-up is held; lengths go on in proportion to temperature (linear expansion)."""
        return Beyond(is_held=self.time_constant is not None)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term that moves every length."""
        if self.time_constant is None:
            rise = needed(data.temperature, "temperature_c", self.name) - self.reference
            unit, typical = "1/K", 1e-5
        else:
            rise = 1 - np.exp(-needed(data.time, "time_s", self.name) / self.time_constant)
            unit, typical = "1", 1e-4
        motions = arm.chain.motions
        lengths: dict[int, Scalar] = {k: motions[k].value for k in arm.lengths if motions[k].value != 0}
        if self.slides and (travels := _travels(arm)):
            travelled = arm.chain.scalars(commanded(data, self.name))
            lengths.update({k: travelled[k] for k in travels})
        return (Term(self.name, unit, typical, tuple(Part(k, length * rise) for k, length in sorted(lengths.items()))),)


def _travels(arm: Arm) -> set[int]:
    """Return motions that prismatic joints drive."""
    return {drive.motion for drive in arm.chain.drives if arm.chain.motions[drive.motion].kind == "translation"}


@register
@dataclass(frozen=True)
class JointWarmup(Effect):
    """Joint variable shifted by c (1 - exp(-t / t0)): a body of one heat capacity under a constant loss of heat."""

    time_constant: float = setting(1800.0, key="time_constant_s", written=True, above=0.0)
    """s"""
    origin: float = setting(0.0, key="origin_s", written=True)
    """s, the time from which the joint warms up."""

    name = "joint_warmup"
    traits = Traits(needs=(TIME,), drivers=("time_s",), chart=Over("time_s", is_only=False))
    about = About(
        summary="the joint's zero shifts while its motor and gear warm up; each joint has a time constant of its own",
        equation="theta_j + c (1 - exp(-(t - t_first) / t0)), t0 searched",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-5 to 1e-3 rad after warm-up, in minutes (wrist) to hours (base)",
        usual_range=(1e-5, 1e-3),
        needs="time_s",
        confused_with="step of the joint where it is fast, frame_drift at the first joint, thermal_expansion",
        source="Gong, Yuan, Ni, Int. J. Machine Tools and Manufacture 40 (2000) 2119: thermal errors of joints; "
        "Newton's law of cooling for the shape",
        example="{effect: joint_warmup, joints: [j2], time_constant_s: 1800, origin_s: 0, values: {j2: 2e-4}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a warm-up over a third of the time."""
        time = needed(data.time, "time_s", cls.name)
        return cls(joints, float(np.ptp(time)) / 3 or cls.time_constant, float(time.min()))

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield several time constants."""
        time = needed(data.time, "time_s", cls.name)
        start, span = float(time.min()), float(np.ptp(time))
        yield from (cls(joints, float(f"{span * share:.3g}"), start) for share in _SHARES)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        elapsed = np.maximum(needed(data.time, "time_s", self.name) - self.origin, 0.0)
        risen = 1 - np.exp(-elapsed / self.time_constant)
        return tuple(self.joint_term(arm, joint, risen) for joint in self.joints)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the time constant, and the time until the joint is warm."""
        minutes = self.time_constant / 60
        return (
            f"the time constant is {minutes:.3g} min, and 95 % of the shift is over after {3 * minutes:.3g} min; warm "
            "the arm up before you measure or use it"
        )


@register
@dataclass(frozen=True)
class FrameDrift(Effect):
    """Base coordinates with a polynomial of time, about the time in the middle of the poses."""

    origin: float = setting(0.0, key="origin_s", written=True)
    """s, the time at which there is no drift."""
    span: float = setting(1.0, key="span_s", written=True, above=0.0)
    """s, the unit of time: a coefficient is the drift over it."""
    degree: int = setting(1, written=True, least=1, most=9)
    turning: bool = setting(False, written=True)
    """True if the base turns too."""

    name = "frame_drift"
    traits = Traits(
        per_joint=False,
        needs=(TIME,),
        drivers=("time_s",),
        chart=Over("time_s", is_only=False),
        is_of_measurement=True,
    )
    about = About(
        summary="the base moves against the instrument: a tripod settles, a pedestal warms up, the floor sinks",
        equation="base x, y, z (and its rotations) + c ((t - t_mid) / span)^p, p = 1 … degree",
        unit="m, rad over the time span",
        usual_size="1e-5 to 1e-3 m",
        usual_range=(1e-05, 0.001),
        needs="time_s",
        confused_with="thermal_expansion where temperature rises with time",
        source="a parameter times a regressor, as every effect here",
        example="{effect: frame_drift, origin_s: 1800, span_s: 1800, degree: 2, values: {x: 1e-4, z2: -5e-5}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a straight and steady drift about the middle of the time, in units of half the time span."""
        time = needed(data.time, "time_s", cls.name)
        low, high = float(np.min(time)), float(np.max(time))
        return cls(origin=(low + high) / 2, span=(high - low) / 2 or 1.0)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a straight and steady drift, one that turns too, and curved ones."""
        for degree, turning in ((1, False), (1, True), (2, False), (3, False), (3, True)):
            yield dataclasses.replace(cls.usual(arm, data, ()), degree=degree, turning=turning)  # type: ignore[call-arg]

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return three or six terms per power of time."""
        elapsed = (needed(data.time, "time_s", self.name) - self.origin) / self.span
        return tuple(
            term
            for power in range(1, self.degree + 1)
            for term in frame_terms(
                arm,
                BASE,
                self.name,
                elapsed**power,
                turning=self.turning,
                suffix=f"{power}" if power > 1 else "",
            )
        )
