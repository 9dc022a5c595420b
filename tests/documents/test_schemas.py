"""The JSON Schemas of results hold for what every command writes, and for nothing that lacks what readers rely on."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import results
from jsonschema import Draft202012Validator, ValidationError
from typer.testing import CliRunner

import robacc
from robacc.api.result import schema_names
from robacc.cli.main import COMMANDS, FORMS, RENAMED, app
from robacc.documents.envelope import schema_version

Document = dict[str, Any]
NAMES = list(schema_names())
NO_RESULT = {"history", "report", "init", "schema", "plot", "import"}
"""Commands that write no JSON."""
CORRECT = (
    "correct",
    "sample_data/iso9283/plan.csv",
    "--model",
    "sample_data/truth.yaml",
    "--nominal",
    "sample_data/robot.yaml",
)
POSES, ROBOT = "sample_data/poses.csv", "sample_data/robot.yaml"


@cache
def validator(name: str) -> Draft202012Validator:
    return Draft202012Validator(robacc.schema(name))


@cache
def closed(name: str) -> Draft202012Validator:
    """The schema with every object closed that lists its keys: it takes described keys only."""
    return Draft202012Validator(_closed(robacc.schema(name)))


def _closed(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_closed(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: _closed(value) for key, value in schema.items()}
    if "properties" in found and "required" in found and isinstance(found["required"], list):
        found.setdefault("additionalProperties", False)
    return found


def wrong(name: str, document: Document, by: Callable[[str], Draft202012Validator] = validator) -> list[str]:
    return [f"{one.json_path}: {one.message[:200]}" for one in _causes(by(name).iter_errors(document))]


def _causes(errors: Iterable[ValidationError]) -> Iterator[ValidationError]:
    """What is wrong with a value that may be null too stands below the error itself."""
    for one in errors:
        yield from [cause for cause in one.context or () if cause.schema.get("type") != "null"] or [one]


def run(*arguments: str) -> Document:
    done = results.run(*arguments, "--format", "json")
    assert done.stdout, done.stderr
    found: Document = json.loads(done.stdout)
    return found


def sample() -> robacc.Measurements:
    root = results.PROJECT
    return robacc.read_poses(root / POSES, robot=robacc.read_robot(root / ROBOT))


def made(found: robacc.Result) -> Document:
    document: Document = json.loads(found.to_json())
    return document


def few(n: int) -> Document:
    """So few poses that most intervals cannot be had."""
    return made(robacc.estimate(sample().subset(slice(0, n)), robot=results.PROJECT / ROBOT))


def repeated() -> Document:
    """Commanded poses that were repeated, two targets, a stated uncertainty, and no orientation."""
    import numpy as np

    noise = np.random.default_rng(0).normal(scale=1e-4, size=(3, 40))
    data = robacc.Measurements(
        position=noise,
        commanded_position=np.zeros((3, 40)),
        sigma_position=np.full((3, 40), 1e-5),
        pose=np.repeat(list("abcdefgh"), 5),
        target=np.tile(["upper", "lower"], 20),
    )
    return made(robacc.estimate(data))


def stored(folder: Path, *, alone: bool = False) -> tuple[str, ...]:
    paths = []
    for name in ("estimate",) if alone else ("calibrate", "trace"):
        paths.append(str(folder / f"{name}.json"))
        Path(paths[-1]).write_text(results.text(name), encoding="utf-8")
    return tuple(paths)


def gated(folder: Path) -> tuple[str, str]:
    (folder / "gate.yaml").write_text(results.GATE, encoding="utf-8")
    return "--gate", str(folder / "gate.yaml")


def holdout() -> Document:
    root = results.PROJECT
    data = sample()
    fit = robacc.calibrate(
        data.subset(slice(0, 40)),
        robot=root / ROBOT,
        fit=("base_frame", "tool_frame", "joint_offset"),
        holdout=data.subset(slice(40, 60)),
    )
    return made(fit)


def against() -> Document:
    root = results.PROJECT / "configs" / "robots" / "puma560.yaml"
    data = robacc.simulate(root, poses=12, noise="0.05mm", noise_orientation="0.01deg", seed=3).data
    return made(robacc.predict(root, against=data, align="base_frame", noise="0.05mm,0.01deg"))


def measured_twice(folder: Path) -> tuple[str, ...]:
    """The same targets, before and after a correction, and its model."""
    root = results.PROJECT
    model = robacc.calibrate(
        root / POSES, robot=root / ROBOT, fit=("base_frame", "tool_frame", "joint_offset"), folds=2
    )
    model.write_model(folder / "model.yaml")
    for name, seed in (("before", 1), ("after", 2)):
        robacc.simulate(
            root / "sample_data" / "truth.yaml", poses=8, noise="0.02mm", seed=seed, commanded=True, motion=False
        ).write(folder / f"{name}.csv")
    return f"{folder}/before.csv", f"{folder}/after.csv", "--model", f"{folder}/model.yaml"


def history(folder: Path, *words: str) -> Document:
    """A command on a database with an estimate and two fits of one arm, and with the model of a fit."""
    fitted = robacc.calibrate(results.PROJECT / POSES, robot=results.PROJECT / ROBOT, folds=2)
    fitted.write_model(folder / "model.yaml")
    for name, at in zip(
        (*stored(folder), *stored(folder, alone=True)), ("2026-01-01", "2026-02-01", "2026-03-01"), strict=True
    ):
        robacc.history_add(name, db=folder / "arm.db", at=at, arm="sample arm")
    return run(*words, "--db", str(folder / "arm.db"))


MADE: dict[str, Callable[[Path], Document]] = {
    "history-add": lambda folder: run("history", "add", *stored(folder), "--db", str(folder / "new.db")),
    "history-show": lambda folder: history(folder, "history", "show"),
    "history-trend": lambda folder: history(folder, "history", "trend", "joint_offset.j3"),
    "history-changes": lambda folder: history(folder, "history", "changes"),
    "health": lambda folder: history(folder, "health", POSES, "--robot", str(folder / "model.yaml")),
    "fleet": lambda folder: run("fleet", *stored(folder)),
    **{name: lambda _, name=name: results.document(name) for name in results.CALLS},
    "estimate, gate": lambda folder: run("estimate", *results.CALLS["estimate"], *gated(folder)),
    "estimate, base frame": lambda _: run("estimate", POSES, "--robot", ROBOT, "--frame", "base"),
    "estimate, one pose": lambda _: few(1),
    "estimate, three poses": lambda _: few(3),
    "estimate, positions of repeated poses": lambda _: repeated(),
    "robots": lambda _: run("show", "robots", "kuka"),
    "estimate-many": lambda folder: run("estimate", POSES, f"{folder}/none.csv", "--robot", ROBOT),
    "predict, against": lambda _: against(),
    "calibrate, holdout": lambda _: holdout(),
    "compare": lambda folder: run("compare", *stored(folder)),
    "compare, grade": lambda folder: run("compare", *stored(folder, alone=True) * 2, "--grade", "B"),
    "check": lambda folder: run("check", *stored(folder, alone=True), *gated(folder)),
    "simulate": lambda folder: run("simulate", ROBOT, "--poses", "5", "--outliers", "1", "-o", f"{folder}/made.csv"),
    "correct": lambda folder: run(*CORRECT, "-o", f"{folder}/corrected.csv"),
    "correct, base frame": lambda folder: run(*CORRECT, "-o", f"{folder}/corrected.csv", "--frame", "base"),
    "compare-paired": lambda folder: run("compare", "--paired", *measured_twice(folder)),
    "show": lambda _: run("show", ROBOT),
    "show, masses": lambda _: run("show", "configs/robots/puma560.yaml"),
    "effects": lambda _: run("show", "effects"),
    "effects, poses": lambda _: run("show", "effects", "--robot", ROBOT, "--poses", POSES),
    "export": lambda folder: run("export", ROBOT, "--urdf", f"{folder}/arm.urdf"),
    "plan": lambda folder: run("plan", ROBOT, "--poses", "12", "--candidates", "300", "-o", f"{folder}/plan.csv"),
    "plan, enough": lambda folder: run(
        *("plan", ROBOT, "--candidates", "300", "--already", POSES, "-o", f"{folder}/next.csv")
    ),
    "plan, acceptance": lambda folder: run(
        *("plan", ROBOT, "--for", "acceptance", "--grade", "D", "--candidates", "400", "-o", f"{folder}/test.csv")
    ),
    "iso9283-poses": lambda folder: run("plan", ROBOT, "--for", "iso9283", "-o", f"{folder}/five.csv"),
}
"""A result by what it is of; the first word is the schema's name."""

