"""Contract of effects and their registry: terms, settings, drivers, requirements and catalogue texts.

An effect is a scalar of the chain that varies by a known function of the circumstances: scalar += coefficient x
regressor. A :class:`Term` is one coefficient; its :class:`Part` s state which scalars it moves and by which regressor.
Its column of the Jacobian is then (column of that scalar) x (regressor), so no effect computes kinematics of its own.

To add an effect: one subclass of :class:`Effect` decorated with :func:`register`.
"""

from __future__ import annotations

import abc
import dataclasses
import difflib
import functools
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from robacc.effects.drivers import COLUMNS, Driver, Periods, Validity, driver_values, ranges, split
from robacc.errors import MissingColumnError, given, refuse
from robacc.geometry import Array
from robacc.gravity import Load, own_weight
from robacc.measurements import Measurements
from robacc.plug_ins import plug_ins
from robacc.robots.arm import Arm

_JOINT = "{joint}"
"""Stands for a joint's name in the name of a driver."""

# Settings of effects: fields of their dataclasses that declare how robot files and results state them.

_NOUNS = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("a name", "names"),
}
"""Singular and plural of a kind of value."""


class Setting(NamedTuple):
    """Declaration of a setting; see :func:`setting`."""

    default: Any
    key: str = ""
    """Key in files and results; by default the field's name."""
    written: bool | Callable[[Any], bool] = False
    """True if it is written even at its default; or a function of the effect that decides whether it is written."""
    unit: Literal["length", "angle"] | None = None
    """Unit of a robot file that its numbers follow."""
    choices: tuple[str, ...] = ()
    """Possible names, where the kind is not a ``Literal``."""
    above: float = -math.inf
    least: float = -math.inf
    below: float = math.inf
    most: float = math.inf
    """Limits of each number, in the units of the file; ``above`` and ``below`` are not possible themselves."""
    different: bool = False
    """True for a list of at least one number, where no two agree to six digits."""
    last: bool = False
    """True if it is written after the settings of subclasses."""
    field: str = ""
    """Name of the field."""
    kind: Any = None
    """Annotation of the field."""

    def read(self, value: Any) -> Any:
        """Return a value of a file as the field has it.

        Raises:
            ValueError: The value is not of the kind, or not within the limits.
        """
        try:
            result = self._converted(self.kind, value)
            if self.different and len({f"{number:.6g}" for number in result}) < max(len(result), 1):
                raise ValueError
        except (ValueError, OverflowError):
            raise ValueError(f"{self.key} must be {self._expected(self.kind)}, found {value!r}") from None
        return result

    def _converted(self, kind: Any, value: Any) -> Any:
        """Return a value of a file as a value of a kind; a ``ValueError`` without text where that is not possible."""
        parts = get_args(kind)
        if get_origin(kind) is tuple:
            if not isinstance(value, list | tuple):
                raise ValueError
            kinds = parts[:1] * len(value) if parts[-1] is ... else parts
            return tuple(self._converted(part, item) for part, item in zip(kinds, value, strict=True))
        if parts:
            return None if value is None else self._converted(parts[0], value)
        is_possible = (
            isinstance(value, (int, float) if kind is float else kind)
            and isinstance(value, bool) == (kind is bool)
            and (kind is str or (self.above < value < self.below and self.least <= value <= self.most))
            and (not self.choices or value in self.choices)
        )
        if not is_possible:
            raise ValueError
        return kind(value)

    def _expected(self, kind: Any, many: bool = False) -> str:
        """Return the values of a kind as text, in the plural if there are many."""
        parts = get_args(kind)
        if get_origin(kind) is tuple:
            count = "" if parts[-1] is ... else f"{len(parts)} "
            different = "different " if self.different else ""
            return f"{'lists' if many else 'a list'} of {count}{different}{self._expected(parts[0], True)}"
        if parts:
            return self._expected(parts[0], many)
        if self.choices:
            return f"some of {', '.join(self.choices)}" if many else " or ".join(self.choices)
        limits = {"above": self.above, "of at least": self.least, "below": self.below, "at most": self.most}
        texts = [f"{text} {limit:g}" for text, limit in limits.items() if math.isfinite(limit)]
        return " ".join((_NOUNS[kind][many], " and ".join(texts))).rstrip()


