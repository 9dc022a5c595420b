"""``robacc export --format`` and ``robacc import`` from the command line."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from commands import output, refused, run

ROOT = Path(__file__).resolve().parents[2]
UR10 = ROOT / "configs" / "robots" / "ur10.yaml"
CONF = ROOT / "tests" / "controllers" / "samples" / "calibration.conf"


def test_a_calibration_goes_in_and_out(tmp_path: Path) -> None:
    arm, conf, document = tmp_path / "arm.yaml", tmp_path / "new.conf", tmp_path / "export.json"
    output("import", CONF, "--arm", "ur10e", "--output", arm)
    options = ("--format", "ur-calibration", "--template", CONF, "--output", conf, "--document", document)
    shown = output("export", arm, *options)
    assert shown.startswith("Export as ur-calibration of ur10e\n")
    assert "position < 0.0001 mm rms" in shown
    result = json.loads(document.read_text(encoding="utf-8"))
    assert result["file_sha256"] == hashlib.sha256(conf.read_bytes()).hexdigest()
    assert result["remaining_error"]["position"]["max_m"] < 1e-6
    assert [file["kind"] for file in result["inputs"]] == ["robot", "template"]
    assert conf.read_text(encoding="ascii").splitlines()[5:] == CONF.read_text(encoding="ascii").splitlines()[5:]


def test_standard_output_is_the_file_and_nothing_else(tmp_path: Path) -> None:
    result = run("export", UR10, "--format", "xarm", "--output", "-")
    assert result.stdout.startswith("# written by robacc")
    assert result.stderr.startswith("Export as xarm")
    again = tmp_path / "links.yaml"
    again.write_text(result.stdout, encoding="utf-8")
    assert output("import", again, "--output", "-").startswith("# Written by robacc")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("export", UR10), "name the format of the file with --format: urdf, mdh, json"),
        (("export", UR10, "--format", "mdh"), "name the file to write with --output"),
        (("export", UR10, "--format", "mdh", "--urdf", "-"), "--urdf writes a URDF, --format mdh another file"),
        (("export", UR10, "--format", "mdh", "-o", "-", "--arm", "ur5"), "--arm belongs to --format ur-calibration"),
        (("export", UR10, "--format", "ur-calibration", "-o", "-", "--arm", "x"), "no arm 'x' of Universal Robots"),
        (("export", UR10, "--format", "mdh", "-o", "-", "--template", CONF), "--template belongs to"),
        (("export", UR10, "--format", "mdh", "-o", "-", "--nominal", UR10), "--nominal belongs to"),
        (("import", CONF, "-o", "-"), "does not say which arm it belongs to"),
    ],
)
def test_wrong_usage_is_explained(words: tuple[object, ...], message: str) -> None:
    assert message in refused(*words)
