"""What holds for every effect of the catalogue: one that is added is tested without a new test."""

import dataclasses
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml
from arms import arm, circumstances, model_of, suited

import robacc
from robacc import InputError, Measurements, UsageError
from robacc.diagnostics.partial_residuals import partial_residuals
from robacc.effects import REGISTRY
from robacc.effects.base import (
    About,
    Effect,
    Need,
    Over,
    Term,
    Traits,
    driven_by,
    register,
    setting,
    settings_of,
    varies,
)
from robacc.effects.elastic import Elastic, JointCompliance, JointHardening
from robacc.effects.specification import Known, build, catalogue, entry_of, known_effects, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.candidates import named_candidates
from robacc.tracing.search import search
from robacc.tracing.trace import trace

# What holds for every effect of the catalogue: one that is added is tested without a new test.

EFFECTS = tuple(REGISTRY)
ARMS = ("puma560", "panda", "urdf:stanford", "targets:puma560")
N = 5
OTHER_FORMS = {
    "approach_lag": ({"common": True},),
    "backlash": ({"by": "gravity"},),
    "joint_compliance": ({"masses": "unknown"}, {"masses": "uncertain", "deflection": "rigid"}),
    "joint_correction": (
        {"lengths": [1.5], "centres": [[0.0], [0.4]]},
        {"lengths": [1.5], "centres": [[0.0], [0.4]], "moves": "position"},
        {"drivers": ["torque"], "range": [[-50.0, 50.0]]},
        {"drivers": ["time_s", "direction"], "range": [[0.0, 600.0], [-1.0, 1.0]], "degree": 3},
    ),
    "joint_hardening": ({"knee_nm": 40.0},),
    "lateral_compliance": ({"deflection": "rigid"}, {"masses": "unknown"}),
    "payload_compliance": ({"deflection": "rigid"}, {"com": "uncertain"}),
    "base_compliance": ({"deflection": "rigid"}, {"below": True}, {"masses": "unknown"}),
    "instrument_scale": ({"drift": 2, "origin_s": 300.0, "span_s": 300.0},),
    "target_decentre": ({"axis": "y", "instrument": [2.5, -1.5, 0.4]},),
    "tracker_error": ({"kind": "horizontal", "instrument": [2.5, 1, 0]}, {"kind": "vertical", "instrument": [3, 0, 1]}),
    "transmission_error": ({"orders": [3.5], "shrunk": True},),
    "thermal_expansion": ({"time_constant_s": 600.0}, {"slides": False}),
}
"""Settings that neither the default, nor the example, nor a trace of data with every column has."""


def example(name: str) -> dict[str, object]:
    """The entry that the catalogue shows, as a robot file's reader sees it."""
    robot = suited(name, arm("puma560")).robot
    return parse_robot(f"{robot_to_yaml(robot)}effects: [{REGISTRY[name].about.example}]", name).effects[0]


def forms(name: str, one: Arm, data: Measurements) -> list[Effect]:
    """As it is fitted by default, as its example has it where the arm is the example's, and as a trace tries it."""
    found = [REGISTRY[name].default(one, data)]
    if one.robot == suited(name, arm("puma560")).robot:
        found.append(known_effects(dataclasses.replace(one.robot, effects=(example(name),)))[0].effect)
    cls = REGISTRY[name]
    found += [cls.from_settings(cls.possible_joints(one)[1:2], settings) for settings in OTHER_FORMS.get(name, ())]
    competing = list(REGISTRY[name].candidates(one, data))
    return found + competing[:1] + competing[-1:]


def small(bound_terms: tuple, seed: int = 1) -> np.ndarray:
    """Coefficients of usual size, none zero."""
    rng = np.random.default_rng(seed)
    sizes = np.array([term.typical for term in bound_terms])
    return sizes * rng.uniform(0.3, 1.0, sizes.size) * rng.choice([-1, 1], sizes.size)