def setting(default: Any, **declared: Any) -> Any:
    """Return the field of an effect's dataclass that is a setting of this default.

    The annotation is the kind of its values: ``bool``, ``int``, ``float``, ``str``, a ``Literal`` of names, a tuple of
    kinds (in files a list), or one of these ``| None``, where null is none.

    Args:
        default: Value of an effect whose file does not have the setting.
        declared: Other attributes of :class:`Setting`, such as ``key``, ``above`` and ``unit``.
    """
    return dataclasses.field(default=default, metadata={"setting": Setting(default, **declared)})


@functools.cache
def settings_of(effect: type) -> Mapping[str, Setting]:
    """Return the settings of a class of effects by key, in the order in which they are written."""
    hints, settings = get_type_hints(effect), []
    for field in dataclasses.fields(effect):
        if declared := field.metadata.get("setting"):
            kind = hints[field.name]
            of_names = {"kind": str, "choices": get_args(kind)} if get_origin(kind) is Literal else {"kind": kind}
            settings.append(declared._replace(key=declared.key or field.name, field=field.name, **of_names))
    return {declared.key: declared for declared in sorted(settings, key=lambda declared: declared.last)}


def as_plain(value: Any) -> Any:
    """Return a setting's value with lists in place of tuples."""
    return [as_plain(item) for item in value] if isinstance(value, tuple) else value


def scaled(value: Any, size: float) -> Any:
    """Return a setting's value with each of its numbers times ``size``."""
    return tuple(scaled(item, size) for item in value) if isinstance(value, tuple) else value * size


# Coefficients of effects, and the scalars of the chain that they move.

SCALE_OF_INSTRUMENT = -1
"""Pseudo-motion: the measured position itself, multiplied by 1 + scalar."""
RADIUS = -2
"""Pseudo-motion: the radius of the sphere that a row touches, m."""
FOLLOWED_SHARE = 0.5
"""Share from which the joints read back describe the arm better than those commanded."""
FEWEST = 8
"""Least rows of a group, and least different angles of an order, so that some remain when others are held out."""
LEAST_OF_CONSTANT = 1e-3
"""Least independent part of the column of a length or angle of the arm. Its other lengths and angles are wrong by about
1 mm and 1 mrad, so that the column itself is known to this share only; a smaller independent part is an error of the
model. With a tool that stays vertical within 0.5 mrad, its height above the flange is such a length."""


class Part(NamedTuple):
    """One scalar that a term moves: by coefficient x factor, times the load's generalised force where it has a load.

    The generalised force is what gravity does to the loads behind the motion along it: N m for a rotation (the load's
    torque about the axis), N for a translation. It is positive along gravity, so a positive compliance sags.
    """

    motion: int
    factor: float | Array = 1.0
    """``(N,)`` regressor, or a constant."""
    loads: tuple[Load, ...] | None = None
    deflected: bool = True
    """True if the force is that at the deflected pose, in equilibrium; False at the undeflected pose."""


class Term(NamedTuple):
    """One coefficient of the model."""

    name: str
    """``effect.joint.term``, stable."""
    unit: str
    typical: float
    """A usual size of the coefficient on real arms."""
    parts: tuple[Part, ...]
    group: str | None = None
    """Terms of one group share a Gaussian prior of zero mean; its standard deviation is estimated from the data."""
    weight: float = 1.0
    """Prior standard deviation relative to the group's."""
    least_part: float = 0.0
    """Share of its column that must be independent of other columns for the coefficient to be identifiable."""
    stretch: float = 1.0
    """Factor of the effect's usual range on an arm that is much smaller or larger than usual."""

    @property
    def label(self) -> str:
        """Return the last part of the name: the constant, coordinate or polynomial."""
        return self.name.rpartition(".")[2]


