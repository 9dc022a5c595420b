"""Estimates of files that are read in parts: those of the whole file, whoever did the work."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.accuracy.error_sums import DifferentCommands, features, weights
from robacc.errors import InputError
from robacc.io.json_text import json_text

ROOT = Path(__file__).parents[2]
ROBOT = str(ROOT / "sample_data" / "robot.yaml")
BIN = 1 / 4096
"""Relative width of a bin of lengths, the most by which a quantile may differ."""


def in_parts(monkeypatch: pytest.MonkeyPatch, size: int = 1 << 15) -> None:
    """Take every file for a large one, of which a part has some two hundred poses."""
    for name, value in (("LARGE", 1), ("_PART", size), ("_SAMPLES", 40), ("_SAMPLE", 1 << 10)):
        monkeypatch.setattr(f"robacc.io.table.{name}", value)


def simulated(path: Path, robot: str = ROBOT, n: int = 2000, **options: object) -> str:
    plan = robacc.simulate(robot, poses=n, seed=3, noise="0.1mm", **options)  # type: ignore[arg-type]
    path.write_text(plan.csv(), encoding="utf-8")
    return str(path)


def check_same(whole: robacc.Estimate, parts: robacc.Estimate, fitted: bool = False) -> None:
    """Check every figure; frames that are fitted to some 300 of the poses add their uncertainty to all errors."""
    near = 0.15 if fitted else 1e-12
    assert any("was read in" in note for note in parts.notes)
    assert parts.n_poses == whole.n_poses
    for one, other in ((whole.position, parts.position), (whole.orientation, parts.orientation)):
        if one is None or other is None:
            assert one is other
            continue
        scale = one.rms
        assert (one.n, one.n_poses) == (other.n, other.n_poses)
        assert other.mean == pytest.approx(one.mean, abs=near * scale)
        assert other.covariance == pytest.approx(one.covariance, abs=near * scale**2)
        assert other.centred_covariance == pytest.approx(one.centred_covariance, abs=near * scale**2)
        for name in ("rms", "mean_error", "max"):
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=near), name
        assert other.p95 == pytest.approx(one.p95, rel=near + BIN + 4.0 / one.n)
        for name in ("rms", "mean_error", "p95"):
            # Groups of commands are as good as the commands: a standard error from 2000 poses has one of 1.6 per cent.
            mine, its = (getattr(each.intervals, name) for each in (one, other))
            assert its.upper - its.lower == pytest.approx(mine.upper - mine.lower, rel=0.5 if fitted else 0.12), name
    lines = [[pose.line for pose in each.worst_position] for each in (whole, parts)]
    assert fitted or lines[0] == lines[1]
    assert [each.name for each in parts.targets] == [each.name for each in whole.targets]
    assert parts.grade.grade == whole.grade.grade


@pytest.mark.parametrize("align", [None, ("base_frame", "tool_frame")])
def test_an_estimate_in_parts_is_that_of_the_whole_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, align: tuple[str, ...] | None
) -> None:
    path = simulated(tmp_path / "poses.csv")
    whole = robacc.estimate(path, robot=ROBOT, align=align)
    in_parts(monkeypatch)
    parts = robacc.estimate(path, robot=ROBOT, align=align)
    check_same(whole, parts, fitted=align is not None)
    # All rows, in their order.
    rows = [[line.split(",") for line in each.per_pose_csv().splitlines()] for each in (whole, parts)]
    assert [row[:2] for row in rows[0]] == [row[:2] for row in rows[1]]
    lengths = np.array([[float(row[5]) for row in each[1:]] for each in rows])
    assert lengths[1] == pytest.approx(lengths[0], abs=1e-15 if align is None else 0.3 * whole.position.rms)


def test_repetitions_effects_and_circumstances_are_those_of_the_whole_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = str(ROOT / "sample_data" / "trace" / "truth.yaml")
    path = simulated(tmp_path / "poses.csv", truth, 600, cycles=4, motion=True, time_step=5.0, temperature=(20.0, 30.0))
    whole = robacc.estimate(path, robot=truth)
    in_parts(monkeypatch)
    parts = robacc.estimate(path, robot=truth)
    check_same(whole, parts)
    assert parts.position.n_poses == 600
    assert "read in parts" in parts.position.structure.text


def test_commands_of_the_file_are_registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = simulated(tmp_path / "poses.csv", commanded=True, noise_orientation="0.01deg")
    whole = robacc.estimate(path, align=("base_frame",))
    in_parts(monkeypatch)
    check_same(whole, robacc.estimate(path, align=("base_frame",)), fitted=True)


def test_processes_change_no_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = simulated(tmp_path / "poses.csv", n=800)
    in_parts(monkeypatch)
    one, two = (robacc.estimate(path, robot=ROBOT, jobs=jobs) for jobs in (1, 2))
    assert json_text(one.document()) == json_text(two.document())


def test_a_wrong_number_is_named_with_its_line_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv"))
    lines = path.read_text(encoding="utf-8").split("\n")
    lines[1500] = lines[1500].replace(",", ",x", 1)
    path.write_text("\n".join(lines), encoding="utf-8")
    in_parts(monkeypatch)
    with pytest.raises(InputError, match=r"poses\.csv:1501, q2: found 'x"):
        robacc.estimate(str(path), robot=ROBOT, jobs=2)


def test_a_reading_far_beyond_the_others_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv"))
    lines = path.read_text(encoding="utf-8").split("\n")
    cells = lines[1500].split(",")
    cells[6] = str(float(cells[6]) + 0.02)
    lines[1500] = ",".join(cells)
    path.write_text("\n".join(lines), encoding="utf-8")
    whole = robacc.estimate(str(path), robot=ROBOT)
    in_parts(monkeypatch)
    parts = robacc.estimate(str(path), robot=ROBOT)
    for result in (whole, parts):
        (warning,) = (text for text in result.warnings if "far beyond" in text)
        assert "line 1501 (" in warning
        assert " more;" not in warning


def test_a_file_in_an_object_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip("fsspec")
    path = simulated(tmp_path / "poses.csv", n=300)
    with fsspec.open("memory://poses.csv", "wb") as stream:
        stream.write(Path(path).read_bytes())
    whole = robacc.estimate("memory://poses.csv", robot=ROBOT)
    assert whole.position.rms == robacc.estimate(path, robot=ROBOT).position.rms
    in_parts(monkeypatch)
    check_same(whole, robacc.estimate("memory://poses.csv", robot=ROBOT))


def test_what_is_not_of_the_documented_form_is_read_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv", n=100))
    semicolons = tmp_path / "semicolons.csv"
    semicolons.write_text(path.read_text(encoding="utf-8").replace(",", ";"), encoding="utf-8")
    in_parts(monkeypatch)
    assert not any("was read in" in note for note in robacc.estimate(str(semicolons), robot=ROBOT).notes)


def test_a_byte_order_mark_moves_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv", n=300))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    whole = robacc.estimate(str(path), robot=ROBOT)
    in_parts(monkeypatch)
    check_same(whole, robacc.estimate(str(path), robot=ROBOT))


def test_weights_of_features_are_the_quadratic_function() -> None:
    rng = np.random.default_rng(0)
    errors, origin, about, linear = rng.normal(size=(3, 20)), *rng.normal(size=(3, 3))
    square = rng.normal(size=(3, 3))
    square += square.T
    shifted = errors - about[:, None]
    expected = linear @ shifted + np.einsum("in,ij,jn->n", shifted, square, shifted)
    z = features(errors - origin[:, None], np.linalg.norm(errors, axis=0))
    assert weights(origin, about, linear, square) @ z == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("count", [1, 60, 20_000, 300_000])
def test_different_commands_are_counted(count: int) -> None:
    rng = np.random.default_rng(count)
    hashes = rng.integers(0, 2**64, size=count, dtype=np.uint64)
    parts = [DifferentCommands.of(rng.permutation(hashes)) for _ in range(3)]
    found = (parts[0] + parts[1] + parts[2]).count(3 * count)
    # Its standard error at these loads is below 0.3 per cent, and nought for few commands.
    assert found == pytest.approx(count, rel=0.01, abs=0.5)
    assert parts[0].count(count) == count


def test_a_calibration_in_parts_is_that_of_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, robot = (str(ROOT / "sample_data" / "trace" / f"{name}.yaml") for name in ("truth", "robot"))
    path = simulated(tmp_path / "poses.csv", truth, 1500, position_only=True)
    fit = "base_frame,tool_frame,joint_offset,link_geometry,joint_compliance[j2],backlash[j3]"
    whole = robacc.calibrate(path, robot=robot, fit=fit, shrink=False)
    in_parts(monkeypatch)
    one, two = (robacc.calibrate(path, robot=robot, fit=fit, shrink=False, jobs=jobs) for jobs in (1, 2))
    assert json_text(one.document()) == json_text(two.document())
    assert any("coefficients are fitted to all rows" in text for text in one.warnings)
    assert one.fit.data.n < 500 < whole.fit.data.n
    mine, its = ({each.name: each for each in result.parameters} for result in (whole, one))
    for name, each in mine.items():
        if each.std:
            # The same rows, other weights; one without a structure, so its standard error is that of independent noise.
            assert its[name].value == pytest.approx(each.value, abs=0.1 * each.std), name
            assert 0.6 * each.std < its[name].std < 3.0 * each.std, name
    assert one.after.held_out_rms == pytest.approx(whole.after.held_out_rms, rel=0.15)


def test_a_trace_in_parts_names_the_effects_and_fits_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, robot = (str(ROOT / "sample_data" / "trace" / f"{name}.yaml") for name in ("truth", "robot"))
    path = simulated(tmp_path / "poses.csv", truth, 1500, position_only=True)
    in_parts(monkeypatch)
    declared = "base_frame,tool_frame,joint_offset,link_geometry"
    result = robacc.trace(path, robot=robot, declared=declared)
    compliance, backlash = result.findings
    assert (compliance.effect, compliance.joints) == ("joint_compliance", ("j2",))
    # Some three hundred poses do not tell a backlash from its nearest likeness.
    assert ("backlash", ("j3",)) in {(each.effect, each.joints) for each in (backlash, *backlash.alternatives)}
    assert len(result.fit_inputs.parts) > 5
