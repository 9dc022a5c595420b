"""Declarations of the keys of results, and the parts that several documents share.

A key is stated once, and the document and its JSON Schema both come from it.

A :class:`Kind` says what a value is. A kind with ``keys`` is an object of the document, written from a record: each
:class:`Key` takes its value from the record's attribute of the same name without the unit, unless it says otherwise.
``part(rms_m=Key(size, "Rms error, m."))`` is such a kind, and :func:`parts` is one of lists of such objects.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from robacc.errors import Note
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.robots.arm import Arm, outline
from robacc.robots.description import Robot

_TYPES: dict[str, tuple[str, frozenset[type]]] = {
    "string": ("text", frozenset({str})),
    "number": ("a number", frozenset({int, float})),
    "integer": ("a whole number", frozenset({int})),
    "boolean": ("true or false", frozenset({bool})),
    "array": ("a list", frozenset({list})),
    "object": ("an object", frozenset({dict})),
}
"""Names for messages, and Python's types, of the types of JSON Schema."""
_UNIT = re.compile(r"_(m|rad)2?$")
Document = dict[str, Any]
_LIMITS = (("least", "minimum"), ("most", "maximum"))
LEFT_OUT: Any = object()
"""Value of a key that a document lacks."""


class Kind(NamedTuple):
    """Kind of a value of a document."""

    words: Mapping[str, Any] = {}
    """Words of JSON Schema: the type and its limits."""
    null: bool = False
    """Whether null may stand for a missing value."""
    items: "Kind | None" = None
    """Kind of the entries of a list, or of the values of an object with any keys."""
    keys: "Mapping[str, Key] | None" = None
    """Keys of an object, in their order in the document."""
    name: str = ""
    """Name of a part that several places share."""
    about: str = ""
    """Description of a shared part."""

    def __or__(self, other: None) -> "Kind":
        """Return the kind of values that may be null."""
        return self._replace(null=True)

    def named(self, name: str = "", about: str = "") -> "Kind":
        """Return the kind with a name, of a part that several places share, and a description."""
        return self._replace(name=name, about=about)

    def write(self, record: Any, **given: Any) -> Document:
        """Return the object of a record; ``given`` are values of keys that the record does not have.

        A record that is a mapping has its keys already.
        """
        entries = self.keys or {}
        values = (
            record
            if isinstance(record, Mapping)
            else {key: given[key] if key in given else entry.value(key, record) for key, entry in entries.items()}
        )
        return {
            key: entries[key].kind.document(value) if key in entries else value
            for key, value in values.items()
            if value is not LEFT_OUT
        }

    def document(self, value: Any) -> Any:
        """Return a value as it stands in a document; values without keys stay as they are, arrays included."""
        if value is None or (self.keys is None and (self.items is None or self.items.keys is None)):
            return value
        if self.items is None:
            return self.write(value)
        return (
            {key: self.items.document(item) for key, item in value.items()}
            if isinstance(value, Mapping)
            else [self.items.document(item) for item in value]
        )

    def problems(self, value: Any, path: str = "") -> Iterator[tuple[str, str]]:
        """Yield the path of every value of a parsed document that is not of the kind, and what was expected.

        Objects may lack keys, as those of earlier versions do, and have others.
        """
        if value is None and (self.null or not (self._types or "const" in self.words or "enum" in self.words)):
            return
        choices = [self.words["const"]] if "const" in self.words else self.words.get("enum", [value])
        if (self._types and type(value) not in self._accepted) or value not in choices:
            names = [_TYPES[name][0] for name in self._types] or map(str, choices)
            yield path, f"expected {' or '.join(names)}, found {shortened(value)}"
        elif isinstance(value, list):
            least, most = self.words.get("minItems") or 0, self.words.get("maxItems")
            if len(value) < least or (most is not None and len(value) > most):
                yield path, f"expected {f'{most} entries' if most else f'at least {least} entries'}, found {len(value)}"
            if self.items is not None and not self.items.fits_all(value):
                for i, item in enumerate(value):
                    yield from self.items.problems(item, f"{path}[{i}]")
        elif isinstance(value, dict):
            for key, item in value.items():
                kind = self.items if self.keys is None else self.keys[key].kind if key in self.keys else None
                if kind is not None:
                    yield from kind.problems(item, f"{path}.{key}".lstrip("."))
        elif value < self.words.get("minimum", value) or value > self.words.get("maximum", value):
            limits = (f"at {word} {self.words[name]}" for word, name in _LIMITS if name in self.words)
            yield path, f"expected a number of {' and '.join(limits)}, found {value}"

    def fits_all(self, values: Sequence[Any]) -> bool:
        """Return whether all values are of the kind by a fast test, which is only for lists of plain values."""
        is_typed = set(map(type, values)) <= self._accepted
        if self.items is None or not is_typed:
            return is_typed and self.words.keys() == {"type"}
        lengths = {self.words[name] for name in ("minItems", "maxItems") if name in self.words}
        is_list = set(map(type, values)) == {list} and (not lengths or set(map(len, values)) == lengths)
        return is_list and self.items.fits_all([item for value in values for item in value])

    @property
    def _types(self) -> Sequence[str]:
        """Types of JSON Schema; none for any value."""
        names = self.words.get("type", () if self.keys is None else "object")
        return [names] if isinstance(names, str) else names

    @property
    def _accepted(self) -> frozenset[type]:
        """Types of Python that a value may have."""
        return frozenset({type(None)} if self.null else ()).union(*(_TYPES[name][1] for name in self._types))

    def schema(self, shared: dict[str, Document]) -> Document:
        """Return the JSON Schema of the kind; parts with a name are added to ``shared``."""
        words = dict(self.words)
        if self.items is not None:
            words["items" if words["type"] == "array" else "additionalProperties"] = self.items.schema(shared)
        if self.keys is not None:
            required = [key for key, entry in self.keys.items() if not entry.optional]
            properties = {key: entry.schema(shared) for key, entry in self.keys.items()}
            words = {"type": "object", "required": required, "properties": properties, **words}
        if self.name:
            shared[self.name] = ({"description": self.about} if self.about else {}) | words
            reference = {"$ref": f"#/$defs/{self.name}"}
            return {"anyOf": [reference, {"type": "null"}]} if self.null else reference
        if self.null and "enum" in words:
            words["enum"] = [*words["enum"], None]
        elif self.null:
            words["type"] = [*(words["type"] if isinstance(words["type"], list) else [words["type"]]), "null"]
        return words