CONTRACT = {
    "estimate": (
        "n_poses frame position orientation grade grade.grade grade.scale grade.demonstrated",
        "position.mean_m position.covariance_m2 position.centred_covariance_m2 position.rms_m position.mean_error_m",
        "position.p95_m position.max_m position.errors_m orientation.mean_rad orientation.covariance_rad2",
        "orientation.centred_covariance_rad2 orientation.rms_rad orientation.mean_error_rad orientation.p95_rad",
        "orientation.max_rad orientation.errors_rad",
    ),
    "predict": (
        "n_poses position.covariance_m2 position.rms_m position.worst.pose position.worst.rms_m",
        "orientation.covariance_rad2 orientation.rms_rad orientation.worst.rms_rad",
        "budget.0.parameter budget.0.joint budget.0.share_position budget.0.share_orientation",
    ),
    "calibrate": (
        "n_poses noise.position_m noise.orientation_rad noise.source parameters.0.name parameters.0.value",
        "parameters.0.std parameters.0.unit nominal.fitted.position.rms_m before.held_out.position.p95_m",
        "after.fitted.position.max_m after.held_out.position.mean_error_m after.held_out.orientation",
    ),
    "trace": (
        "n_poses verdict findings candidates unexplained.rms_m unexplained.noise_rms_m unexplained.structured",
        "unexplained.p_value unexplained.hints findings.0.effect findings.0.joints findings.0.alternatives",
        "findings.0.p_value findings.0.held_out_before_m findings.0.held_out_after_m findings.0.parameters",
        "nominal.fitted.position.rms_m before.held_out.position.p95_m after.held_out.position.mean_error_m",
    ),
    "iso9283": ("n_poses iso9283.AP.max_m iso9283.RP.max_m iso9283.RP.intervals.max_m protocol.0.status",),
}
"""Keys that other programs rely on, beside those that every result has."""
ALWAYS = "schema robacc command options inputs seed inputs.0.name inputs.0.sha256 inputs.0.kind"
RELIED_ON = [(name, key) for name, lines in CONTRACT.items() for key in f"{' '.join(lines)} {ALWAYS}".split()]


