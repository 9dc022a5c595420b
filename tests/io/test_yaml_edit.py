"""Edits of YAML text: the new values are read back, and every character that need not change stays."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
import yaml

from robacc.io.yaml_nodes import edited

FILE = """# an arm   of the shop
robacc: 1
name: "arm 7"      # its name on the wall
tool: {xyz: [40, 0, 1.80e2], rpy: [0, 0, 0]}   # the reflector

joints:
  # the base turns
  - name: j1
    d: 486.50      # drawing 12-3
    a: 150
  - {name: j2, d: 0, a: 700.0,
     alpha: 90}    # upper arm
  - name: j3
    limits:
      - -90
      - 90
effects: []
"""


def content() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(FILE)
    document["tool"]["xyz"][2] = 180.0  # PyYAML takes 1.80e2 for text
    return document


def test_the_same_content_gives_the_same_text() -> None:
    assert edited(FILE, content(), "arm.yaml") == FILE


def test_only_what_changes_is_written() -> None:
    document = content()
    document["joints"][0]["d"] = 486.61
    document["joints"][1] |= {"alpha": 90.25, "beta": -0.01, "sign": 0}
    document["joints"][2]["limits"][1] = 91.5
    document["tool"]["xyz"][0] = 40.2
    document["effects"] = [{"effect": "backlash", "joints": ["j1"], "values": {"j1": 0.01}}]
    document["fitted_to"] = ["abc"]
    expected = (
        FILE.replace("486.50", "486.61")
        .replace("alpha: 90}", "alpha: 90.25, beta: -0.01}")
        .replace("- 90\n", "- 91.5\n")
        .replace("[40, 0, 1.80e2]", "[40.2, 0, 1.80e2]")
        .replace("effects: []", "effects: [{effect: backlash, joints: [j1], values: {j1: 0.01}}]\nfitted_to: [abc]")
    )
    assert edited(FILE, document, "arm.yaml") == expected


def test_keys_are_added_behind_those_that_precede_them() -> None:
    text = "name: arm   # as painted\njoints:\n- d: 1\n  a: 2\n# the end\n"
    document = {
        "robacc": 1,
        "name": "arm",
        "base": {"xyz": [0.5, 0.0, 0.0]},
        "joints": [{"d": 1, "beta": 0.5, "a": 2, "com": [1, 2]}, {"d": 3}],
        "zero": {"xyz": [0.0], "none": []},
    }
    assert edited(text, document, "arm.yaml") == (
        "robacc: 1\nname: arm   # as painted\nbase:\n  xyz: [0.5, 0.0, 0.0]\njoints:\n"
        "- d: 1\n  beta: 0.5\n  a: 2\n  com: [1, 2]\n- {d: 3}\n# the end\n"
    )


@pytest.mark.parametrize("empty", ["{}", "{ }", "{}   # nothing known"])
def test_several_keys_are_added_to_an_empty_mapping(empty: str) -> None:
    document = {"a": {"x": 1, "y": [2], "z": {"w": 3}}, "b": 4}
    text = edited(f"a: {empty}\nb: 4\n", document, "m.yaml")
    assert yaml.safe_load(text) == document
    assert text.startswith("a: {x: 1, y: [2], z: {w: 3}")
    assert ("# nothing known" in text) == ("#" in empty)


def test_a_part_that_is_another_is_written_anew() -> None:
    text = "a: 1\nfit:\n  old: 1\n  both: 2   # gone with the part\n# kept\nlast: {x: 1}\n"
    document = {"a": 1, "fit": {"both": 2, "new": [1, {"x": 3}]}, "last": {"y": 2}}
    kept = edited(text, document, "m.yaml", rewritten=("fit",))
    assert "old" not in kept
    assert "# kept\nlast: {y: 2, x: 1}\n" in kept
    assert yaml.safe_load(kept) == {**document, "last": {"x": 1, "y": 2}}


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_text_without_a_last_line_end_or_with_those_of_windows(ending: str) -> None:
    text = ending.join(("\ufeffa: 1  # first", "b: {}", "c:", "d:"))
    document = {"a": 2, "b": {"x": 1}, "c": None, "d": [1.5], "e": "new"}
    kept = edited(text, document, "m.yaml")
    assert yaml.safe_load(kept) == document
    assert "# first" in kept


NAMES = ("a", "b", "c", "no", "a long name", "ü", "#x", "1", "x: y")


def tree(random: Random, depth: int) -> Any:
    """Return a random value of a document: numbers, truth values, texts, and lists and mappings of them."""
    kind = random.choice("nnbt" if depth == 0 else "nbtllmmm")
    if kind == "n":
        return random.choice(
            (random.randint(1, 999), -random.randint(1, 99), float(f"{random.gauss(0, 300):.6g}") or 1.0)
        )
    if kind == "b":
        return random.random() < 0.5
    if kind == "t":
        return random.choice(NAMES)
    items = [tree(random, depth - 1) for _ in range(random.randint(1, 3))]
    return items if kind == "l" else dict(zip(random.sample(NAMES, len(items)), items, strict=True))


@pytest.mark.parametrize("style", [None, False, True])
def test_any_document_becomes_any_other(style: bool | None) -> None:
    for seed in range(25):
        random = Random(seed)
        old, new = ({name: tree(random, 2) for name in random.sample(NAMES, random.randint(1, 4))} for _ in range(2))
        # The parts that both have are often the same but for some numbers and additions, as in a model fitted again.
        for name in old.keys() & new.keys():
            if random.random() < 0.5:
                new[name] = changed(random, old[name])
        text = yaml.safe_dump(old, default_flow_style=style, allow_unicode=True, sort_keys=False)
        read = yaml.safe_load(edited(text, new, "any.yaml", rewritten=tuple(new)))
        assert read == {**old, **new}, (seed, text, new)


def changed(random: Random, value: Any) -> Any:
    """Return a value with other numbers and further items."""
    if isinstance(value, dict):
        return {**{key: changed(random, item) for key, item in value.items()}, "new": tree(random, 1)}
    if isinstance(value, list):
        return [changed(random, item) for item in value] + [tree(random, 1)] * random.randint(0, 1)
    return random.choice((value, 2.5)) if isinstance(value, float) else value
