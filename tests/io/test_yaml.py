"""YAML that is edited, and the two readers of it."""

from collections.abc import Iterator
from random import Random
from typing import Any

import pytest
import yaml
from sample_files import ROOT

from robacc.errors import InputError
from robacc.io.yaml_nodes import compose, edited

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


SAMPLES = sorted((*ROOT.glob("sample_data/**/*.yaml"), *ROOT.glob("configs/**/*.yaml")))


def nodes(node: yaml.Node) -> Iterator[tuple[object, ...]]:
    """Yield what readers of a document use of each of its nodes."""
    marks = node.start_mark.index, node.start_mark.line, node.start_mark.column, node.end_mark.index
    if isinstance(node, yaml.ScalarNode):
        yield (*marks, node.tag, bool(node.style), node.value)
        return
    assert isinstance(node, yaml.CollectionNode)
    yield (*marks, node.tag, bool(node.flow_style))
    for item in node.value:
        for child in item if isinstance(item, tuple) else (item,):
            yield from nodes(child)


@pytest.fixture
def fast_reads(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Return a list that records for each document whether the faster reader read it."""
    record = []
    read = yaml.compose

    def recorded(text: str, Loader: type) -> yaml.Node | None:
        record.append(Loader is yaml.CSafeLoader)
        return read(text, Loader=Loader)

    monkeypatch.setattr(yaml, "compose", recorded)
    return record


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML was built without its faster reader")
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_both_readers_read_the_same(fast_reads: list[bool], monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    samples = [sample.read_text(encoding="utf-8") for sample in SAMPLES]
    texts = [f"{text}# Übermaß 🤖\nnotes: 'it''s \"so\"'\n".replace("\n", end) for text in samples]
    fast = [list(nodes(compose(text, "robot.yaml"))) for text in texts]
    count = sum(fast_reads)
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    assert fast == [list(nodes(compose(text, "robot.yaml"))) for text in texts]
    assert count == sum(fast_reads) > 0.8 * len(texts)
    assert max(map(len, fast)) > 50


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("j1:\t2", "indent with blanks, not with tabs"),
        ("a: &b 1", "anchors"),
        ("a: !!python/name:os.system x", "tags"),
        ("a: {b: 1, c: 2}}", "cannot be read as YAML"),
        (f"a: {'[' * 40}{']' * 40}", "nested deeper"),
        (f"a: [{'1, ' * 600}]", "more than 500 entries"),
    ],
)
def test_messages_do_not_depend_on_the_reader(
    fast_reads: list[bool], monkeypatch: pytest.MonkeyPatch, line: str, message: str
) -> None:
    monkeypatch.setattr("robacc.io.yaml_nodes.MAX_NODES", 500)
    with pytest.raises(InputError) as fast:
        compose(f"{line}\n", "robot.yaml")
    assert message in str(fast.value)
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    with pytest.raises(InputError) as slow:
        compose(f"{line}\n", "robot.yaml")
    assert str(fast.value) == str(slow.value)
    assert not any(fast_reads)