class Key(NamedTuple):
    """One key of an object of a document."""

    kind: Kind
    about: str = ""
    """Meaning, with the unit; a shared part may describe itself."""
    source: str | Callable[[Any], Any] | None = None
    """Attribute of the record by its dotted path, in which a missing owner has no value; the empty path is the record
    itself. Or a function of the record. None is the attribute with the key's name without its unit."""
    optional: bool = False
    """Whether a document may lack the key, as where its value is :data:`LEFT_OUT`."""

    def value(self, key: str, record: Any) -> Any:
        """Return the value of the key ``key`` for a record."""
        if callable(self.source):
            return self.source(record)
        path = _UNIT.sub("", key) if self.source is None else self.source
        names = path.split(".") if path else ()
        return reduce(lambda owner, name: None if owner is None else getattr(owner, name), names, record)

    def schema(self, shared: dict[str, Document]) -> Document:
        """Return the JSON Schema of the key's value."""
        return ({"description": self.about} if self.about else {}) | self.kind.schema(shared)


def shortened(value: Any) -> str:
    """Return a value as JSON, shortened for a message."""
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"


def part(**keys: Key) -> Kind:
    """Return the kind of objects with ``keys``."""
    return Kind(keys=keys)


def parts(**keys: Key) -> Kind:
    """Return the kind of lists of objects with ``keys``."""
    return array(part(**keys))


def within(path: str, keys: Mapping[str, Key]) -> dict[str, Key]:
    """Return keys whose record is the attribute ``path`` of the owner's record."""
    return {key: entry._replace(source=f"{path}.{entry.source or _UNIT.sub('', key)}") for key, entry in keys.items()}


