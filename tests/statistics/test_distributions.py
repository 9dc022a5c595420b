"""The standard library's distributions, noncentral F included, against scipy's."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from robacc.statistics import distributions as own
from robacc.statistics.distributions import f_critical, needed_noncentrality, noncentral_f_sf

PROBABILITIES = (1e-6, 0.001, 0.025, 0.05, 0.3, 0.5, 0.7, 0.95, 0.975, 0.999)


DEGREES = (1, 2, 3, 4.5, 10, 30, 57.3, 100, 999, 5e3, 1e5)


@pytest.mark.parametrize("p", [1e-12, *PROBABILITIES])
def test_normal(p: float) -> None:
    x = stats.norm.ppf(p)
    assert own.normal_quantile(p) == pytest.approx(x, rel=1e-12, abs=1e-14)
    assert own.normal_cdf(x) == pytest.approx(p, rel=1e-12)


@pytest.mark.parametrize("dof", DEGREES)
def test_chi_square(dof: float) -> None:
    for p in PROBABILITIES:
        x = stats.chi2.ppf(p, dof)
        assert own.chi2_quantile(p, dof) == pytest.approx(x, rel=1e-10)
        assert own.chi2_cdf(x, dof) == pytest.approx(stats.chi2.cdf(x, dof), rel=1e-10)
        assert own.chi2_sf(x, dof) == pytest.approx(stats.chi2.sf(x, dof), rel=1e-10)


def test_chi_square_of_millions_of_degrees_of_freedom() -> None:
    for p in (0.001, 0.025, 0.5, 0.975, 0.999):
        assert own.chi2_quantile(p, 3e6) == pytest.approx(stats.chi2.ppf(p, 3e6), rel=1e-12)
    # By the power series in 40 decimal digits. scipy 1.17 says 1.00000000e-06 here, and is 8e-5 off.
    assert own.chi2_cdf(2988370.9707552614, 3e6) == pytest.approx(1.000084083408535e-06, rel=1e-8)


@pytest.mark.parametrize("dof", [1, 3, 10, 100])
def test_chi_square_far_tail_keeps_its_digits(dof: float) -> None:
    x = 5 * dof + 50
    assert own.chi2_sf(x, dof) == pytest.approx(stats.chi2.sf(x, dof), rel=1e-10)


def test_chi_square_and_f_of_nothing() -> None:
    assert (own.chi2_cdf(0.0, 3), own.chi2_sf(0.0, 3), own.f_sf(0.0, 3, 5)) == (0.0, 1.0, 1.0)


@pytest.mark.parametrize("dof2", [1, 2, 5, 27, 97, 1000, 1e5, 1e6])
@pytest.mark.parametrize("dof1", [1, 2, 3])
def test_f(dof1: float, dof2: float) -> None:
    for x in (0.01, 0.5, 1.0, 2.7, 10.0, 100.0):
        expected = stats.f.sf(x, dof1, dof2)
        # Below 1e-100 the exponent itself, of some hundreds, has lost the digits.
        assert own.f_sf(x, dof1, dof2) == pytest.approx(expected, rel=1e-10, abs=1e-100)


@pytest.mark.parametrize("n", [10, 59, 72, 500, 5000])
def test_beta(n: int) -> None:
    for k in (0.5 * n, 0.9 * n, 0.95 * n, 0.97 * n, n):
        for x in (0.5, 0.9, 0.95, 0.99):
            assert own.beta_cdf(x, k, n + 1 - k) == pytest.approx(stats.beta.cdf(x, k, n + 1 - k), abs=1e-10)
    assert own.beta_cdf(0.0, 2.0, 3.0) == 0.0
    assert own.beta_cdf(1.0, 2.0, 3.0) == 1.0


@pytest.mark.parametrize("dof", [1, 2, 3, 10, 57.3, 99, 1e4, 1e6])
def test_student(dof: float) -> None:
    for p in (0.025, 0.05, 0.5, 0.6, 0.95, 0.975, 0.9999):
        assert own.student_quantile(p, dof) == pytest.approx(stats.t.ppf(p, dof), rel=1e-10, abs=1e-12)


def test_statistics_load_nothing_heavy() -> None:
    """The reason for these functions: an estimate imports neither scipy, the YAML reader nor numpy.ma."""
    program = (
        "import sys, numpy as np\n"
        "from robacc.accuracy.error_statistics import error_statistics\n"
        "error_statistics(np.random.default_rng(0).normal(size=(3, 40)), 'm')\n"
        "sys.exit(any(name in sys.modules for name in ('scipy', 'yaml', 'numpy.ma')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


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
