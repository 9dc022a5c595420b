"""Identity of what was tested: from files and texts, with every mistake reported."""

from __future__ import annotations

from pathlib import Path

import pytest

import robacc
from robacc.documents.envelope import read_identity
from robacc.errors import InputError, UsageError
from robacc.render.page import identity_rows
from robacc.robots.description import IDENTITY

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"


def test_later_sources_replace_keys_and_the_order_is_that_of_the_page(tmp_path: Path) -> None:
    path = tmp_path / "identity.yaml"
    path.write_text('serial_number: "12345"\nplace: hall 4\ncustomer: A & B\ndate: 2026-11-22\n', encoding="utf-8")
    identity = read_identity([str(path), "place=hall 5 = new", "operator=N. N."])
    assert identity == {
        "customer": "A & B",
        "serial_number": "12345",
        "operator": "N. N.",
        "place": "hall 5 = new",
        "date": "2026-11-22",
    }
    assert list(identity) == [key for key in IDENTITY if key in identity]
    assert read_identity([]) == {}


def test_mistakes(tmp_path: Path) -> None:
    path = tmp_path / "identity.yaml"
    path.write_text("serial: 12345\nplace: [a]\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_identity([str(path)])
    assert [(problem.line, problem.column) for problem in caught.value.problems] == [(1, "serial"), (2, "place")]
    path.write_text("place:\n", encoding="utf-8")
    with pytest.raises(InputError, match="names nothing of what was tested"):
        read_identity([str(path)])
    with pytest.raises(UsageError, match="unknown key 'operater'; did you mean 'operator'"):
        read_identity(["operater=x"])
    with pytest.raises(UsageError, match="expected one line of text for place"):
        read_identity(["place="])
    with pytest.raises(InputError, match="the file does not exist"):
        read_identity([str(tmp_path / "nowhere.yaml")])


def test_a_robot_file_states_the_identity_of_its_arm(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    text = (SAMPLE / "robot.yaml").read_text(encoding="utf-8")
    path.write_text(text + "identity:\n  serial_number: 007\n  place: hall 4\n", encoding="utf-8")
    document = robacc.estimate(SAMPLE / "poses.csv", robot=path).document()
    (record,) = [record for record in document["inputs"] if record["kind"] == "robot"]
    assert record["identity"] == {"serial_number": "007", "place": "hall 4"}
    assert identity_rows([document], ["a"], {}) == [("Serial number", "007"), ("Place", "hall 4")]
    given = {"place": "hall 5", "operator": "N. N."}
    expected = [("Serial number", "007"), ("Operator", "N. N."), ("Place", "hall 5")]
    assert identity_rows([document], ["a"], given) == expected

    path.write_text(text + "identity: {serial: 7}\n", encoding="utf-8")
    with pytest.raises(InputError, match="identity\\.serial: unknown key; did you mean 'serial_number'"):
        robacc.read_robot(path)


def test_two_arms_on_a_page_have_their_own_numbers() -> None:
    documents = [
        {"inputs": [{"kind": "poses"}, {"kind": "robot", "identity": {"serial_number": number, "place": "hall 4"}}]}
        for number in ("7", "8")
    ]
    assert identity_rows(documents, ["first.json", "second.json"], {}) == [
        ("Serial number", "first.json: 7; second.json: 8"),
        ("Place", "hall 4"),
    ]
    assert identity_rows([{"inputs": []}], ["a"], {}) == []


def test_two_robot_files_of_a_result_keep_their_own_numbers() -> None:
    files = [
        {"name": name, "kind": "robot", "identity": {"serial_number": number, "place": "hall 4"}}
        for name, number in (("model.yaml", "7"), ("robot.yaml", "8"))
    ]
    document = {"inputs": [{"kind": "poses"}, *files]}
    assert identity_rows([document], ["a"], {}) == [
        ("Serial number", "model.yaml: 7; robot.yaml: 8"),
        ("Place", "hall 4"),
    ]
    other = {"inputs": [files[0]]}
    expected = ("Serial number", "a, model.yaml: 7; a, robot.yaml: 8; b: 7")
    assert identity_rows([document, other], ["a", "b"], {})[0] == expected
    assert identity_rows([document], ["a"], {"serial_number": "9"})[0] == ("Serial number", "9")