def array(kind: Kind, length: int | None = None, least: int | None = None) -> Kind:
    """Return the kind of lists of ``length`` entries, of at least ``least`` entries, or of any number of entries."""
    limits = {"minItems": least if length is None else length, "maxItems": length}
    return Kind({"type": "array", **{word: limit for word, limit in limits.items() if limit is not None}}, items=kind)


def table(kind: Kind | None = None) -> Kind:
    """Return the kind of objects with any keys, whose values are of ``kind``."""
    return Kind({"type": "object"}, items=kind)


def choice(*values: Any) -> Kind:
    """Return the kind of a value from a list."""
    return Kind({"enum": list(values)})


def constant(value: Any) -> Kind:
    """Return the kind of one value."""
    return Kind({"const": value})


anything = Kind()
text = Kind({"type": "string"})
digest = Kind({"type": "string", "pattern": "^[0-9a-f]{64}$"})
flag = Kind({"type": "boolean"})
number = Kind({"type": "number"})
size = Kind({"type": "number", "minimum": 0})
share = Kind({"type": "number", "minimum": 0, "maximum": 1})
integer = Kind({"type": "integer"})
count = Kind({"type": "integer", "minimum": 0})
ordinal = Kind({"type": "integer", "minimum": 1})
vector3 = array(number, 3).named("vector3")
rows3 = array(array(number | None, 3)).named("rows3")
matrix3 = array(vector3, 3).named("matrix3")


# Parts that several documents share: statistics, grades, coefficients, poses, the robot, curves of effects.

QUANTITIES = (("m", "position"), ("rad", "orientation"))
"""Quantities with the units of their keys."""
_DECIMALS = 12
"""Values of poses are rounded to 1e-12 m or rad, far below any instrument, which halves the size of the document."""


def rounded(values: Array | None) -> Array | None:
    """Return rounded values with poses first, the order of a document; None without values."""
    return None if values is None else np.round(values, _DECIMALS).T


def texts(column: NDArray[Any] | None) -> list[str] | None:
    """Return a column of names as texts; None without such a column."""
    return None if column is None else [str(value) for value in column]


OUTSIDE_KEY = Key(
    part(
        n_poses=Key(count, "Poses outside at least one range."),
        position_std_max_m=Key(
            size,
            "Largest standard deviation of a position, m, that the effects held at the end of their range add.",
            "std_max",
        ),
        ranges=Key(
            parts(
                effect=Key(text, "Effect and its joints."),
                driver=Key(text, "Driver: a joint, time_s, temperature_c, payload_kg, speed_JOINT or torque_JOINT."),
                unit=Key(text, "Unit of the range."),
                low=Key(number, "Lowest value that the effect was fitted on."),
                high=Key(number, "Highest value that the effect was fitted on."),
                n_poses=Key(ordinal, "Poses outside this range."),
                largest_excess=Key(size, "Largest distance of a pose from the range."),
                rule=Key(
                    choice("held", "extrapolated"),
                    "held: the effect keeps its value at the end of the range; extrapolated: it follows its law.",
                ),
            ),
            "Ranges that some pose exceeds, most poses first.",
        ),
    ),
    "Poses outside the validity range of the robot file's effects.",
    # Poses outside the validity ranges of a result's model; nothing without files or a robot.
    lambda result: getattr(getattr(result, "made", None), "outside", None) or LEFT_OUT,
    optional=True,
)
"""Key that the use of a model adds to a result."""

INPUT = part(
    name=Key(
        text, "File name without its folder; - is standard input; a label for data that did not come from a file."
    ),
    sha256=Key(
        digest,
        "SHA-256 of the file's bytes, hexadecimal; for data that did not come from a file, of the file that "
        "they would make.",
    ),
    kind=Key(text, "Kind of file: poses, robot, scale, gate, baseline, result …"),
    reading=Key(
        table(),
        "Statements of the user on names that a pose file leaves open, such as units; absent without any.",
        lambda file: dict(file.reading) if file.reading else LEFT_OUT,
        optional=True,
    ),
    identity=Key(
        table(text),
        "What was tested, as the robot file states it under identity: labels by key, such as serial_number; "
        "absent without any.",
        lambda file: dict(file.identity) if file.identity else LEFT_OUT,
        optional=True,
    ),
).named("input", "One input file of the result.")

