"""Contract of effects and their registry: terms, settings, drivers, requirements and catalogue texts.

An effect is a scalar of the chain that varies by a known function of the circumstances: scalar += coefficient x
regressor. A :class:`Term` is one coefficient; its :class:`Part` s state which scalars it moves and by which regressor.
Its column of the Jacobian is then (column of that scalar) x (regressor), so no effect computes kinematics of its own.

To add an effect: one file in this folder with one subclass of :class:`Effect` decorated with :func:`register`.
"""

from __future__ import annotations

import abc
import dataclasses
import difflib
import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from robacc.effects.validity import Validity, ranges
from robacc.errors import MissingColumnError, UsageError
from robacc.geometry import Array
from robacc.gravity.loads import Load, own_weight
from robacc.gravity.torques import gravity_torques, weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

# Settings of effects: fields of their dataclasses that declare how robot files and results state them.

_NOUNS = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("a name", "names"),
}
"""Singular and plural of a kind of value."""


@dataclass(frozen=True, slots=True)
class Setting:
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

    def is_written(self, effect: Any) -> bool:
        """Return whether the settings of ``effect`` contain this one."""
        if callable(self.written):
            return self.written(effect)
        return self.written or getattr(effect, self.field) != self.default

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
        if not isinstance(value, (int, float) if kind is float else kind) or isinstance(value, bool) != (kind is bool):
            raise ValueError
        within = kind is str or (self.above < value < self.below and self.least <= value <= self.most)
        if not within or (self.choices and value not in self.choices):
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
            kind, choices = hints[field.name], declared.choices
            if get_origin(kind) is Literal:
                kind, choices = str, get_args(kind)
            key = declared.key or field.name
            settings.append(dataclasses.replace(declared, key=key, choices=choices, field=field.name, kind=kind))
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
LEAST_OF_CONSTANT = 1e-3
"""Least independent part of the column of a length or angle of the arm. Its other lengths and angles are wrong by about
1 mm and 1 mrad, so that the column itself is known to this share only; a smaller independent part is an error of the
model. With a tool that stays vertical within 0.5 mrad, its height above the flange is such a length."""


@dataclass(frozen=True, slots=True)
class Part:
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


@dataclass(frozen=True, slots=True)
class Term:
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

    @property
    def label(self) -> str:
        """Return the last part of the name: the constant, coordinate or polynomial."""
        return self.name.rpartition(".")[2]


def joint_terms(effect: str, arm: Arm, regressors: Mapping[str, Array]) -> tuple[Term, ...]:
    """Return one term a joint, which adds coefficient x regressor ``(N,)`` to its variable; of about 0.1 mrad or mm."""
    return tuple(
        Term(f"{effect}.{joint}", arm.unit(joint), 1e-4, (Part(arm.axis_motion(joint), regressor),))
        for joint, regressor in regressors.items()
    )


# Catalogue texts of an effect.


@dataclass(frozen=True, slots=True)
class About:
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
    if column is None:
        raise MissingColumnError(f"{effect} needs the column {name}, which the poses do not have")
    return column


def commanded(data: Measurements, effect: str) -> Array:
    """Return the commanded joint variables ``(J, N)``."""
    return needed(data.q, "q1 … qN", effect)


def weight_needed(arm: Arm, data: Measurements, effect: str) -> tuple[Load, ...]:
    """Return the arm's own weight at the poses, which an effect needs.

    Raises:
        UsageError: the robot file has no masses.
    """
    _require_masses(arm, effect)
    return own_weight(arm, data)


def torques_needed(arm: Arm, data: Measurements, effect: str) -> Array:
    """Return ``(J, N)`` gravity's torque (N m) or force (N) on each joint by the arm's own weight."""
    commanded(data, effect)
    _require_masses(arm, effect)
    return weight_torques(arm, data)


def _require_masses(arm: Arm, effect: str) -> None:
    if not arm.chain.bodies:
        raise UsageError(f"{effect} needs mass and com of the links, which the robot file does not have")


def varies(column: Array | None) -> bool:
    """Return whether a column exists and takes more than one value."""
    return column is not None and column.size > 1 and bool(np.ptp(column) > 0)


