"""Levels, shares, sizes and bounds that fits, traces and checks of data have in common, each with its source."""

import numpy as np

# Evidence and probability: R. E. Kass and A. E. Raftery, "Bayes factors", JASA 90 (1995), section 3.2.

ACCEPTED = 3.0
"""Log odds beyond which an effect or a term is accepted: 20 to 1, "strong"."""
DECISIVE = 5.0
"""Log odds beyond which a cause is named in words, or a statement of the robot file is overruled: 150 to 1, "very
strong"."""
SIGNIFICANT = 1e-3
"""Probability by chance below which a pattern is none: the same odds, over some ten patterns."""

NORMAL_95 = 1.96
"""Standard errors that a normal variable is within, with a probability of 95 %."""

# Shares.

NEGLIGIBLE = 0.1
"""Ratio of two standard deviations below which the smaller is negligible: it changes the variance by 1 %."""
FEW = 0.05
"""Share of the rows that accidents of an instrument, mistakes in single rows or names may be at most."""

GROSS = 0.01
"""Median registered error, as a share of the standard deviation of the positions (or in rad), above which it may come
from a mistake. An arm as it is built stays below."""

LARGEST = 10.0
"""Largest size of what an effect can be, over its usual size: what poses leave open, the prior decides."""

# Sizes that arms and instruments have (Mooring, Roth and Driels 1991; data sheets of trackers).

EPSILON = float(np.finfo(float).eps)
"""Rounding of a number, as a share."""
NEW = 1e-6
"""Share of a square below which what others leave of it is rounding: they have it already."""
DEPENDENT = 3e-5
"""A column with an independent part below this share of its length is dependent; a column below this share of the
longest of its unit carries no information. Model and rounding reach 1e-12; registering a target on the last axis from
noisy poses makes up levers of some micrometres, 1e-5 of an arm's reach; the weakest combinations of measured arms lie
above 1e-4."""
HALF_DIGITS = EPSILON**0.5
"""Relative difference that a sum of squares does not show."""
ROUNDING = 1e-9
"""m or rad: below any instrument, above the rounding of a prediction."""
RESOLUTION = 1e-7
"""m or rad: below the resolution of any instrument; no noise is smaller."""

# Numbers of rows and names.

ENOUGH = 10
"""Poses, or degrees of freedom, from which an error is known within a quarter (1 / sqrt(2 n)), and from which
registration of base and target, of nine coefficients, does not hide a mistake or an outlier."""
BEST = 8
"""Best of a rough order that are looked at again."""
ALIKE = 1.5
"""Ratio of two errors up to which they are alike: as much as few poses leave by chance (root 2)."""
EXAMPLES = 4
"""Long texts that a message lists at most."""

# Numbers that bound time and memory alone: results are the same with larger ones, or those of a fair part of the rows.

STEPS = 100
"""Steps of an iteration, which all end by themselves before."""
SETTLED = 1e-3
"""Change, as a share of a standard deviation or of a sum of squares, at which an iteration ends."""
ROUNDS = 6
"""Rounds of weights, each from the errors of the one before; each changes less than a tenth of the one before."""
SHORTLIST = 60
"""Candidates, or hypotheses, that a rough order selects; and rows by which it judges them."""
SAMPLE = 400
"""Rows of a sample on which something is registered, tried or drawn."""
MANY = 20_000
"""Rows from which a random part decides as well as all."""
BLOCK_NUMBERS = 2**21
"""Numbers of which copies are made at a time; of more, blocks stay in the cache."""