INTERVAL = part(
    lower=Key(number | None, "Lower limit of the two-sided interval, or null."),
    upper=Key(number | None, "Upper limit of the two-sided interval, or null."),
    upper_bound=Key(number | None, "One-sided upper bound at the same confidence, or null."),
    confidence=Key(share, "Confidence of the interval, and of the upper bound by itself."),
    method=Key(text, "Method of the interval; none if there is no interval."),
    why=Key(text | None, "Reason why there is no interval, or null."),
).named("interval", "Confidence interval of a number, in the number's unit.")

MATRIX_INTERVAL = part(
    lower=Key(matrix3 | None, "Lower limits, or null."),
    upper=Key(matrix3 | None, "Upper limits, or null."),
    confidence=Key(share, "Confidence of each interval."),
    method=Key(text, "Method of the intervals; none if there are no intervals."),
    why=Key(text | None, "Reason why there are no intervals, or null."),
).named("matrix_interval", "Confidence interval of each element of a covariance, in its unit.")

TEST = part(
    method=Key(text, "Name of the test and its hypothesis."),
    statistic=Key(number | None, "Statistic of the test, or null."),
    p_value=Key(share | None, "Probability of a statistic as extreme if the assumption holds, or null."),
    dimension=Key(count | None, "Dimension of the tested errors: below 3 if they lie in a plane or on a line."),
    why=Key(text | None, "Reason why there is no test, or null."),
).named("test", "A test of an assumption.")