# The driver of an effect: the quantity, one number per pose, that the effect is a function of.

_CIRCUMSTANCES = {"payload_kg": ("payload", "kg"), "temperature_c": ("temperature", "°C"), "time_s": ("time", "s")}
"""Field of :class:`Measurements` and unit of each circumstance, by its column."""


@dataclass(frozen=True, slots=True)
class Driver:
    """One quantity that varies from pose to pose."""

    name: str
    """A joint's name, or ``torque``, ``payload_torque``, ``direction``, ``speed``, ``time_s``, ``temperature_c``,
    ``payload_kg``, ``distance``.
    """
    unit: str
    values: Array
    """``(N,)``"""
    is_only: bool
    """True if the effect is a function of this driver alone."""
    swept: Callable[[Array], Measurements] | None = None
    """Make poses that differ in the driver alone, from its values; None where no poses can be made for it."""


def joint_driver(arm: Arm, data: Measurements, joint: str, *, is_only: bool = True) -> Driver:
    """Return a joint's own variable, in rad or m."""
    q = commanded(data, "a driver")
    number = arm.number(joint)

    def swept(values: Array) -> Measurements:
        poses = _median_joints(q, values.size)
        poses[number] = values
        return _poses_at(poses)

    return Driver(joint, arm.unit(joint), q[number], is_only, swept)


def torque_driver(
    arm: Arm, data: Measurements, joint: str, *, is_only: bool = True, loads: tuple[Load, ...] | None = None
) -> Driver:
    """Return gravity's torque (N m) or force (N) on a joint: of the arm's own weight, or of the payload ``loads``."""
    q = commanded(data, "a torque")
    torque = gravity_torques(arm, q, own_weight(arm, data) if loads is None else loads)[arm.number(joint)]
    name = "torque" if loads is None else "payload_torque"
    return Driver(name, "N m" if arm.is_revolute(joint) else "N", torque, is_only)


def circumstance_driver(name: str, data: Measurements, *, is_only: bool = False) -> Driver:
    """Return ``time_s``, ``temperature_c`` or ``payload_kg``."""
    field, unit = _CIRCUMSTANCES[name]

    def swept(values: Array) -> Measurements:
        poses = _poses_at(_median_joints(commanded(data, "a driver"), values.size))
        return dataclasses.replace(poses, **{field: values})  # type: ignore[arg-type]

    return Driver(name, unit, needed(getattr(data, field), name, "a driver"), is_only, swept)


def is_circumstance(name: str) -> bool:
    """Return whether ``name`` is a circumstance's column, not a joint or a torque."""
    return name in _CIRCUMSTANCES


def _median_joints(q: Array, n: int) -> Array:
    """Return ``(J, n)`` median of the joint variables ``(J, N)``, n times."""
    return np.repeat(np.median(q, axis=1, keepdims=True), n, axis=1)


def _poses_at(q: Array) -> Measurements:
    rows: NDArray[np.int64] = np.arange(1, q.shape[1] + 1)
    return Measurements(position=np.zeros((3, rows.size)), q=q, rows=rows)