@pytest.mark.parametrize("name", NAMES)
def test_schema_is_one_and_says_whose(name: str) -> None:
    found, version = robacc.schema(name), schema_version(name)
    Draft202012Validator.check_schema(found)
    assert (found["$id"], found["title"]) == (f"urn:robacc:schema:{name}:{version}", f"robacc.{name}/{version}")
    assert found["properties"]["schema"]["const"] == f"robacc.{name}/{version}"


def test_every_command_that_writes_json_has_a_schema() -> None:
    histories = {name.replace(" ", "-") for name in FORMS if name.startswith("history ")}
    assert set(NAMES) == ({*COMMANDS, *RENAMED} - NO_RESULT) | {"estimate-many", "compare-paired"} | histories


def test_parts_that_schemas_share_are_the_same_in_all() -> None:
    seen: dict[str, Any] = {}
    for owner in NAMES:
        for name, part in robacc.schema(owner)["$defs"].items():
            assert seen.setdefault(name, part) == part, (owner, name)


@pytest.mark.parametrize("name", NAMES)
def test_every_value_is_described_and_every_number_says_its_unit(name: str) -> None:
    for key, part in _properties(robacc.schema(name)):
        kinds = part.get("type", [])
        if not kinds or "object" in kinds or "items" in part:
            continue
        assert part.get("description"), key
        if "number" in kinds and (unit := re.search(r"_(m|rad)(2?)$", key)):
            assert re.search(rf"\b{unit[1]}{'²' if unit[2] else ''}(?![\w²])", part["description"]), (key, part)