@pytest.fixture(params=ARMS, name="one")
def _one(request: pytest.FixtureRequest) -> Arm:
    return arm(request.param)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_example_is_of_the_effect_and_does_something(name: str) -> None:
    entry = example(name)
    assert entry["effect"] == name
    assert entry["values"]
    one = suited(name, arm("puma560"))
    robot = dataclasses.replace(one.robot, effects=(entry,))
    data = circumstances(robot, N)
    there, nominal = predict(robot, data), one.chain.forward(data.q)
    moved = np.linalg.norm(there.translation - nominal.translation, axis=0).max()
    assert 1e-7 < moved < 0.02, "an example of usual size moves the target by micrometres to millimetres"


@pytest.mark.parametrize("name", EFFECTS)
def test_the_catalogue_says_everything_of_it(name: str) -> None:
    about = REGISTRY[name].about
    for field, value in zip(about._fields, about, strict=True):
        assert value.strip() if isinstance(value, str) else 0 < value[0] < value[1], field
    assert REGISTRY[name].name == name
    assert REGISTRY[name].traits.is_constant == (name in ("base_frame", "tool_frame", "joint_offset", "link_geometry"))


@pytest.mark.parametrize("name", EFFECTS)
def test_terms_have_unique_names_units_and_regressors_of_one_number_a_pose(name: str, one: Arm) -> None:
    one = suited(name, one)
    data = circumstances(one.robot, N)
    assert REGISTRY[name].missing(one, data) is None
    for effect in forms(name, one, data):
        terms = effect.terms(one, data)
        assert terms
        names = [term.name for term in terms]
        assert len(set(names)) == len(names)
        for term in terms:
            assert term.name == name or term.name.startswith(f"{name}.")
            assert term.unit
            assert term.typical > 0
            assert term.weight > 0
            assert term.parts
            for part in term.parts:
                assert np.shape(part.factor) in ((), (N,))
                assert np.all(np.isfinite(part.factor))


@pytest.mark.parametrize("name", EFFECTS)
def test_zero_is_nominal_bit_for_bit(name: str, one: Arm) -> None:
    one = suited(name, one)
    data = circumstances(one.robot, N)
    nominal = Model(one).bind(data).poses(np.zeros(0))
    if not one.robot.targets:
        np.testing.assert_array_equal(nominal.translation, one.chain.forward(data.q).translation)
    for effect in forms(name, one, data):
        bound = Model(one, free=(effect,)).bind(data)
        poses = bound.poses(np.zeros(len(bound.terms)))
        np.testing.assert_array_equal(poses.translation, nominal.translation)
        np.testing.assert_array_equal(poses.rotation, nominal.rotation)
        known = Model(one, known=(Known(effect, {}),)).bind(data).poses(np.zeros(0))
        np.testing.assert_array_equal(known.translation, nominal.translation)


