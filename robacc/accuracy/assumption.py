"""What intervals of errors may rely on, and whether the data contradict it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from robacc.statistics.intervals import PoseSampling
from robacc.statistics.multivariate import AssumptionTests

SIGNIFICANCE = 0.01
"""Below this p-value an assumption is not relied on."""


@dataclass(frozen=True, slots=True)
class Assumption:
    """What intervals may rely on."""

    shape: bool
    """The commanded poses' errors look Gaussian."""
    zero_mean: bool
    independent: bool
    """No commanded pose was repeated."""
    text: str
    """The same in words."""


def with_imposed_mean(tests: AssumptionTests) -> AssumptionTests:
    """The tests of errors whose mean a fit to them took out; a mean that outliers kept from zero is still told."""
    found = tests.zero_mean
    if found.p_value is None or found.p_value < SIGNIFICANCE:
        return tests
    why = "the alignment made it so"
    return replace(tests, zero_mean=replace(found, statistic=None, p_value=None, why=why, imposed=True))


def assumption_of(tests: AssumptionTests, sampling: PoseSampling) -> Assumption:
    """What the tests leave standing; a test that could not be made leaves its assumption, and the text says so."""
    of_shape = [test.p_value for test in (tests.skewness, tests.kurtosis)]
    shape = all(p is None or p >= SIGNIFICANCE for p in of_shape)
    zero_mean_p = tests.zero_mean.p_value
    imposed = tests.zero_mean.imposed
    # Errors that do not scatter along their mean have no p-value, but that mean is no accident.
    constant = zero_mean_p is None and sampling.n_groups > 3 and not imposed
    zero_mean = not constant if zero_mean_p is None else zero_mean_p >= SIGNIFICANCE
    against = []
    if not shape:
        against.append("the errors are not Gaussian (Mardia)")
    if not zero_mean:
        against.append("their mean is not zero (Hotelling)")
    independent = sampling.groups is None
    if not independent:
        against.append("commanded poses were repeated, and their repetitions are not independent")
    untested = (zero_mean_p is None and not imposed) or None in of_shape
    if against:
        text = f"{'; '.join(against)}: intervals that equation (13)'s model would give are replaced by resampling"
    elif untested:
        text = "errors taken as Gaussian with zero mean, which so few poses cannot test"
    elif imposed:
        text = (
            f"errors taken as Gaussian, which no test contradicts at {100 * SIGNIFICANCE:g} %, with zero mean, which "
            "the alignment gave them"
        )
    else:
        text = f"errors taken as Gaussian with zero mean, which no test contradicts at {100 * SIGNIFICANCE:g} %"
    return Assumption(shape, zero_mean, independent, text)