def _properties(schema: Any) -> Iterator[tuple[str, Document]]:
    if isinstance(schema, list):
        for one in schema:
            yield from _properties(one)
    elif isinstance(schema, dict):
        if isinstance(schema.get("properties"), dict) and "type" in schema:
            yield from schema["properties"].items()
        for one in schema.values():
            yield from _properties(one)


@pytest.mark.parametrize("what", MADE)
def test_results_meet_their_schema_and_every_key_is_described(what: str, tmp_path: Path) -> None:
    document, name = MADE[what](tmp_path), what.split(",")[0]
    assert wrong(name, document) == []
    assert wrong(name, document, closed) == [], "a key that the schema does not describe"
    if name == "estimate-many":
        assert [one["done"] for one in document["results"]] == [True, False]
        assert wrong("estimate", document["results"][0]["result"]) == []


def test_every_schema_is_held_against_a_result() -> None:
    assert {what.split(",")[0] for what in MADE} == set(NAMES)


def _shortened(value: Any) -> Any:
    """The first of long lists: what is wrong with one of their entries is with all."""
    if isinstance(value, dict):
        return {key: _shortened(one) for key, one in value.items()}
    return [_shortened(one) for one in value[:3]] if isinstance(value, list) else value


@pytest.mark.parametrize(("name", "key"), RELIED_ON, ids=[f"{name} {key}" for name, key in RELIED_ON])
def test_a_result_without_a_key_that_is_relied_on_is_refused(name: str, key: str) -> None:
    document: Any = _shortened(results.document(name))
    assert wrong(name, document) == []
    *owners, last = key.split(".")
    place = document
    for owner in owners:
        place = place[int(owner)] if isinstance(place, list) else place[owner]
    del place[last]
    assert any(f"'{last}' is a required property" in one for one in wrong(name, document))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("n_poses", -1, "less than the minimum"),
        ("n_poses", 2.5, "is not of type 'integer'"),
        ("frame", "world", "is not one of ['tool', 'base']"),
        ("schema", "robacc.estimate/2", "'robacc.estimate/1' was expected"),
        ("seed", "0", "is not of type"),
        ("position", None, "is not of type 'object'"),
        ("warnings", "none", "is not of type 'array'"),
    ],
)
def test_a_broken_result_is_refused(key: str, value: Any, message: str) -> None:
    document = results.document("estimate") | {key: value}
    assert any(message in one for one in wrong("estimate", document))


def test_a_broken_number_far_inside_is_refused() -> None:
    document = results.document("estimate")
    document["position"]["covariance_m2"][2] = [0.0, 0.0]
    document["position"]["rms_m"] = -1e-9
    document["poses"]["attained_m"][7][1] = "0.3"
    assert len(wrong("estimate", document)) == 3


def test_results_may_gain_keys() -> None:
    document = results.document("estimate") | {"new": 1}
    document["position"]["new"] = 2
    assert wrong("estimate", document) == []
    assert len(wrong("estimate", document, closed)) == 2


def test_the_command_prints_the_schema(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["show", "schema", "trace"], catch_exceptions=False)
    assert (done.exit_code, done.stderr) == (0, "")
    assert json.loads(done.stdout) == robacc.schema("trace")
    listed = CliRunner().invoke(app, ["show", "schema"], catch_exceptions=False)
    assert listed.stdout.split() == NAMES
    target = tmp_path / "check.json"
    assert CliRunner().invoke(app, ["show", "schema", "check", "-o", str(target)]).exit_code == 0
    assert json.loads(target.read_text(encoding="utf-8")) == robacc.schema("check")
    missing = CliRunner().invoke(app, ["show", "schema", "estimat"], catch_exceptions=False)
    assert missing.exit_code == 2
    assert f"no schema 'estimat'; choose one of {', '.join(NAMES)}" in " ".join(missing.stderr.split())