def compliance_unit(arm: Arm, joint: str) -> str:
    """Return the unit of a joint's deflection by gravity's torque (N m) or force (N) on it."""
    return "rad/(N m)" if arm.is_revolute(joint) else "m/N"


# Catalogue texts of an effect.


class About(NamedTuple):
    """Catalogue texts of an effect."""

    summary: str
    equation: str
    unit: str
    usual_size: str
    usual_range: tuple[float, float]
    """Smallest and largest usual size of a coefficient, of the unit's first alternative, in SI."""
    needs: str
    confused_with: str
    source: str
    example: str
    """An entry of a robot file, in YAML, of an arm with joints j1 … j6 in m and rad."""


# Columns and masses that an effect needs.


def needed(column: Array | None, name: str, effect: str) -> Array:
    """Return a column that an effect needs.

    Raises:
        MissingColumnError: the data do not have it.
    """
    return given(column, f"{effect} needs the column {name}, which the poses do not have", MissingColumnError)


def commanded(data: Measurements, effect: str) -> Array:
    """Return the commanded joint variables ``(J, N)``."""
    return needed(data.q, "q1 … qN", effect)


def weight_needed(arm: Arm, data: Measurements, effect: str) -> tuple[Load, ...]:
    """Return the arm's own weight at the poses, which an effect needs.

    Raises:
        UsageError: the robot file has no masses.
    """
    refuse((not arm.chain.bodies, f"{effect} needs mass and com of the links, which the robot file does not have"))
    return own_weight(arm, data)


def driven_by(arm: Arm, data: Measurements, driver: str, effect: str) -> Array:
    """Return ``(N,)`` the values of a driver (:mod:`robacc.effects.drivers`) that an effect needs.

    Raises:
        UsageError: the data or the robot lack it.
    """
    values, (kind, _) = driver_values(arm, data, driver), split(arm, driver)
    if values is None and kind in ("torque", "signed_torque"):
        commanded(data, effect)
        weight_needed(arm, data, effect)
    return needed(values, COLUMNS.get(kind, "q1 … qN"), effect)


def varies(column: Array | None) -> bool:
    """Return whether a column exists and takes more than one value."""
    return column is not None and column.size > 1 and bool(np.ptp(column) > 0)


# What an effect is.


class Need(NamedTuple):
    """Something without which an effect cannot be fitted to a robot and its poses."""

    reason: str
    """Reason why the effect cannot be fitted, in one line."""
    is_met: Callable[[Arm, Measurements], bool]


TIME = Need("no time_s column that varies", lambda arm, data: varies(data.time))
DIRECTION = Need("no dir_q columns, and `ordered` is not set", lambda arm, data: varies(data.direction))
SPEED = Need("no speed_q columns, and `ordered` is not set", lambda arm, data: varies(data.speed))
MASSES = Need("no masses in the robot file", lambda arm, data: bool(arm.chain.bodies))


class Over(NamedTuple):
    """Driver over which the residual is drawn."""

    driver: str
    """A driver, with ``{joint}`` for the effect's joint."""
    is_only: bool = True
    """True if the effect is a function of this driver alone."""


class Beyond(NamedTuple):
    """What becomes of an effect beyond its validity range, in one driver."""

    is_held: bool
    """True if it keeps its value at the end of the range."""
    period: float | None = None
    """Change of the driver, SI, after which the effect repeats itself."""
    fading: float | None = None
    """How far beyond the range 0.6 of the effect is left, SI, where it fades to its level at the end of the range."""