METRICS = {
    unit: {
        f"rms_{unit}": Key(size, f"Rms of the {name} error's length, {unit}."),
        f"mean_error_{unit}": Key(size, f"Mean of the error's length, {unit}.", "mean"),
        f"p95_{unit}": Key(size, f"95th percentile of the error's length in the sample, {unit}."),
        f"max_{unit}": Key(size, f"Largest length of an error in the sample, {unit}."),
    }
    for unit, name in QUANTITIES
}
"""Keys of the four metrics of an error's length by unit."""
FIGURES = {
    unit: part(**METRICS[unit]).named(f"{name}_figures", f"Metrics of the {name} error's length.")
    for unit, name in QUANTITIES
}
"""The metrics as a part, by unit."""
_RADIUS = {
    unit: part(
        **{
            f"radius_{unit}": Key(size | None, f"Radius, {unit}, or null.", "value"),
            "interval": Key(INTERVAL),
            "why": Key(text | None, "Reason why there is no interval, or null."),
        }
    )
    for unit, _ in QUANTITIES
}
STATISTICS = {
    unit: part(
        **{
            f"mean_{unit}": Key(vector3, f"Mean error along x, y, z of the frame, {unit}."),
            f"covariance_{unit}2": Key(
                matrix3, f"Maximum-likelihood covariance about zero (divisor n), {unit}²: equations (13), (14)."
            ),
            f"centred_covariance_{unit}2": Key(
                matrix3, f"Maximum-likelihood covariance about the mean (divisor n), {unit}²."
            ),
            f"rms_{unit}": Key(size, f"Rms of the {name} error's length, {unit}."),
            f"mean_error_{unit}": Key(size, f"Mean of the error's length, {unit}."),
            f"p95_{unit}": Key(size, f"95th percentile of the error's length in the sample, {unit}."),
            f"max_{unit}": Key(size, f"Largest length of an error in the sample, {unit}."),
            "percentile_definition": Key(
                text,
                "Interpolation of the sample percentile.",
                lambda _: "linear interpolation at (n - 1) p (Hyndman and Fan type 7)",
            ),
            "share_below_max": Key(
                share | None, "Share of all poses below the largest measured error, at the confidence; null if unknown."
            ),
            "n_commanded_poses": Key(count, "Number of commanded poses.", "n_poses"),
            "independent_poses": Key(
                size,
                "Number of poses that the intervals count: the commanded poses, less those that the fitted frames use.",
                "n_independent",
                optional=True,
            ),
            "confidence": Key(share, "Confidence of the intervals."),
            "assumption": Key(text, "Assumptions of the covariance, and the tests that contradict them."),
            "intervals": Key(
                part(
                    **{
                        f"mean_{unit}": Key(array(INTERVAL, 3), f"Intervals along x, y, z, {unit}.", "intervals.mean"),
                        f"covariance_{unit}2": Key(MATRIX_INTERVAL, source="intervals.covariance"),
                        f"centred_covariance_{unit}2": Key(MATRIX_INTERVAL, source="intervals.centred_covariance"),
                        f"rms_{unit}": Key(INTERVAL, source="intervals.rms"),
                        f"mean_error_{unit}": Key(INTERVAL, source="intervals.mean_error"),
                        f"p95_{unit}": Key(INTERVAL, source="intervals.p95"),
                        f"max_{unit}": Key(INTERVAL, source=lambda statistics: statistics.estimate("max")[1]),
                    }
                ),
                "Intervals of the metrics, by their keys.",
                "",
            ),
            "ellipsoid": Key(
                parts(
                    **{
                        "direction": Key(vector3, "Unit vector in the frame's axes."),
                        f"sd_{unit}": Key(size | None, f"Standard deviation along the direction, {unit}."),
                        "interval": Key(INTERVAL),
                    }
                ),
                "Principal axes of the covariance about the mean, the longest first.",
                lambda statistics: [
                    {"direction": direction, f"sd_{statistics.unit}": sd, "interval": interval}
                    for direction, sd, interval in zip(
                        statistics.ellipsoid.axes.T,
                        statistics.ellipsoid.sd,
                        statistics.ellipsoid.intervals,
                        strict=True,
                    )
                ],
            ),
            "radius95": Key(
                part(
                    zero_mean=Key(
                        _RADIUS[unit], "Gaussian of zero mean, with the covariance about zero.", "radius95_zero_mean"
                    ),
                    fitted_mean=Key(
                        _RADIUS[unit],
                        "Gaussian of the fitted mean, with the covariance about the mean.",
                        "radius95_fitted_mean",
                    ),
                ),
                "Radius that contains 95 % of the errors of the fitted Gaussian.",
                "",
            ),
            "tests": Key(
                part(zero_mean=Key(TEST), skewness=Key(TEST), kurtosis=Key(TEST)),
                "Tests of the assumptions of the covariance.",
            ),
            "pose_structure": Key(
                part(
                    **{
                        f"between_{unit}2": Key(size | None, f"Variance between commanded poses, {unit}²."),
                        f"within_{unit}2": Key(size | None, f"Variance within commanded poses, {unit}²."),
                        "intraclass_correlation": Key(number | None, "Share of the variance between poses."),
                        "effective_poses": Key(size | None, "Number of independent poses equivalent to the rows."),
                        "text": Key(text, "Summary of the structure."),
                        "why": Key(text | None, "Reason why it is unknown, or null."),
                    }
                ),
                "Shares of the error between and within commanded poses, from repetitions.",
                "structure",
            ),
            f"errors_{unit}": Key(
                rows3, f"Error of each pose along x, y, z of the frame, {unit}, in the file's order."
            ),
        }
    ).named(f"{name}_statistics", f"{name.capitalize()} errors, {unit}.")
    for unit, name in QUANTITIES
}
"""Statistics of the errors by unit; the errors themselves are given."""
REGISTERED_PARAMETER = part(
    name=Key(text, "Name of effect and coordinate, as in base_frame.x."),
    value=Key(number, "Value in the unit.", lambda parameter: parameter.value + 0.0),
    std=Key(size | None, "Standard error in the same unit; null if it is not identifiable."),
    unit=Key(text, "m or rad."),
    why=Key(text, "Reason why std is null.", lambda parameter: parameter.why or LEFT_OUT, optional=True),
).named("registered_parameter", "One coordinate of a registered frame.")

PARAMETER = part(
    name=Key(text, "effect.joint.term"),
    value=Key(
        number | None,
        "Value in the unit: of base_frame and tool_frame the fitted frame, of other constants the correction "
        "to the robot file; null if it is not identifiable.",
        lambda parameter: parameter.value + 0.0,
    ),
    std=Key(size | None, "Standard error in the same unit; null if it is not identifiable."),
    unit=Key(text, "Unit of value and std."),
    why=Key(
        text,
        "Reason for a missing standard error, or confounded coefficients.",
        lambda parameter: parameter.why or LEFT_OUT,
        optional=True,
    ),
).named("parameter", "One coefficient.")

