"""The noncentral F distribution against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from robacc.statistics.distributions import f_critical, needed_noncentrality, noncentral_f_sf


@pytest.mark.parametrize("dof1", [1.0, 2.0, 6.0, 20.0])
@pytest.mark.parametrize("dof2", [4.0, 61.5, 900.0])
@pytest.mark.parametrize("noncentrality", [0.0, 0.3, 20.0, 300.0])
def test_the_upper_tail_is_scipys(dof1: float, dof2: float, noncentrality: float) -> None:
    for x in (0.0, 0.5, 3.0, 17.0, 60.0):
        expected = stats.ncf.sf(x, dof1, dof2, noncentrality) if noncentrality else stats.f.sf(x, dof1, dof2)
        # scipy's own tail has an absolute error of about 1e-13.
        assert noncentral_f_sf(x, dof1, dof2, noncentrality) == pytest.approx(expected, rel=1e-9, abs=1e-11)


def test_a_large_noncentrality_neither_overflows_nor_vanishes() -> None:
    # F is then nearly normal about (dof1 + noncentrality) / dof1; Poisson weights begin at exp(-2500).
    assert noncentral_f_sf(2501.0, 2.0, 1e6, 5000.0) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("tail", [0.5, 0.01, 2.5e-5, 1e-9])
def test_the_critical_value_is_scipys(tail: float) -> None:
    assert f_critical(tail, 2.0, 300.0) == pytest.approx(stats.f.isf(tail, 2.0, 300.0), rel=1e-8)


@pytest.mark.parametrize("power", [0.1, 0.5, 0.99])
def test_the_needed_noncentrality_gives_the_power(power: float) -> None:
    level, dof1, dof2 = 2.5e-5, 2.0, 300.0
    needed = needed_noncentrality(power, level, dof1, dof2)
    assert stats.ncf.sf(stats.f.isf(level, dof1, dof2), dof1, dof2, needed) == pytest.approx(power, abs=1e-7)


@pytest.mark.parametrize("dof2", [1.0, 2.0, 8.0, 100.0])
def test_beyond_the_summed_mixture_the_tail_is_that_of_draws(dof2: float) -> None:
    noncentrality = 3e4
    generator = np.random.default_rng(1)
    numerator = generator.noncentral_chisquare(2.0, noncentrality, 400_000) / 2.0
    ratios = numerator / (generator.chisquare(dof2, 400_000) / dof2)
    for x in np.quantile(ratios, (0.1, 0.5, 0.9)):
        share = float(np.mean(ratios > x))
        assert noncentral_f_sf(float(x), 2.0, dof2, noncentrality) == pytest.approx(share, abs=0.003)


def test_few_degrees_of_freedom_need_no_long_sum() -> None:
    """With one or two left, a small level needs noncentralities of 1e10: summed, this took hours."""
    for dof2 in (1.0, 2.0):
        needed = needed_noncentrality(0.5, 1e-8, 1.0, dof2)
        critical = f_critical(1e-8, 1.0, dof2)
        assert noncentral_f_sf(critical, 1.0, dof2, needed) == pytest.approx(0.5, abs=1e-6)