class Traits(NamedTuple):
    """What an effect is, in all its forms or in one."""

    per_joint: bool = True
    """True if the effect acts on named joints, and is a candidate joint by joint."""
    only: Literal["revolute", "prismatic"] | None = None
    """Kind of the joints that have the effect; None for both."""
    joints_optional: bool = False
    """True if an effect on joints also has forms without a joint, of which the default is one."""
    needs: tuple[Need, ...] = ()
    """Needs of every form."""
    needs_of_usual_form: tuple[Need, ...] = ()
    """Further needs of the form that :meth:`Effect.usual` returns where they are met."""
    is_searched: bool = False
    """True if its forms are candidates only where a search makes them."""
    drivers: tuple[str, ...] = ("{joint}",)
    """Drivers (:mod:`robacc.effects.drivers`) whose range the model file keeps, with ``{joint}`` for each joint."""
    chart: Over | None = None
    """Driver over which the residual is drawn; None if it has no single driver."""
    extrapolates: str | None = None
    """Physical reason why the effect goes on beyond its validity range; None if it stops there."""
    is_bounded: bool = False
    """True if it is as large beyond its validity range as within: a periodic error."""
    is_constant: bool = False
    """True if every regressor is 1, so that the fitted value is written into the robot's own numbers."""
    is_frame: bool = False
    """True if it is the base or the tool frame, which registration fits from any start."""
    is_empirical: bool = False
    """True if it is a smooth correction without a physical cause."""
    is_of_measurement: bool = False
    """True if it belongs to one measurement, not to the arm: no command to the arm can or should correct it."""
    is_event: bool = False
    """True if it happened once, during one measuring campaign."""
    is_spring: bool = False
    """True if joints deflect about their axes under the arm's own weight."""
    is_nonnegative: bool = False
    """True if a coefficient in the effect's unit cannot be negative: nothing rises under its weight."""
    implausible_factor: float = 10.0
    """Multiple of the largest usual size beyond which a coefficient is implausible."""
    follows_approach: bool = False
    """True if the direction of approach decides it, so that a joint with a memory shows a part of it."""
    rejects_implausible: bool = False
    """True if implausible coefficients rule the form out; otherwise it only competes with a handicap."""
    prior_odds: float = 1.0
    """Prior odds of the form against the usual form of any effect."""
    covariance_term: str | None = None
    """Term of the covariance whose errors it describes; None of an effect with a cause."""
    shared_by: tuple[str, ...] | None = None
    """Fields of which forms have coefficients in common where they agree (orders 1, and 1 and 2); None: all fields."""


