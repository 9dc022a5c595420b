"""The decision on a largest error, which no sample bounds from above: by the share of all poses within the limit.

If a share s of all poses lay within the limit, n poses would all do so with probability s^n. With none of n beyond
it, s is therefore at least (1 - c)^(1/n) with confidence c: Wilks' one-sided tolerance limit (S. S. Wilks,
"Determination of sample sizes for setting tolerance limits", Annals of Mathematical Statistics 12, 1941). One pose
beyond the limit shows that the largest error is.
"""

from __future__ import annotations

import math

from robacc.gates.criteria import GateCriterion
from robacc.gates.decision_rules import Decision, Outcome

_STEPS = 20


def decide_largest(criterion: GateCriterion, value: float, n: int) -> Decision:
    """Decide on the largest error of ``n`` poses, for a limit that it must not exceed."""
    limit = criterion.limit if criterion.limit is not None else math.nan
    share, confidence = criterion.share, criterion.confidence
    needed = math.ceil(math.log(1.0 - confidence) / math.log(share))
    margin = limit - value
    shown = f"that {100 * share:g} % of all poses are within the limit"
    method = f"confidence {shown} (Wilks)"
    curve = tuple((1.0 - k * 0.01, (1.0 - k * 0.01) ** n if n >= needed else 0.0) for k in range(_STEPS + 1))
    if value > limit:
        # The rules differ in what they ask of the poses that were not measured; one beyond the limit settles it.
        return Decision("fail", lower_bound=value, margin=margin, probability=0.0, method=method, operating_curve=curve)
    probability = 1.0 - share**n
    outcome: Outcome = "pass"
    why = more = None
    if n < needed and criterion.rule != "guarded_rejection":
        outcome = "fail" if criterion.rule == "guard_band" else "inconclusive"
        why = f"{n} poses within the limit show {shown} with a confidence of {100 * probability:.3g} %"
        more = needed if outcome == "inconclusive" else None
    return Decision(
        outcome,
        why,
        value,
        margin=margin,
        probability=probability,
        method=method,
        poses_to_decide=more,
        poses_if_true=more,
        operating_curve=curve,
    )
