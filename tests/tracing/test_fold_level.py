"""Folds have fewer poses than the search, and confirm what it finds at a level that allows for that."""

from __future__ import annotations

from typing import Any

import pytest
from scipy import optimize, stats
from test_search_consistency import measured

from robacc.fitting.cross_validation import HoldOut
from robacc.tracing import cross_validation
from robacc.tracing.candidates import TYPICAL_CANDIDATES
from robacc.tracing.loop import search
from robacc.tracing.selection import FALSE_ALARM, Selection, fold_level


@pytest.mark.parametrize("share", [0.75, 0.8, 0.9, 0.95])
def test_an_effect_found_at_even_odds_recurs_at_even_odds(share: float) -> None:
    def power(level: float, noncentrality: float) -> float:
        return float(stats.ncx2.sf(stats.chi2.isf(level / TYPICAL_CANDIDATES, 1), 1, noncentrality))

    just_found = optimize.brentq(lambda size: power(FALSE_ALARM, size) - 0.5, 1.0, 100.0)
    assert power(fold_level(share), share * just_found) == pytest.approx(0.5, abs=1e-3)
    # At the level of the search a fold would miss it more often: with five folds, in two of three cases.
    assert power(FALSE_ALARM, share * just_found) < 0.46


def test_a_fold_of_few_poses_has_a_level_all_the_same() -> None:
    assert fold_level(0.5) == 0.05
    assert fold_level(1.0) == pytest.approx(FALSE_ALARM, rel=1e-9)


def test_each_fold_chooses_at_its_level(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = []

    def spy(*arguments: Any, **options: Any) -> Selection:
        chosen = choose(*arguments, **options)
        levels.append(chosen.level)
        return chosen

    choose = cross_validation.choose
    monkeypatch.setattr(cross_validation, "choose", spy)
    model, data = measured("gear_ratio[j2]", 5)
    result = search(model, data, empirical=False)
    choices = cross_validation.fold_choices(result, data, HoldOut(), False, lambda *_: None)
    assert choices is not None
    assert levels == [pytest.approx(fold_level(0.8))] * 5