def assert_jacobian(model: Model, data: Measurements) -> None:
    bound = model.bind(data)
    theta = small(bound.terms)
    poses, jacobian = bound.linearise(theta)
    assert jacobian.shape == (6, len(bound.terms), data.n)
    np.testing.assert_allclose(poses.translation, bound.poses(theta).translation, rtol=0, atol=1e-14)
    # Every column in two random directions at once, each brought to size 1 so that none hides behind another: two
    # sweeps of the chain instead of one a column.
    rng = np.random.default_rng(8)
    sizes = np.abs(jacobian).max(axis=(0, 2))
    # A joint of vertical axis feels no weight: what rounding leaves of its column is not brought to size 1.
    sizes = np.maximum(sizes, max(1e-3 * sizes.max(), 1e-3))
    for _ in range(2):
        way = rng.choice([-1, 1], theta.size) * rng.uniform(0.5, 1.0, theta.size) / sizes
        turned = bound.poses(theta + 1e-30j * way)
        dp = turned.translation.imag / 1e-30
        spin = np.einsum("ikn,jkn->ijn", turned.rotation.imag / 1e-30, turned.rotation.real)
        dphi = np.stack((spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1])) / 2
        expected = np.concatenate((dp, dphi))
        np.testing.assert_allclose(np.einsum("ipn,p->in", jacobian, way), expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", EFFECTS)
def test_jacobian_against_complex_step(name: str, one: Arm) -> None:
    one = suited(name, one)
    data = circumstances(one.robot, N)
    for effect in forms(name, one, data):
        assert_jacobian(Model(one, free=(effect,)), data)


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("arm_name", ["urdf:puma560"])
def test_jacobian_of_an_arm_that_sags_and_is_measured_to_scale(name: str, arm_name: str) -> None:
    # Deflections answer every coefficient: the arm's posture changes the torque, the torque the posture.
    one = suited(name, arm(arm_name))
    data = circumstances(one.robot, N)
    sag = REGISTRY["joint_compliance"].default(one, data)
    bend = REGISTRY["lateral_compliance"].default(one, data)
    scale = REGISTRY["instrument_scale"].default(one, data)
    known = (
        Known(sag, {term.name: 2e-5 for term in sag.terms(one, data)}),
        Known(bend, {term.name: 1e-5 for term in bend.terms(one, data)}),
        Known(scale, {"instrument_scale": 1e-3}),
    )
    assert_jacobian(Model(one, known=known, free=(REGISTRY[name].default(one, data),)), data)


@pytest.mark.parametrize("name", [name for name in EFFECTS if issubclass(REGISTRY[name], Elastic)])
@pytest.mark.parametrize("arm_name", ["puma560", "urdf:puma560"])
def test_jacobian_of_an_arm_with_deflections_of_both_forms(name: str, arm_name: str) -> None:
    # Deflections at the undeflected pose answer to what moves the arm, those in equilibrium to all others too.
    one = arm(arm_name)
    data = circumstances(one.robot, N)
    free = [REGISTRY[other].default(one, data) for other in ("joint_offset", "joint_compliance", "lateral_compliance")]
    own = REGISTRY[name].default(one, data)
    rigid = type(own).from_settings(own.joints, own.settings() | {"deflection": "rigid"})
    known = Known(rigid, {term.name: 2 * term.typical for term in rigid.terms(one, data)})
    assert_jacobian(Model(one, known=(known,), free=(*free, rigid, own)), data)


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("arm_name", ["panda", "targets:puma560"])
def test_order_and_number_of_poses_do_not_matter(name: str, arm_name: str) -> None:
    one = suited(name, arm(arm_name))
    data = circumstances(one.robot, 40)
    effect = REGISTRY[name].default(one, data)
    bound = Model(one, free=(effect,)).bind(data)
    theta = small(bound.terms)
    whole = bound.poses(theta)
    _, jacobian = bound.linearise(theta)
    order = np.random.default_rng(5).permutation(40)
    for rows in (order, order[:1], order[:0]):
        poses, part = Model(one, free=(effect,)).bind(data.subset(rows)).linearise(theta)
        assert poses.translation.shape == (3, rows.size)
        # The equilibrium is swept until the slowest pose is there: 1e-14 rad more or less on some metres.
        np.testing.assert_allclose(poses.translation, whole.translation[:, rows], rtol=0, atol=1e-12)
        np.testing.assert_allclose(poses.rotation, whole.rotation[..., rows], rtol=0, atol=1e-12)
        largest = np.abs(jacobian).max()
        np.testing.assert_allclose(part, jacobian[..., rows], rtol=0, atol=1e-11 * max(largest, 1.0))


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("arm_name", ["puma560", "urdf:stanford"])
def test_settings_and_robot_file_bring_it_back(name: str, arm_name: str) -> None:
    one = suited(name, arm(arm_name))
    data = circumstances(one.robot, N)
    direct, entries = [], []
    for effect in forms(name, one, data):
        again = type(effect).from_settings(effect.joints, yaml.safe_load(yaml.safe_dump(effect.settings())))
        assert again == effect
        assert again.key() == effect.key()
        terms = effect.terms(one, data)
        values = dict(zip((term.name for term in terms), small(terms).tolist(), strict=True))
        direct.append(Model(one, known=(Known(effect, values),)).bind(data).poses(np.zeros(0)))
        entries.append(entry_of(effect, values))
    robot = dataclasses.replace(one.robot, effects=tuple(entries))
    for written in (robot, parse_robot(robot_to_yaml(robot), "again.yaml")):
        for entry, expected in zip(written.effects, direct, strict=True):
            poses = predict(dataclasses.replace(written, effects=(entry,)), data)
            np.testing.assert_allclose(poses.translation, expected.translation, rtol=0, atol=1e-12)
            np.testing.assert_allclose(poses.rotation, expected.rotation, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_file_in_mm_and_degrees_says_the_same(name: str) -> None:
    one = suited(name, arm("puma560"))
    data = circumstances(one.robot, N)
    effect = known_effects(dataclasses.replace(one.robot, effects=(example(name),)))[0].effect
    terms = effect.terms(one, data)
    values = dict(zip((term.name for term in terms), small(terms).tolist(), strict=True))
    size = {"m": 1e3, "rad": 180 / np.pi}
    other = {term.name: values[term.name] * size.get(term.unit.split("/")[0].split(" ")[0], 1.0) for term in terms}
    entry = entry_of(effect, other)
    if name == "joint_correction":
        entry["range"] = [[end * 180 / np.pi for end in pair] for pair in entry["range"]]
    if name == "rail_errors":
        entry |= {end: 1e3 * entry[end] for end in ("from", "to")}
    if "instrument" in entry:
        entry["instrument"] = [1e3 * coordinate for coordinate in entry["instrument"]]
    robot = dataclasses.replace(one.robot, effects=(entry,), effect_units=(1e-3, np.pi / 180))
    direct = Model(one, known=(Known(effect, values),)).bind(data).poses(np.zeros(0))
    np.testing.assert_allclose(predict(robot, data).translation, direct.translation, rtol=0, atol=1e-12)


WRONG_VALUES = {
    bool: (1, "yes", None),
    int: (True, "1", 1.5, None),
    float: (True, "1", [1.0], float("nan"), 10**400),
    str: (5, "", True),
    tuple: (5, None, [{}]),
    type(None): ([1], True),
}
"""Values that a setting refuses, by the type of what it holds."""


@pytest.mark.parametrize("name", EFFECTS)
def test_unknown_keys_and_wrong_values_are_refused(name: str) -> None:
    one = suited(name, arm("puma560"))
    for effect in forms(name, one, circumstances(one.robot, N)):
        cls, settings = type(effect), effect.settings()
        assert effect.from_units(one, 1.0, 1.0) == effect
        with pytest.raises(ValueError, match=rf"{name} has no setting 'tooth'"):
            cls.from_settings(effect.joints, settings | {"tooth": 3})
        for key, declared in settings_of(cls).items():
            for value in WRONG_VALUES[type(getattr(effect, declared.field))]:
                if value == "" and not declared.choices:
                    continue
                with pytest.raises(ValueError, match=rf"{name}: {key} must be [a-z].*, found "):
                    cls.from_settings(effect.joints, settings | {key: value})


BARE = Measurements(position=np.zeros((3, 2)), q=np.array([[0.1, 0.2]] * 6))


def reasons(name: str) -> list[str]:
    """Every text that says why the effect, or its usual form, cannot be fitted."""
    traits = REGISTRY[name].traits
    return [need.reason for need in (*traits.needs, *traits.needs_of_usual_form)]


NEEDY = tuple(filter(reasons, REGISTRY))
"""Effects that ask for a column or for masses."""
SLIDING = ("rail_errors",)
"""Effects that need a slide, not a column or a mass."""
PAST = ("step",)
"""Effects that lie in the past of poses without a time or a line, and so need neither in a robot file."""


def weightless() -> Arm:
    robot = arm("puma560").robot
    return Arm.of(dataclasses.replace(robot, joints=tuple(dataclasses.replace(j, mass=None) for j in robot.joints)))


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_missing_is_said_in_one_line(name: str) -> None:
    cls = REGISTRY[name]
    assert cls.missing(arm("puma560"), BARE) in (None, *reasons(name))
    why = cls.missing(weightless(), BARE)
    assert (why is None) == (not reasons(name))
    assert why is None or (why in reasons(name) and "\n" not in why)
    entry = catalogue(name, weightless().robot, BARE)[0]
    assert entry["why"] == why
    assert (not entry["coefficients"]) == (why is not None)


def test_backlash_without_directions_says_that_only_gravity_is_tested() -> None:
    backlash = REGISTRY["backlash"]
    assert backlash.missing(arm("puma560"), BARE) is None
    assert backlash.missing(arm("puma560"), BARE, usual=True) == reasons("backlash")[1]
    named, missing = named_candidates(arm("puma560"), BARE, ())
    assert missing["backlash"] == reasons("backlash")[1]
    assert {c.effect.settings()["by"] for c in named if c.effect.name == "backlash"} <= {"gravity"}


def test_columns_and_masses_are_what_effects_ask_for() -> None:
    assert set(NEEDY) >= {"backlash", "approach_lag", "payload_compliance", "thermal_expansion", "frame_drift"}
    assert REGISTRY["joint_hardening"].missing(weightless(), BARE) == "no masses in the robot file"
    assert REGISTRY["frame_drift"].missing(arm("puma560"), BARE) == "no time_s column that varies"
    data = dataclasses.replace(BARE, payload=np.zeros(2))
    assert REGISTRY["payload_compliance"].missing(arm("puma560"), data) == "payload_kg is zero throughout"


@pytest.mark.parametrize("name", [name for name in NEEDY if name not in PAST + SLIDING])
def test_an_effect_of_the_robot_file_whose_need_is_missing_is_an_error(name: str) -> None:
    robot = dataclasses.replace(weightless().robot, effects=(example(name),))
    with pytest.raises((UsageError, InputError), match=r"needs (the column|mass and com)"):
        predict(robot, BARE)


def test_weight_is_needed_by_forms_that_gravity_drives() -> None:
    for name, settings in (("backlash", {"by": "gravity"}), ("joint_compliance", {}), ("joint_correction", CORRECTION)):
        effect = REGISTRY[name].from_settings(("j2",), settings)
        with pytest.raises(UsageError, match=f"{name}.* needs mass and com of the links"):
            effect.terms(weightless(), circumstances(weightless().robot, 3))


def test_a_driver_is_a_name_or_a_list_of_names() -> None:
    coupling = REGISTRY["joint_coupling"]
    assert coupling.from_settings(("j2",), {"drivers": "j1"}) == coupling.from_settings(("j2",), {"drivers": ["j1"]})


CORRECTION = {"drivers": ["torque"], "range": [[-1.0, 1.0]], "degree": 2}
WRONG = {
    "5": "expected a mapping with the key effect, found 5",
    "{joints: [j2]}": "expected a mapping with the key effect",
    "{effect: backlsh}": "no effect 'backlsh', did you mean 'backlash'",
    "{effect: backlash}": "backlash needs joints, each once: some of j1, j2",
    "{effect: backlash, joints: [j2, j2]}": "backlash needs joints, each once",
    "{effect: backlash, joints: [j9]}": "joints must be a list of j1, j2",
    "{effect: base_frame, joints: [j1]}": "base_frame acts on no joint in particular",
    "{effect: backlash, joints: [j2], values: {j3: 1}}": "backlash[j2] has no coefficient 'j3'; it has j2",
    "{effect: backlash, joints: [j2], values: {j2: big}}": "values.j2 must be a finite number, found 'big'",
    "{effect: backlash, joints: [j2], values: {j2: true}}": "values.j2 must be a finite number",
    "{effect: backlash, joints: [j2], values: 3}": "values must be a mapping of name to number, found 3",
    "{effect: backlash, joints: [j2], by: luck}": "backlash: by must be approach or gravity, found 'luck'",
    "{effect: backlash, joints: [j2], by: gravity, friction_nm: -1}": "friction_nm must be a number of at least 0",
    "{effect: backlash, joints: [j2], friction_nm: 1}": "friction_nm belongs to by: gravity",
    "{effect: payload_compliance, joints: [j2], com: far}": "com must be known or uncertain",
    "{effect: gear_ratio, joints: [j2], tooth: 3}": "gear_ratio has no setting 'tooth'",
    "{effect: link_geometry, joints: [j2], labels: [b]}": "link_geometry: labels must be a list of",
    "{effect: joint_coupling, joints: [j2], drivers: [j8]}": "no joint 'j8'; this arm has j1",
    "{effect: transmission_error, joints: [j2], orders: [0]}": "different numbers above 0 and at most 1000, found [0]",
    "{effect: transmission_error, joints: [j2], orders: 3}": "orders must be a list of different numbers",
    "{effect: transmission_error, joints: [j2], orders: [1, 1]}": "orders must be a list of different numbers",
    "{effect: transmission_error, joints: [j2], shrunk: 3}": "shrunk must be true or false",
    "{effect: axis_wobble, joints: [j2], tilts: [z]}": "tilts must be a list of some of alpha, beta, flex_x, flex_y",
    "{effect: joint_compliance, joints: [j2], masses: heavy}": "masses must be known or uncertain or unknown",
    "{effect: joint_hardening, joints: [j2], knee_nm: 0}": "knee_nm must be a number above 0",
    "{effect: joint_hardening, joints: [j2], knee_nm: 5, torque_nm: 5}": "torque_nm or knee_nm, not both",
    "{effect: joint_compliance, joints: [j2], deflection: soft}": "deflection must be equilibrium or rigid",
    "{effect: base_compliance, below: true, masses: unknown}": "below: true needs masses: known",
    "{effect: counterbalance, joints: [j2], ratio: 1}": "ratio must be a number above 0 and below 1, found 1",
    "{effect: thermal_expansion, time_constant_s: 0}": "time_constant_s must be a number above 0",
    "{effect: thermal_expansion, slides: 2}": "slides must be true or false, found 2",
    "{effect: frame_drift, turning: 1}": "turning must be true or false, found 1",
    "{effect: frame_drift, degree: 10}": "degree must be a whole number of at least 1 and at most 9, found 10",
    "{effect: frame_drift, span_s: 0}": "span_s must be a number above 0, found 0",
    "{effect: joint_correction, joints: [j2]}": "drivers must be a list of one or two names",
    "{effect: joint_correction, joints: [j2], drivers: [j3], range: [3]}": "list of lists of 2 numbers, found [3]",
    "{effect: joint_correction, joints: [j2], drivers: [j3], range: []}": "one for each driver, found []",
    "{effect: joint_correction, joints: [j2], lengths: [1, 1], centres: []}": "lengths must be a positive number",
    "{effect: joint_correction, joints: [j2], lengths: [1], centres: [[0, 0]]}": "lists of a number for each joint",
    "{effect: joint_correction, joints: [j2], drivers: [j3], range: [[0, 1]], degree: 0}": "at least 1 and at most 40",
}


@pytest.mark.parametrize("entry", WRONG)
def test_each_mistake_of_an_entry_has_its_message(entry: str) -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=(yaml.safe_load(entry),))
    with pytest.raises(InputError) as caught:
        known_effects(robot)
    assert caught.value.problems[0].column == "effects[0]"
    assert WRONG[entry] in caught.value.problems[0].message


def test_all_mistakes_come_at_once_and_a_joint_that_cannot_is_named() -> None:
    entries = ({"effect": "axis_wobble", "joints": ["j3"]}, {"effect": "backlash"})
    with pytest.raises(InputError) as caught:
        known_effects(dataclasses.replace(arm("stanford").robot, effects=entries))
    assert [problem.column for problem in caught.value.problems] == ["effects[0]", "effects[1]"]
    assert "axis_wobble cannot act on j3; it can on j1, j2, j4" in caught.value.problems[0].message


# Settings of an effect of one's own: what its fields declare is read, checked, converted and written.


@dataclass(frozen=True)
class _Toy(Effect):
    """One setting of each kind."""

    size: float = setting(1.0, unit="length", above=0.0, below=9.0)
    turns: tuple[float, ...] = setting((0.5,), key="turns_used", unit="angle", different=True)
    count: int = setting(2, written=True, least=1)
    corner: tuple[tuple[float, float], ...] = setting(())
    end: Literal["near", "far"] = setting("near", written=lambda toy: toy.count > 2)
    note: str | None = setting(None)
    cached: float = 3.0

    name = "toy"

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        return ()


def test_defaults_are_not_written_unless_declared() -> None:
    assert _Toy(("j1",)).settings() == {"count": 2}
    written = {"size": 2.0, "turns_used": [1.0, 2.0], "count": 3, "corner": [[0.0, 1.0]], "end": "near", "note": "a"}
    effect = _Toy(("j1",), 2.0, (1.0, 2.0), 3, ((0.0, 1.0),), note="a")
    assert list(effect.settings().items()) == list(written.items())
    assert _Toy.from_settings(("j1",), written) == effect
    assert _Toy.from_settings((), {"note": None, "size": 2}) == _Toy((), 2.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"size": 9}, "toy: size must be a number above 0 and below 9, found 9"),
        ({"turns_used": []}, "toy: turns_used must be a list of different numbers, found []"),
        ({"turns_used": [1, 1.0000001]}, "toy: turns_used must be a list of different numbers, found [1, 1.0000001]"),
        ({"count": 0}, "toy: count must be a whole number of at least 1, found 0"),
        ({"corner": [[1]]}, "toy: corner must be a list of lists of 2 numbers, found [[1]]"),
        ({"end": "nowhere"}, "toy: end must be near or far, found 'nowhere'"),
        ({"note": 5}, "toy: note must be a name, found 5"),
        ({"cached": 5}, "toy has no setting 'cached'"),
    ],
)
def test_a_message_says_what_was_expected_and_found(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011  the whole text is compared
        _Toy.from_settings((), settings)
    assert str(caught.value) == message


def test_effects_are_loaded_when_one_is_asked_for() -> None:
    program = (
        "import sys, robacc.effects as effects\n"
        "is_loaded = 'robacc.effects.elastic' in sys.modules\n"
        "sys.exit(is_loaded or effects.effect_class('step').name != 'step' or [*effects.REGISTRY][0] != 'base_frame')"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


# An effect that is added needs its own file and one import: nothing else knows its name.


@pytest.fixture
def toy() -> Iterator[type[Effect]]:
    """Register an effect for one test: a joint's zero that follows the payload."""
    before = dict(REGISTRY)

    @register
    @dataclass(frozen=True)
    class PayloadZero(Effect):
        """Joint variable plus a coefficient times the payload."""

        name = "payload_zero"
        traits = Traits(
            needs=(Need("no payload_kg column that varies", lambda arm, data: varies(data.payload)),),
            drivers=("payload_kg",),
            chart=Over("payload_kg"),
            extrapolates="the zero follows any payload",
        )
        about = About(
            summary="a joint's zero that follows the payload",
            equation="theta_j + c m",
            unit="rad/kg",
            usual_size="1e-5 to 1e-3 rad/kg",
            usual_range=(1e-5, 1e-3),
            needs="payload_kg",
            confused_with="payload_compliance",
            source="this test",
            example="{effect: payload_zero, joints: [j1], values: {j1: 1e-4}}",
        )

        def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
            payload = driven_by(arm, data, "payload_kg", self.name)
            return tuple(self.joint_term(arm, joint, payload, unit="rad/kg") for joint in self.joints)

    yield PayloadZero
    REGISTRY.clear()
    REGISTRY.update(before)


def test_it_is_listed_read_simulated_fitted_traced_and_drawn(toy: type[Effect]) -> None:
    robot = arm("puma560").robot
    assert [entry["name"] for entry in catalogue("payload_zero", robot)] == ["payload_zero"]
    truth = dataclasses.replace(robot, effects=({"effect": "payload_zero", "joints": ["j1"], "values": {"j1": 3e-4}},))
    data = circumstances(robot, 80)
    rng = np.random.default_rng(3)
    data = dataclasses.replace(data, payload=rng.choice([0.0, 2.0, 5.0], 80), rotation=None)
    measured = predict(truth, data).translation + rng.normal(scale=2e-5, size=(3, 80))
    data = dataclasses.replace(data, position=measured)
    model = Model(arm("puma560"))
    effect = toy(joints=("j1",))
    found = fit(dataclasses.replace(model, free=(effect,)), data, Options())
    assert found.theta[0] == pytest.approx(3e-4, rel=0.05)
    (curve,) = partial_residuals(effect, found, data)
    assert (curve.driver, curve.driver_unit) == ("payload_kg", "kg")
    result = trace(model, data, n_folds=3)
    assert [(finding.effect, finding.joints) for finding in result.findings] == [("payload_zero", ("j1",))]


def test_nothing_outside_the_effects_names_one() -> None:
    """Modules that judge effects ask them; only what registers frames or geometry knows those by name."""
    folder = Path(robacc.__file__).parent
    classes = re.compile(r"from robacc\.effects\.(?!base|campaign|driver|elastic|periodic|specification)")
    offenders = [
        str(path.relative_to(folder))
        for package in ("tracing", "accuracy", "api", "calibration", "comparison", "documents", "gates", "render")
        for path in ([folder / package] if package.endswith(".py") else sorted((folder / package).rglob("*.py")))
        if classes.search(path.read_text(encoding="utf-8"))
    ]
    assert offenders == []


# Coefficients beyond what an effect can be are named, and compete with a handicap.


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_usual_sizes_are_plausible_and_ten_thousand_times_that_is_not(name: str) -> None:
    cls: type[Effect] = REGISTRY[name]
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    data = simulate(robot, Plan(20, seed=1, noise_position=1e-5, orientation=False)).data
    data = dataclasses.replace(
        data, time=np.arange(20.0), temperature=20 + np.arange(20.0) / 5, payload=np.tile([0.0, 5.0], 10)
    )
    if cls.missing(Model.of(robot).arm, data):
        pytest.skip("not possible on these poses")
    (effect,) = build(parse_requests(name), Model.of(robot).arm, data)
    terms = effect.terms(Model.of(robot).arm, data)
    usual = np.resize((1.0, -1.0 if name == "counterbalance" else 1.0), len(terms)) * cls.about.usual_range[1]
    assert effect.implausible(terms, usual.tolist()) is None
    if not cls.traits.is_constant and any(term.unit == cls.about.unit.partition(" (")[0] for term in terms):
        assert "implausible" in effect.implausible(terms, (1e4 * usual).tolist())


@pytest.mark.parametrize(
    ("name", "settings", "values", "reason"),
    [
        ("joint_hardening", {"knee_nm": 20.0}, [-1e-6], "cannot be negative"),  # A TIAGo Pro's spring that softens.
        ("counterbalance", {"ratio": 0.6}, [-6e-3, -5e-4], "free length"),  # An iiwa that sags.
    ],
)
def test_springs_that_cannot_be_are_implausible(
    name: str, settings: dict[str, float], values: list[float], reason: str
) -> None:
    one = Model.of(arm("puma560").robot).arm
    data = simulate(arm("puma560").robot, Plan(20, seed=1, noise_position=1e-5, orientation=False)).data
    effect = REGISTRY[name].from_settings(("j2",), settings)
    terms = effect.terms(one, data)
    assert reason in (effect.implausible(terms, values) or "")
    assert effect.implausible(terms, [abs(values[0]), *values[1:]]) is None
    assert effect.form.rejects_implausible


def test_a_joint_that_hardly_carries_a_load_does_not_harden_by_it() -> None:
    one = Model.of(arm("puma560").robot).arm
    data = simulate(arm("puma560").robot, Plan(20, seed=1, noise_position=1e-5, orientation=False)).data
    for torque, is_plausible in ((80.0, True), (0.0019, False)):
        effect = JointHardening(("j5",), torque)
        reason = effect.implausible(effect.terms(one, data), [3.6e-4])
        assert (reason is None) is is_plausible
        if reason is not None:
            assert reason.startswith("joint_hardening.j5 as a compliance = 0.568 rad/(N m) is implausible; usual")


def test_a_negative_compliance_is_implausible_and_never_a_finding() -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    data = simulate(robot, Plan(60, seed=2, noise_position=1e-5, orientation=False)).data
    compliance = JointCompliance(("j2",), masses="known")
    found = {}
    for value in (8e-6, -8e-6):
        bound = Model.of(robot, [compliance]).bind(data)
        theta = np.full(len(bound.terms), value)
        assert (compliance.implausible(bound.terms, theta.tolist()) is None) is (value > 0)
        shifted = dataclasses.replace(
            data, position=data.position + bound.poses(theta).translation - bound.poses(0 * theta).translation
        )
        model = model_of(robot, "base_frame", data)
        found[value > 0] = [effect.key() for effect in search(model, shifted).effects]
    assert found[True] == [compliance.key()]
    assert compliance.key() not in found[False]
