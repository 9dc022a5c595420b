"""PyYAML's reader in C and the one in Python: the same nodes at the same places, the same messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from robacc.errors import InputError
from robacc.io.yaml_nodes import compose

ROOT = Path(__file__).resolve().parents[2]
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
        (f"a: [{'1, ' * 60_000}]", "more than 50000 entries"),
    ],
)
def test_messages_do_not_depend_on_the_reader(
    fast_reads: list[bool], monkeypatch: pytest.MonkeyPatch, line: str, message: str
) -> None:
    with pytest.raises(InputError) as fast:
        compose(f"{line}\n", "robot.yaml")
    assert message in str(fast.value)
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    with pytest.raises(InputError) as slow:
        compose(f"{line}\n", "robot.yaml")
    assert str(fast.value) == str(slow.value)
    assert not any(fast_reads)