ALIGNMENT = part(
    what=Key(array(text), "Fitted frames: base_frame, tool_frame or both.", "effects"),
    n_parameters=Key(count, "Number of fitted coefficients."),
    parameters=Key(array(REGISTERED_PARAMETER), "Fitted coefficients."),
)
"""Frames registered to the poses."""

ROBOT = part(
    name=Key(text, "Name in the robot file."),
    joints=Key(
        parts(
            name=Key(text, "Name of the joint."), type=Key(choice("revolute", "prismatic", "fixed"), "Kind of joint.")
        ),
        "Joints with a variable, in chain order.",
        "variables",
    ),
    effects=Key(
        array(text),
        "Names of the effects that the robot file lists; they are applied.",
        lambda robot: list(dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)),
        optional=True,
    ),
    fitted_to=Key(array(text), "SHA-256 of each file of poses that the robot file was fitted to.", optional=True),
    outline=Key(
        part(
            q=Key(array(number), "Joint variables, rad or m."),
            line_m=Key(rows3, "Corners of the arm's outline from base to target, m."),
        )
        | None,
        "Outline of the arm at a typical pose; null if the joints are unknown.",
    ),
).named("robot", "Robot and its outline; null without a robot.")


def robot_document(robot: Robot | None, q: Array | None, registered: Robot | None = None) -> Document | None:
    """Return the robot's name, joints, and outline at a typical pose of ``q`` ``(J, N)``; None without a robot.

    The outline is that of the ``registered`` robot if there is one, among the poses in the measuring frame.
    """
    if robot is None:
        return None
    shape = None
    if q is not None and q.shape[1]:
        typical, line = outline(Arm.of(registered or robot), q)
        shape = {"q": typical, "line_m": rounded(line)}
    return ROBOT.write(robot, outline=shape)


_POSES = {
    "line": Key(
        array(ordinal),
        "Line of the file, from 1; the row's number if there is no file.",
        lambda data: np.arange(1, data.n + 1) if data.rows is None else data.rows,
    ),
    "pose": Key(array(text) | None, "Id of the commanded pose.", lambda data: texts(data.pose)),
    "cycle": Key(array(text) | None, "Repetition of the commanded pose.", lambda data: texts(data.cycle)),
    "target": Key(array(text) | None, "Name of the measured target.", lambda data: texts(data.target)),
    "group": Key(
        array(integer), "Number of the commanded pose; rows that share it are repetitions.", lambda data: data.groups()
    ),
    "q": Key(
        array(array(number)) | None, "Commanded joint variables of each pose, rad or m.", lambda data: rounded(data.q)
    ),
    "commanded_m": Key(rows3, "Commanded position of the target in the measuring frame, m."),
    "attained_m": Key(rows3, "Measured position of the target, m.", lambda data: rounded(data.position)),
    "time_s": Key(array(number) | None, "Time, s.", "time"),
    "temperature_c": Key(array(number) | None, "Temperature, °C.", "temperature"),
    "payload_kg": Key(array(number) | None, "Payload, kg.", "payload"),
    "used": Key(array(flag) | None, "True for rows in the fit; null if the fit uses all rows."),
}
Residuals = Mapping[str, Any]
_ABOUT_POSES = "Columns with an entry for each row; null if the file has no such column."
POSES = part(**_POSES).named("poses", _ABOUT_POSES)


_STAGE_ERRORS = {
    unit: part(
        **{
            key: Key(rows3 | None, f"Errors of {about}, {unit}; null if there are none.")
            for key, about in (
                ("nominal_unregistered", "the nominal model as it stands in the robot file"),
                ("nominal", "the nominal model, registered"),
                ("before", "the baseline"),
                ("after", "the extended model"),
                ("held_out_nominal", "the nominal model registered without the pose"),
                ("held_out_before", "the baseline fitted without the pose"),
                ("held_out_after", "the extended model fitted without the pose"),
            )
        }
    )
    for unit, _ in QUANTITIES
}
FITTED_POSES = part(
    **_POSES,
    errors_m=Key(_STAGE_ERRORS["m"], "Position error of each row in the measuring frame, m."),
    errors_rad=Key(
        _STAGE_ERRORS["rad"] | None, "Orientation error of each row, rad; null if no orientation was measured."
    ),
).named("fitted_poses", _ABOUT_POSES)


