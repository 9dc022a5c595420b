"""Decision on a largest error, which no sample bounds from above: by the share of all poses within the limit.

If a share s of all poses lies within the limit, all of n poses do so with probability s^n. If none of n poses is
beyond the limit, s is therefore at least (1 - c)^(1/n) with confidence c: Wilks' one-sided tolerance limit (S. S.
Wilks, "Determination of sample sizes for setting tolerance limits", Annals of Mathematical Statistics 12, 1941). One
pose beyond the limit shows that the largest error is beyond it.
"""

from __future__ import annotations

import math

from robacc.gates.criteria import GateCriterion
from robacc.gates.decision_rules import Decision, Outcome

_STEPS = 20


def decide_largest(criterion: GateCriterion, value: float, n: int) -> Decision:
    """Decide on the largest error of ``n`` poses against an upper limit."""
    limit = criterion.limit if criterion.limit is not None else math.nan
    share, confidence = criterion.share, criterion.confidence
    n_needed = math.ceil(math.log(1.0 - confidence) / math.log(share))
    margin = limit - value
    claim = f"that {100 * share:g} % of all poses are within the limit"
    method = f"confidence {claim} (Wilks)"
    curve = tuple((1.0 - k * 0.01, (1.0 - k * 0.01) ** n if n >= n_needed else 0.0) for k in range(_STEPS + 1))
    if value > limit:
        # The rules differ in their demands on poses that were not measured; one pose beyond the limit decides.
        return Decision("fail", lower_bound=value, margin=margin, probability=0.0, method=method, operating_curve=curve)
    probability = 1.0 - share**n
    outcome: Outcome = "pass"
    why = n_to_decide = None
    if n < n_needed and criterion.rule != "guarded_rejection":
        outcome = "fail" if criterion.rule == "guard_band" else "inconclusive"
        why = f"{n} poses within the limit show {claim} with a confidence of only {100 * probability:.3g} %"
        n_to_decide = n_needed if outcome == "inconclusive" else None
    return Decision(
        outcome,
        why,
        value,
        margin=margin,
        probability=probability,
        method=method,
        poses_to_decide=n_to_decide,
        poses_if_true=n_to_decide,
        operating_curve=curve,
    )