@dataclass(frozen=True)
class Effect(abc.ABC):
    """One effect on named joints. Subclasses with settings are frozen dataclasses, whose fields declare them."""

    joints: tuple[str, ...] = ()

    name: ClassVar[str]
    about: ClassVar[About]
    traits: ClassVar[Traits] = Traits()

    def __init_subclass__(cls) -> None:
        """Name an effect that states no name after its class: ``JointOffset`` is ``joint_offset``."""
        cls.name = vars(cls).get("name") or re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__).lower()

    @abc.abstractmethod
    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients, with regressors for the poses of ``data``.

        Raises:
            UsageError: the data or the robot lack what the effect needs.
        """

    def joint_term(
        self, arm: Arm, joint: str, regressor: Array | float, label: str = "", typical: float = 1e-4, **more: Any
    ) -> Term:
        """Return the term that adds coefficient x regressor ``(N,)`` to a joint's variable.

        ``more`` are other attributes of :class:`Term`; the unit is by default that of the variable.
        """
        name = f"{self.name}.{joint}.{label}" if label else f"{self.name}.{joint}"
        unit = more.pop("unit", arm.unit(joint))
        return Term(name, unit, typical, (Part(arm.axis_motion(joint), regressor),), **more)

    @classmethod
    def missing(cls, arm: Arm, data: Measurements, *, usual: bool = False) -> str | None:
        """Return the reason if the effect, or its ``usual`` form, cannot be fitted to these data; else None."""
        needs = (*cls.traits.needs, *(cls.traits.needs_of_usual_form if usual else ()))
        return next((need.reason for need in needs if not need.is_met(arm, data)), None)

    @property
    def form(self) -> Traits:
        """Return what this form of the effect is, where it differs from the traits of all forms."""
        return self.traits

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if fitted coefficients are beyond what the effect can be, in one sentence; else None.

        Coefficients in other units than the effect's first, and constants of the arm, are not judged.

        Args:
            terms: Coefficients of the effect.
            values: Their values, in the terms' units.
        """
        if self.traits.is_constant:
            return None
        unit = self.about.unit.partition(" (")[0].partition(",")[0].partition(";")[0]
        for term, value in zip(terms, values, strict=True):
            if term.unit != unit:
                continue
            low, high = (size * term.stretch for size in self.about.usual_range)
            if abs(value) > self.traits.implausible_factor * high:
                usual = f"{low:.2g} to {high:.2g}"
                return f"{term.name} = {value:.3g} {unit} is implausible; usual values are {usual} {unit}"
            if self.traits.is_nonnegative and value < 0:
                return f"{term.name} = {value:.3g} {unit} is implausible: it cannot be negative"
        return None

    @classmethod
    def possible_joints(cls, arm: Arm) -> tuple[str, ...]:
        """Return the joints the effect can act on."""
        names = arm.names if cls.traits.per_joint else ()
        return tuple(name for name in names if cls.traits.only in (None, arm.joint(name).type))

    @classmethod
    def checked_joints(cls, arm: Arm, joints: Sequence[str]) -> tuple[str, ...]:
        """Return the joints; raise UsageError for one that the effect cannot act on."""
        possible = cls.possible_joints(arm)
        can = f"it can on {', '.join(possible)}"
        refuse(*((joint not in possible, f"{cls.name} cannot act on {joint}; {can}") for joint in joints))
        return tuple(joints)

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return the effect requested by name alone: on all joints it can act on, or on ``joints``."""
        if joints is None:
            joints = () if cls.traits.joints_optional else cls.possible_joints(arm)
        return cls.usual(arm, data, tuple(joints))

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the usual form of the effect on ``joints``, none if it acts on no joint in particular."""
        return cls(joints)

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield the forms on one joint, or on none, that are candidates in a trace: by default the usual one."""
        yield cls.usual(arm, data, joints)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield every form that is a candidate in a trace: by default those of one joint at a time."""
        each = ((joint,) for joint in cls.possible_joints(arm)) if cls.traits.per_joint else ((),)
        for joints in () if cls.traits.is_searched else each:
            yield from cls.forms_on(arm, data, joints)

    @classmethod
    def beside(cls, other: Effect, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield forms that are candidates only given the finding ``other``; by default none."""
        yield from ()

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield forms of the same finding of which a search takes the best once it is chosen; by default none.

        Each moves one joint's variable, by terms of one part each.
        """
        yield from ()

    def settings(self) -> dict[str, Any]:
        """Return the settings other than the joints, as plain values for a robot file."""
        return {
            key: as_plain(getattr(self, declared.field))
            for key, declared in settings_of(type(self)).items()
            for is_always in [declared.written(self) if callable(declared.written) else declared.written]
            if is_always or (not callable(declared.written) and getattr(self, declared.field) != declared.default)
        }

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the effect in SI; its settings are in units of ``length`` m and ``angle`` rad."""
        changes = {
            declared.field: scaled(getattr(self, declared.field), length if declared.unit == "length" else angle)
            for declared in settings_of(type(self)).values()
            if declared.unit
        }
        return dataclasses.replace(self, **changes)

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the inverse of :meth:`settings`.

        Raises:
            ValueError: a setting is unknown or has a wrong value.
        """
        known = settings_of(cls)
        unknown = [key for key in settings if key not in known]
        refuse((unknown, f"{cls.name} has no setting {', '.join(map(repr, unknown))}"), error=ValueError)
        try:
            effect = cls(joints, **{known[key].field: known[key].read(value) for key, value in settings.items()})
            problem = effect.conflict(settings.keys())
            refuse((problem, problem or ""), error=ValueError)
        except ValueError as error:
            raise ValueError(f"{cls.name}: {error}") from None
        return effect

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if settings, each of which is possible, do not go together, in one line; else None.

        Args:
            given: Keys of the settings that the file states.
        """
        return None

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the driver over which the residual of the effect on ``joint`` is drawn; None if there is none."""
        chart = self.form.chart
        return (
            None
            if chart is None or (joint is None and _JOINT in chart.driver)
            else Driver.at(arm, data, chart.driver.replace(_JOINT, joint or ""), chart.is_only)
        )

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the drivers whose range the model file keeps; a constant has none."""
        drivers = () if self.traits.is_constant else self.form.drivers
        joints = ((driver, self.joints if _JOINT in driver else ("",)) for driver in drivers)
        return tuple(dict.fromkeys(driver.replace(_JOINT, joint) for driver, names in joints for joint in names))

    @property
    def uses_masses(self) -> bool:
        """True if its coefficients multiply torques of the masses as the robot file states them."""
        return MASSES in self.traits.needs or getattr(self, "masses", None) == "known"

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return what becomes of the effect beyond the range ``limits`` of one of its drivers, SI."""
        return Beyond(self.form.extrapolates is None)

    def limits(self, arm: Arm, validity: Validity, *, fading: bool = False) -> tuple[Validity, Periods]:
        """Return the ranges of the drivers beyond which it is held, or fades, and the periods of some of them."""
        rules = {name: self.beyond(arm, name, limits) for name, limits in validity.items()}
        chosen = {k: rule for k, rule in rules.items() if (rule.fading is not None if fading else rule.is_held)}
        periods = {name: rule.period for name, rule in chosen.items() if rule.period is not None}
        return {name: validity[name] for name in chosen}, periods

    def within(self, validity: Validity) -> Effect:
        """Return the effect as it is used on poses beyond ``validity``; an effect of the torque may limit that."""
        return self

    def validity(self, arm: Arm, data: Measurements) -> Validity:
        """Return the range of each driver over these poses."""
        return ranges(arm, data, self.validity_drivers(arm))

    def key(self) -> tuple[Any, ...]:
        """Return name, joints and settings: two effects with the same key are the same."""
        return (self.name, self.joints, repr(sorted(self.settings().items())))

    def term_key(self, term: Term) -> str:
        """Return the key of a term's column of the Jacobian, over all forms of all effects."""
        shared = self.traits.shared_by
        return f"{term.name}|{self.key() if shared is None else [getattr(self, name) for name in shared]}"

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return what a finding of fitted ``values`` means and what to do; None if its coefficients say it.

        ``between`` names the place of a searched change, and the first and last place that are as plausible.
        """
        return None

    def is_profile(self) -> bool:
        """Return whether it is a block of many terms, a candidate only if named terms leave structure."""
        return self.traits.is_empirical or self.form.covariance_term is not None

    def __str__(self) -> str:
        """Return the name with joints, as in ``backlash[j2]``."""
        return f"{self.name}[{','.join(self.joints)}]" if self.joints else self.name


REGISTRY: dict[str, type[Effect]] = {}
"""Effects by name, of the modules that are loaded; that of :mod:`robacc.effects` has all."""

E = TypeVar("E", bound=type[Effect])


def register(cls: E) -> E:
    """Add an effect to the catalogue (class decorator)."""
    REGISTRY[cls.name] = cls
    return cls


def load_plug_ins() -> None:
    """Add the effects of the entry points of the group ``robacc.effects``, whose modules register them."""
    list(plug_ins("robacc.effects"))


def effect_class(name: str) -> type[Effect]:
    """Return the effect called ``name``.

    Raises:
        UsageError: there is no such effect; the message suggests the nearest name and lists all.
    """
    known: dict[str, type[Effect]] = REGISTRY if name in REGISTRY else import_module("robacc.effects").REGISTRY
    if name not in known:
        load_plug_ins()
        hint = "".join(f", did you mean {match!r}?" for match in difflib.get_close_matches(name, known, n=1))
        refuse((name not in known, f"no effect {name!r}{hint or '.'} The catalogue: {', '.join(known)}"))
    return known[name]
