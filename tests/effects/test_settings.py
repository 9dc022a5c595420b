"""Settings of an effect of one's own: what its fields declare is read, checked, converted and written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pytest
from arms import arm

from robacc.effects.base import Effect, Term, setting
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


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


def test_numbers_follow_the_units_of_the_file() -> None:
    effect = _Toy((), 2.0, (1.0, 2.0)).from_units(arm("puma560"), 1e-3, 0.5)
    assert effect == _Toy((), 2.0 * 1e-3, (0.5, 1.0))


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
