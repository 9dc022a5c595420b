"""Assumptions that intervals of errors may rely on, and whether the data contradict them."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.statistics.intervals import PoseSampling
from robacc.statistics.multivariate import AssumptionTests

SIGNIFICANCE = 0.01
"""Significance level: an assumption with a smaller p-value is rejected."""


@dataclass(frozen=True, slots=True)
class Assumption:
    """Assumptions that intervals may rely on."""

    shape: bool
    """The errors of the commanded poses look Gaussian."""
    zero_mean: bool
    independent: bool
    """No commanded pose was repeated."""
    text: str
    """Assumptions and rejections as a sentence."""


def interval_assumption(tests: AssumptionTests, sampling: PoseSampling) -> Assumption:
    """Return the assumptions that the tests do not reject; the text names those that could not be tested."""
    shape_p_values = [test.p_value for test in (tests.skewness, tests.kurtosis)]
    shape = all(p is None or p >= SIGNIFICANCE for p in shape_p_values)
    zero_mean_p = tests.zero_mean.p_value
    # Errors without scatter along their mean have no p-value, but such a mean is not due to chance.
    constant = zero_mean_p is None and sampling.n_groups > 3
    zero_mean = not constant if zero_mean_p is None else zero_mean_p >= SIGNIFICANCE
    rejections = []
    if not shape:
        rejections.append("the errors are not Gaussian (Mardia)")
    if not zero_mean:
        rejections.append("their mean is not zero (Hotelling)")
    independent = sampling.groups is None
    if not independent:
        rejections.append("commanded poses were repeated, and repetitions are not independent")
    untested = zero_mean_p is None or None in shape_p_values
    level = f"{100 * SIGNIFICANCE:g} %"
    if rejections:
        text = f"{'; '.join(rejections)}: intervals come from resampling, not from a Gaussian model"
    elif untested:
        text = "errors assumed Gaussian with zero mean; the poses are too few to test it"
    else:
        text = f"errors assumed Gaussian with zero mean; no test rejects it at {level}"
    return Assumption(shape, zero_mean, independent, text)