def pose_document(
    data: Measurements, commanded: Array, residuals: Residuals | None = None, used: NDArray[np.bool_] | None = None
) -> Document:
    """Return columns with an entry for each row: its line, ids, commanded and measured values, and residuals.

    Rows with the same ``group`` are repetitions of one commanded pose.

    Args:
        data: The measured rows.
        commanded: ``(3, N)`` commanded position of the target in the measuring frame, m.
        residuals: Residuals ``(3 or 6, N)`` of each stage of a fit, by its key, if there is a fit.
        used: ``(N,)`` rows without outliers.
    """
    given: Document = {"commanded_m": rounded(commanded), "used": used}
    if residuals is None:
        return POSES.write(data, **given)
    for (unit, kind), axes in zip(_STAGE_ERRORS.items(), (slice(0, 3), slice(3, 6)), strict=True):
        is_measured = unit == "m" or len(residuals["nominal"]) > 3
        known = {stage: residuals.get(stage) for stage in kind.keys or ()}
        rows = {stage: None if values is None else rounded(values[axes]) for stage, values in known.items()}
        given[f"errors_{unit}"] = rows if is_measured else None
    return FITTED_POSES.write(data, **given)


CURVE_KEYS = {
    "joint": Key(
        text | None, "Joint whose error is given; null for the component along the displacement by the effect."
    ),
    "driver": Key(text, "Driver of the effect: a joint angle, a torque, time …"),
    "driver_unit": Key(text, "Unit of x and grid."),
    "unit": Key(text, "Unit of all other numbers."),
    "x": Key(array(number | None), "Driver at each row."),
    "effect": Key(array(number | None), "Contribution of the effect at each row.", lambda curve: rounded(curve.effect)),
    "residual_before": Key(array(number | None), "Residual without the effect.", lambda curve: rounded(curve.before)),
    "residual_after": Key(array(number | None), "Residual with the effect.", lambda curve: rounded(curve.after)),
    "sd": Key(array(number | None), "Standard deviation of each row's residual.", lambda curve: rounded(curve.sd)),
    "grid": Key(array(number) | None, "Values of the driver for the curve."),
    "curve": Key(array(number) | None, "Effect at the values of the grid.", lambda curve: rounded(curve.value)),
    "spectrum": Key(
        part(
            orders=Key(array(number), "Periods per turn."),
            before_rad=Key(array(number), "Amplitude without the effect, rad.", lambda it: rounded(it.before)),
            after_rad=Key(array(number), "Amplitude with the effect, rad.", lambda it: rounded(it.after)),
            noise_rad=Key(size | None, "Amplitude that noise alone produces, rad."),
        )
        | None,
        "Amplitudes by order of a periodic effect; otherwise null.",
    ),
}
CURVE = part(**CURVE_KEYS).named(
    "curve", "Partial residual of an effect over its driver: residual_before = effect + residual_after."
)


COVARIANCE = part(
    names=Key(array(text), "Names of the coefficients, as in parameters."),
    lower_triangle=Key(
        array(array(number)),
        "Row of each coefficient in the order of names, up to and with its diagonal, in the product of their "
        "units; eight significant digits. The roots of the diagonal are the standard errors.",
        # Eight digits: sums of 500 coefficients keep their variances to 2e-7 of their size.
        lambda covariance: [
            [*(float(f"{value:.8g}") for value in row[:i]), float(row[i])]
            for i, row in enumerate(covariance.matrix.tolist())
        ],
    ),
)
"""Covariance of coefficients."""

NOTES = {"notes": Key(array(text), "Notes on the figures: assumptions and limitations.")}
WARNINGS = {
    "input_notes": Key(
        array(text),
        "How the inputs were read.",
        lambda result: [text for text in result.warnings if isinstance(text, Note)],
    ),
    "warnings": Key(
        array(text),
        "Warnings: a figure may be wrong.",
        lambda result: [text for text in result.warnings if not isinstance(text, Note)],
    ),
}
