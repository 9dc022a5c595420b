"""Normal, chi-square, Student, F, noncentral F and beta distributions in the standard library alone.

scipy has all of them, but `import scipy.special` takes longer than a complete estimate of 100 poses. An estimate needs
only these few, written here from :mod:`math`; the tests compare them with scipy.

Sources: NIST Digital Library of Mathematical Functions, 8.7.1 (series of the incomplete gamma function), 8.9.2 (its
continued fraction), 8.17.22 (continued fraction of the incomplete beta function), 5.11.1 (Stirling's series).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

_EPS = 1e-16
_TINY = 1e-300
_MAX_TERMS = 200_000
_STIRLING_FROM = 10.0
"""Argument from which Stirling's series of four terms is exact to 1e-14."""


def normal_cdf(x: float) -> float:
    """Return P(Z <= x) of a standard normal Z."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


@lru_cache(maxsize=256)
def normal_quantile(probability: float) -> float:
    """Return the x with P(Z <= x) = ``probability``, 0 < probability < 1."""
    if probability > 0.5:
        return -normal_quantile(1.0 - probability)
    # Newton on log P, which is concave: from the left of the root every step stays on that side and none overshoots.
    x = -math.sqrt(-2.0 * math.log(probability))
    for _ in range(100):
        value = normal_cdf(x)
        density = math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
        step = (math.log(value) - math.log(probability)) * value / density
        x -= step
        if abs(step) <= 1e-15 * max(1.0, abs(x)):
            break
    return x


def _stirling_remainder(a: float) -> float:
    """Return the remainder log Gamma(a) - ((a - 1/2) log a - a + log(2 pi)/2) for a >= 10."""
    inverse = 1.0 / a
    square = inverse * inverse
    return inverse * (1 / 12 - square * (1 / 360 - square * (1 / 1260 - square * (1 / 1680 - square / 1188))))


def _log_ratio(x: float) -> float:
    """Return log(1 + x) - x, without cancellation near zero."""
    if abs(x) > 0.1:
        return math.log1p(x) - x
    total, power = 0.0, -x
    for k in range(2, 40):
        power *= -x
        term = -power / k
        total += term
        if abs(term) <= _EPS * abs(total):
            break
    return total


def _log_gamma_weight(a: float, x: float) -> float:
    """Return log(x^a e^-x / Gamma(a)); for large a from x - a, because the plain formula loses digits."""
    if a < _STIRLING_FROM:
        return a * math.log(x) - x - math.lgamma(a)
    if x < 1e-3 * a:  # x / a - 1 would lose the digits of x
        return a * (math.log(x / a) + 1.0) - x + 0.5 * math.log(a / (2.0 * math.pi)) - _stirling_remainder(a)
    return a * _log_ratio((x - a) / a) + 0.5 * math.log(a / (2.0 * math.pi)) - _stirling_remainder(a)


def _lower_series(a: float, x: float) -> float:
    """Return P(a, x) by its power series, for x < a + 1."""
    term = total = 1.0 / a
    denominator = a
    for _ in range(_MAX_TERMS):
        denominator += 1.0
        term *= x / denominator
        total += term
        if term < _EPS * total:
            break
    return total * math.exp(_log_gamma_weight(a, x))


def _continued_fraction(first: float, terms: Callable[[int], tuple[float, float]]) -> float:
    """Return ``1 / (first + n_1 / (d_1 + n_2 / (d_2 + …)))`` with ``terms(i) = (n_i, d_i)``, by Lentz's algorithm."""
    d = 1.0 / (first if first != 0.0 else _TINY)
    c = 1.0 / _TINY
    value = d
    for i in range(1, _MAX_TERMS):
        numerator, denominator = terms(i)
        d = denominator + numerator * d
        c = denominator + numerator / c
        d = 1.0 / (d if d != 0.0 else _TINY)
        c = c if c != 0.0 else _TINY
        value *= c * d
        if abs(c * d - 1.0) < 2e-16:
            break
    return value


def _upper_fraction(a: float, x: float) -> float:
    """Return Q(a, x) by its continued fraction, for x >= a + 1."""
    fraction = _continued_fraction(x + 1.0 - a, lambda i: (-i * (i - a), x + 2.0 * i + 1.0 - a))
    return fraction * math.exp(_log_gamma_weight(a, x))


def chi2_cdf(x: float, dof: float) -> float:
    """Return P(chi-square with ``dof`` degrees of freedom <= x)."""
    if x <= 0.0:
        return 0.0
    a, half = 0.5 * dof, 0.5 * x
    return _lower_series(a, half) if half < a + 1.0 else 1.0 - _upper_fraction(a, half)


def chi2_sf(x: float, dof: float) -> float:
    """Return P(chi-square with ``dof`` degrees of freedom > x), exact far in the tail too."""
    if x <= 0.0:
        return 1.0
    a, half = 0.5 * dof, 0.5 * x
    return 1.0 - _lower_series(a, half) if half < a + 1.0 else _upper_fraction(a, half)