@dataclass(frozen=True)
class Effect(abc.ABC):
    """One effect on named joints. Subclasses are frozen dataclasses; their fields declare the effect's settings."""

    joints: tuple[str, ...] = ()

    name: ClassVar[str]
    about: ClassVar[About]
    is_constant: ClassVar[bool] = False
    """True if every regressor is 1, so that the fitted value is written into the robot's own numbers."""
    per_joint: ClassVar[bool] = True
    """True if the effect acts on named joints, and is a candidate joint by joint."""
    only_revolute: ClassVar[bool] = False
    """True if only revolute joints have the effect."""
    joints_optional: ClassVar[bool] = False
    """True if an effect on joints also has forms without a joint."""
    is_frame: ClassVar[bool] = False
    """True if it is the base or the tool frame, which registration fits from any start."""
    is_empirical: ClassVar[bool] = False
    """True if it is a smooth correction without a physical cause."""
    is_of_measurement: ClassVar[bool] = False
    """True if it belongs to one measurement, not to the arm: no command to the arm can or should correct it."""
    shares_terms: ClassVar[bool] = False
    """True if forms of the effect have coefficients in common (order 1 alone, and with order 2)."""
    implausible_factor: ClassVar[float] = 10.0
    """Multiple of the largest usual size beyond which a coefficient is implausible."""
    is_spring: ClassVar[bool] = False
    """True if joints deflect about their axes under the arm's own weight."""
    is_nonnegative: ClassVar[bool] = False
    """True if a coefficient in the effect's unit cannot be negative: nothing rises under its weight."""
    extrapolates: ClassVar[str | None] = None
    """Physical reason why the effect goes on beyond its validity range; None if it stops there."""
    is_bounded: ClassVar[bool] = False
    """True if it is as large beyond its validity range as within: a periodic error."""
    odds_beside: ClassVar[float] = 1.0
    """Prior odds of each form that is a candidate only given a finding, against a form of any other effect."""
    missing_reasons: ClassVar[tuple[str, ...]] = ()
    """Every text that :meth:`missing` can return, except texts that name a part of a robot."""

    @abc.abstractmethod
    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients, with regressors for the poses of ``data``.

        Raises:
            UsageError: the data or the robot lack what the effect needs.
        """

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if the effect cannot be fitted to this robot and these data, in one line; else None."""
        return None

    @classmethod
    def missing_form(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if the usual form of a possible effect cannot be fitted, in one line; else None."""
        return None

    @property
    def rejects_implausible(self) -> bool:
        """Return whether implausible coefficients rule this form out; otherwise it only competes with a handicap."""
        return False

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if fitted coefficients are beyond what the effect can be, in one sentence; else None.

        Coefficients in other units than the effect's first, and constants of the arm, are not judged.

        Args:
            terms: Coefficients of the effect.
            values: Their values, in the terms' units.
        """
        if self.is_constant:
            return None
        unit = self.about.unit.partition(" (")[0].partition(",")[0].partition(";")[0]
        limit = self.implausible_factor * self.about.usual_range[1]
        for term, value in zip(terms, values, strict=True):
            if term.unit != unit:
                continue
            if abs(value) > limit:
                usual = f"{self.about.usual_range[0]:.2g} to {self.about.usual_range[1]:.2g}"
                return f"{term.name} = {value:.3g} {unit} is implausible; usual values are {usual} {unit}"
            if self.is_nonnegative and value < 0:
                return f"{term.name} = {value:.3g} {unit} is implausible: it cannot be negative"
        return None

    @classmethod
    def possible_joints(cls, arm: Arm) -> tuple[str, ...]:
        """Return the joints the effect can act on."""
        if not cls.per_joint:
            return ()
        return tuple(name for name in arm.names if arm.is_revolute(name) or not cls.only_revolute)

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return the effect requested by name alone: on all joints it can act on, or on ``joints``."""
        return cls(joints=tuple(joints) if joints is not None else cls.possible_joints(arm))

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield every form that is a candidate in a trace: by default one joint at a time."""
        if cls.per_joint:
            yield from (cls(joints=(joint,)) for joint in cls.possible_joints(arm))
        else:
            yield cls()

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
            if declared.is_written(self)
        }

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the effect in SI; its settings are in units of ``length`` m and ``angle`` rad."""
        sizes = {"length": length, "angle": angle}
        changes = {
            declared.field: scaled(getattr(self, declared.field), sizes[declared.unit])
            for declared in settings_of(type(self)).values()
            if declared.unit
        }
        return dataclasses.replace(self, **changes)

    def apply(self, arm: Arm, values: Mapping[str, float]) -> Robot:
        """Return the robot with fitted values written into its own numbers; only for an effect that is constant."""
        raise TypeError(f"{self.name} is not constant")

    @classmethod
    def covering(cls, effects: Sequence[Effect]) -> Effect:
        """Return one effect that has every coefficient of ``effects``, of this class; only of constant effects."""
        return effects[0] if len(effects) == 1 else cls(tuple(dict.fromkeys(j for e in effects for j in e.joints)))

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the inverse of :meth:`settings`.

        Raises:
            ValueError: a setting is unknown or has a wrong value.
        """
        known = settings_of(cls)
        if unknown := [key for key in settings if key not in known]:
            raise ValueError(f"{cls.name} has no setting {', '.join(map(repr, unknown))}")
        try:
            effect = cls(joints, **{known[key].field: known[key].read(value) for key, value in settings.items()})
            if problem := effect.conflict(settings.keys()):
                raise ValueError(problem)
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
        """Return the driver of the effect on ``joint``, to plot the residual against; None if it has no single driver.

        Raises:
            UsageError: the data or the robot lack the driver.
        """
        return None

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the drivers (:mod:`robacc.effects.validity`) whose range the model file keeps: by default the joints.

        A constant has no driver.
        """
        return () if self.is_constant else self.joints

    @property
    def uses_masses(self) -> bool:
        """True if its coefficients multiply torques of the masses as the robot file states them."""
        return False

    @property
    def prior_odds(self) -> float:
        """Prior odds of this form against the usual form of the effect."""
        return 1.0

    @property
    def follows_approach(self) -> bool:
        """True if the direction of approach decides it, so that a joint with a memory shows a part of it."""
        return False

    @property
    def of_campaign(self) -> bool:
        """True if it is a fact of one measuring campaign: of its time, or of its instrument."""
        return False

    def held_drivers(self, arm: Arm, validity: Validity) -> tuple[str, ...]:
        """Return the drivers of ``validity`` beyond whose range the effect keeps its value at the end of the range.

        By default every one, unless the effect :attr:`extrapolates`.
        """
        return () if self.extrapolates else tuple(validity)

    def within(self, validity: Validity) -> Effect:
        """Return the effect as it is used on poses beyond ``validity``; an effect of the torque may limit that."""
        return self

    def fading_drivers(self, arm: Arm, validity: Validity) -> tuple[str, ...]:
        """Return the joints of ``validity`` beyond whose range the effect fades to its level at the end of it."""
        return ()

    def fading_length(self, arm: Arm, driver: str) -> float:
        """Return how far beyond its range a fading joint is where 0.6 of the effect is left, SI."""
        return math.inf

    def period(self, arm: Arm, driver: str) -> float | None:
        """Return the change of a driver after which the effect repeats itself; None if it does not."""
        return None

    def validity(self, arm: Arm, data: Measurements) -> Validity:
        """Return the range of each driver over these poses."""
        return ranges(arm, data, self.validity_drivers(arm))

    def key(self) -> tuple[Any, ...]:
        """Return name, joints and settings: two effects with the same key are the same."""
        return (self.name, self.joints, repr(sorted(self.settings().items())))

    def term_key(self, term: Term) -> str:
        """Return the key of a term's column of the Jacobian, over all forms of all effects."""
        return f"{term.name}|{'' if self.shares_terms else self.key()}"

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return what a finding of fitted ``values`` means and what to do; None if its coefficients say it.

        ``between`` names the place of a searched change, and the first and last place that are as plausible.
        """
        return None

    @property
    def term_of_covariance(self) -> str | None:
        """Return the term of the covariance whose errors it describes; None of an effect with a cause."""
        return None

    def is_profile(self) -> bool:
        """Return whether it is a block of many terms, a candidate only if named terms leave structure."""
        return self.is_empirical

    def __str__(self) -> str:
        """Return the name with joints, as in ``backlash[j2]``."""
        return f"{self.name}[{','.join(self.joints)}]" if self.joints else self.name


REGISTRY: dict[str, type[Effect]] = {}

E = TypeVar("E", bound=type[Effect])


def register(cls: E) -> E:
    """Add an effect to the catalogue (class decorator)."""
    REGISTRY[cls.name] = cls
    return cls


def effect_class(name: str) -> type[Effect]:
    """Return the effect called ``name``.

    Raises:
        UsageError: there is no such effect; the message suggests the nearest name and lists all.
    """
    try:
        return REGISTRY[name]
    except KeyError:
        matches = difflib.get_close_matches(name, REGISTRY, n=1)
        hint = f", did you mean {matches[0]!r}?" if matches else "."
        raise UsageError(f"no effect {name!r}{hint} The catalogue: {', '.join(REGISTRY)}") from None
