"""Normal, chi-square, Student, F, noncentral F and beta distributions in the standard library alone.

scipy has all of them, but `import scipy.special` takes longer than a complete estimate of 100 poses. An estimate needs
only these few, written here from :mod:`math`; the tests compare them with scipy.

Sources: NIST Digital Library of Mathematical Functions, 8.9.1 and 8.9.2 (continued fractions of the incomplete gamma
functions), 8.17.22 (continued fraction of the incomplete beta function), 5.11.1 (Stirling's series).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from statistics import NormalDist

_TINY = 1e-300
_STIRLING_FROM = 10.0
"""Argument from which Stirling's series of four terms is exact to 1e-14."""


def root(function: Callable[[float], float], low: float, high: float, tolerance: float = 1e-15) -> float:
    """Return the zero of a function whose signs at ``low`` and ``high`` differ, to the relative ``tolerance``.

    Inverse quadratic interpolation where it is safe, else bisection: T. R. Chandrupatla, "A new hybrid
    quadratic/bisection algorithm for finding the zero of a nonlinear function", Advances in Engineering Software 28
    (1997).
    """
    b, a, f_b, f_a = low, high, function(low), function(high)
    c, f_c, share = b, f_b, 0.5
    while True:
        best, f_best = (a, f_a) if abs(f_a) < abs(f_b) else (b, f_b)
        smallest = (tolerance * abs(best) + _TINY) / abs(b - a) if a != b else 1.0
        if smallest > 0.5 or f_best == 0.0:
            return best
        x = a + min(max(share, smallest), 1.0 - smallest) * (b - a)
        f_x = function(x)
        if (f_x > 0.0) == (f_a > 0.0):
            c, f_c = a, f_a
        else:
            c, f_c, b, f_b = b, f_b, a, f_a
        a, f_a, share = x, f_x, 0.5
        ratio, height = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        if height**2 < ratio and (1.0 - height) ** 2 < 1.0 - ratio:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)


def _root_above(function: Callable[[float], float], high: float) -> float:
    """Return the zero of a function that is negative at 0 and rises; ``high`` is tried first as the upper end."""
    low = 0.0
    while high < _LARGEST and function(high) < 0.0:
        low, high = high, 2.0 * high
    return root(function, low, high)


def normal_cdf(x: float) -> float:
    """Return P(Z <= x) of a standard normal Z."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


def normal_quantile(probability: float) -> float:
    """Return the x with P(Z <= x) = ``probability``, 0 < probability < 1."""
    return NormalDist().inv_cdf(probability)


def _stirling_remainder(a: float) -> float:
    """Return the remainder log Gamma(a) - ((a - 1/2) log a - a + log(2 pi)/2) for a >= 10."""
    square = 1.0 / (a * a)
    return (1 / 12 - square * (1 / 360 - square * (1 / 1260 - square * (1 / 1680 - square / 1188)))) / a


def _log_gamma_weight(a: float, x: float) -> float:
    """Return log(x^a e^-x / Gamma(a)); for large a from x - a, because the plain formula loses digits."""
    if a < _STIRLING_FROM:
        return a * math.log(x) - x - math.lgamma(a)
    excess = (x - a) / a
    fall = math.log(x / a) - excess
    if abs(excess) <= 0.1:  # log(1 + x) - x without cancellation near zero
        fall = math.fsum(-((-excess) ** k) / k for k in range(2, 18))
    return a * fall + 0.5 * math.log(a / (2.0 * math.pi)) - _stirling_remainder(a)


def _continued_fraction(first: float, terms: Callable[[int], tuple[float, float]]) -> float:
    """Return ``1 / (first + n_1 / (d_1 + n_2 / (d_2 + …)))`` with ``terms(i) = (n_i, d_i)``, by Lentz's algorithm."""
    d = value = 1.0 / (first or _TINY)
    c = 1.0 / _TINY
    for i in range(1, 200_000):
        numerator, denominator = terms(i)
        d = 1.0 / (denominator + numerator * d or _TINY)
        c = denominator + numerator / c or _TINY
        value *= c * d
        if abs(c * d - 1.0) < 2e-16:
            break
    return value