@lru_cache(maxsize=256)
def chi2_quantile(probability: float, dof: float) -> float:
    """Return the x with P(chi-square <= x) = ``probability``, 0 < probability < 1."""
    # Wilson and Hilferty's cube is within a few percent; it fails only far in the lower tail, where P ~ x^a.
    cube = 1.0 - 2.0 / (9.0 * dof) + normal_quantile(probability) * math.sqrt(2.0 / (9.0 * dof))
    a = 0.5 * dof
    small = 2.0 * math.exp((math.log(probability) + math.lgamma(a + 1.0)) / a)
    x = dof * cube**3 if cube > 0.2 else small
    for _ in range(100):
        log_density = _log_gamma_weight(a, 0.5 * x) - math.log(x)
        # The nearer tail keeps its digits.
        error = chi2_cdf(x, dof) - probability if probability < 0.5 else (1.0 - probability) - chi2_sf(x, dof)
        newton = error / math.exp(log_density)
        # Halley's step in x: the density's logarithmic slope is (a - 1)/x - 1/2.
        step = newton / max(0.5, 1.0 - 0.5 * newton * ((a - 1.0) / x - 0.5))
        x = x - step if step < x else 0.5 * x
        if abs(step) <= 1e-14 * x:
            break
    return x


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
    if x <= 0.0:
        return 0.0
    if y <= 0.0:
        return 1.0
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _beta_fraction(y, x, b, a)
    return _beta_fraction(x, y, a, b)


def _beta_fraction(x: float, y: float, a: float, b: float) -> float:
    """Return I_x(a, b) with y = 1 - x, for x below about the mean, where the continued fraction converges fast."""

    def term(i: int) -> tuple[float, float]:
        m = i // 2
        if i % 2 == 0:
            return m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)), 1.0
        return -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)), 1.0

    log_x = math.log(x) if x < 0.5 else math.log1p(-y)
    log_y = math.log(y) if y < 0.5 else math.log1p(-x)
    return math.exp(a * log_x + b * log_y - _log_beta(a, b)) / a * _continued_fraction(1.0, term)


def f_sf(x: float, dof1: float, dof2: float) -> float:
    """Return P(F with ``dof1``, ``dof2`` degrees of freedom > x)."""
    if x <= 0.0:
        return 1.0
    ratio = dof1 * x / dof2
    return beta_cdf(1.0 / (1.0 + ratio), 0.5 * dof2, 0.5 * dof1, complement=ratio / (1.0 + ratio))


@lru_cache(maxsize=256)
def student_quantile(probability: float, dof: float) -> float:
    """Return the t with P(Student's t with ``dof`` degrees of freedom <= t) = ``probability``."""
    if probability < 0.5:
        return -student_quantile(1.0 - probability, dof)
    tail = 2.0 * (1.0 - probability)
    if tail >= 1.0:
        return 0.0
    return math.sqrt(f_critical(tail, 1.0, dof))


# Noncentral F distribution: the probability that a test finds an effect of a given size.
#
# Source: N. L. Johnson, S. Kotz, N. Balakrishnan, Continuous Univariate Distributions, volume 2 (1995), chapter 30: a
# Poisson mixture of beta distributions; the recurrence of the incomplete beta function is NIST DLMF 8.17.20.

_LARGEST = 1e30
"""Largest noncentrality that is searched."""
_SUMMED = 2e4
"""Noncentrality up to which the mixture is summed. Beyond it the numerator varies by less than 1.5 %, which changes
probabilities by less than 3e-4: it counts as its mean."""


def noncentral_f_sf(x: float, dof1: float, dof2: float, noncentrality: float) -> float:
    """Return P(F > x) of the noncentral F distribution: the power of the F test with critical value ``x``.

    ``noncentrality`` is the whitened sum of squares of the effect, orthogonal to the other coefficients of the model.
    Every term is positive, so that small probabilities keep their digits too.
    """
    if x <= 0.0:
        return 1.0
    if noncentrality > _SUMMED:
        return 1.0 - chi2_sf(dof2 * (noncentrality + dof1) / (dof1 * x), dof2)
    half = 0.5 * noncentrality
    a, b = 0.5 * dof1, 0.5 * dof2
    log_y = -math.log1p(dof1 * x / dof2)
    log_x = math.log(dof1 * x / dof2) + log_y
    tail = f_sf(x, dof1, dof2)
    log_step = a * log_x + b * log_y + math.lgamma(a + b) - math.lgamma(a + 1.0) - math.lgamma(b)
    log_weight = -half
    total = math.exp(log_weight) * tail
    last = int(half + 12.0 * math.sqrt(half) + 40.0)
    for j in range(last if half > 0 else 0):
        # Each step of the mixture has two more degrees of freedom in the numerator.
        tail += math.exp(log_step)
        log_step += log_x + math.log((a + j + b) / (a + j + 1.0))
        log_weight += math.log(half / (j + 1.0))
        total += math.exp(log_weight) * min(tail, 1.0)
    return min(total, 1.0)


@lru_cache(maxsize=256)
def f_critical(tail: float, dof1: float, dof2: float) -> float:
    """Return the x with P(F > x) = ``tail``, 0 < ``tail`` < 1."""
    low, high = 0.0, 1.0
    while f_sf(high, dof1, dof2) > tail:
        low, high = high, 2.0 * high
    return _bisected(lambda x: f_sf(x, dof1, dof2) > tail, low, high)


@lru_cache(maxsize=256)
def needed_noncentrality(power: float, level: float, dof1: float, dof2: float) -> float:
    """Return the noncentrality at which the F test of ``level`` finds an effect with probability ``power``."""
    critical = f_critical(level, dof1, dof2)
    low, high = 0.0, 8.0
    while noncentral_f_sf(critical, dof1, dof2, high) < power and high < _LARGEST:
        low, high = high, 2.0 * high
    return _bisected(lambda x: noncentral_f_sf(critical, dof1, dof2, x) < power, low, high)


def _bisected(below: Callable[[float], bool], low: float, high: float) -> float:
    """Bisect, to the last digit, for the point between ``low`` and ``high`` from which ``below`` is false."""
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if below(middle) else (low, middle)
    return middle