def _chi2_tail(x: float, dof: float, upper: bool) -> float:
    """Return P(chi-square > x) if ``upper``, else P(chi-square <= x); small probabilities keep their digits."""
    a, half = 0.5 * dof, 0.5 * x
    if half <= 0.0:
        return float(upper)
    is_lower = half < a + 1.0

    def term(i: int) -> tuple[float, float]:
        if is_lower:
            return (-(a + i // 2) if i % 2 else i // 2) * half, a + i
        return -i * (i - a), half + 2.0 * i + 1.0 - a

    fraction = _continued_fraction(a if is_lower else half + 1.0 - a, term)
    tail = fraction * math.exp(_log_gamma_weight(a, half))
    return 1.0 - tail if upper == is_lower else tail


def chi2_cdf(x: float, dof: float) -> float:
    """Return P(chi-square with ``dof`` degrees of freedom <= x)."""
    return _chi2_tail(x, dof, upper=False)


def chi2_sf(x: float, dof: float) -> float:
    """Return P(chi-square with ``dof`` degrees of freedom > x), exact far in the tail too."""
    return _chi2_tail(x, dof, upper=True)


@lru_cache(maxsize=256)
def chi2_quantile(probability: float, dof: float) -> float:
    """Return the x with P(chi-square <= x) = ``probability``, 0 < probability < 1."""
    if probability < 0.5:  # the nearer tail keeps its digits
        return _root_above(lambda x: chi2_cdf(x, dof) - probability, dof)
    return _root_above(lambda x: 1.0 - probability - chi2_sf(x, dof), dof)


def _log_beta(a: float, b: float) -> float:
    """Return log B(a, b)."""
    a, b = max(a, b), min(a, b)
    if a < _STIRLING_FROM:
        return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    # log Gamma(a) - log Gamma(a + b) from the difference of the Stirling forms.
    difference = b - (a - 0.5) * math.log1p(b / a) - b * math.log(a + b)
    return math.lgamma(b) + difference + _stirling_remainder(a) - _stirling_remainder(a + b)


def beta_cdf(x: float, a: float, b: float, *, complement: float | None = None) -> float:
    """Return P(Beta(a, b) <= x), the regularised incomplete beta function; ``complement`` is a more exact 1 - x."""
    y = 1.0 - x if complement is None else complement
    if x <= 0.0 or y <= 0.0:
        return float(x > 0.0)
    if x > (a + 1.0) / (a + b + 2.0):  # the continued fraction converges fast below about the mean
        return 1.0 - beta_cdf(y, b, a, complement=x)

    def term(i: int) -> tuple[float, float]:
        m = i // 2
        numerator = m * (b - m) if i % 2 == 0 else -(a + m) * (a + b + m)
        return numerator * x / ((a + i - 1) * (a + i)), 1.0

    log_x = math.log(x) if x < 0.5 else math.log1p(-y)
    log_y = math.log(y) if y < 0.5 else math.log1p(-x)
    return math.exp(a * log_x + b * log_y - _log_beta(a, b)) / a * _continued_fraction(1.0, term)


def f_sf(x: float, dof1: float, dof2: float) -> float:
    """Return P(F with ``dof1``, ``dof2`` degrees of freedom > x)."""
    ratio = max(dof1 * x / dof2, 0.0)
    return beta_cdf(1.0 / (1.0 + ratio), 0.5 * dof2, 0.5 * dof1, complement=ratio / (1.0 + ratio))


@lru_cache(maxsize=256)
def student_quantile(probability: float, dof: float) -> float:
    """Return the t with P(Student's t with ``dof`` degrees of freedom <= t) = ``probability``; infinite: normal."""
    if math.isinf(dof) or probability == 0.5:
        return normal_quantile(probability)
    size = math.sqrt(f_critical(2.0 * min(probability, 1.0 - probability), 1.0, dof))
    return math.copysign(size, probability - 0.5)


_LARGEST = 1e60
"""Largest value that is searched."""
_EXACT = 2e4
"""Noncentrality up to which SciPy is exact. Beyond it the numerator varies by less than 1.5 %, which changes
probabilities by less than 3e-4: it counts as its mean."""


@lru_cache(maxsize=256)
def f_critical(tail: float, dof1: float, dof2: float) -> float:
    """Return the x with P(F > x) = ``tail``, 0 < ``tail`` < 1."""
    return _root_above(lambda x: tail - f_sf(x, dof1, dof2), 1.0)


def noncentral_f_sf(x: float, dof1: float, dof2: float, noncentrality: float) -> float:
    """Return P(F > x) of the noncentral F distribution: the power of the F test with critical value ``x``.

    ``noncentrality`` is the whitened sum of squares of the effect, orthogonal to the other coefficients of the model.
    """
    if noncentrality > _EXACT:
        return 1.0 - chi2_sf(dof2 * (noncentrality + dof1) / (dof1 * x), dof2)
    from scipy.special import ncfdtr

    return float(1.0 - ncfdtr(dof1, dof2, noncentrality, x))


@lru_cache(maxsize=256)
def needed_noncentrality(power: float, level: float, dof1: float, dof2: float) -> float:
    """Return the noncentrality at which the F test of ``level`` finds an effect with probability ``power``."""
    critical = f_critical(level, dof1, dof2)
    return _root_above(lambda size: noncentral_f_sf(critical, dof1, dof2, size) - power, 8.0)
