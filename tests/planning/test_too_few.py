"""A plan of fewer measured coordinates than coefficients says so."""

from __future__ import annotations

import pytest
from arms import arm

from robacc.planning.campaign import CampaignSettings, too_few_warning
from robacc.planning.planner import plan_campaign


@pytest.mark.parametrize(
    ("n_poses", "n_known", "components", "enough"), [(3, 0, 3, 9), (4, 2, 3, 7), (4, 0, 6, 5), (1, 0, 3, 9)]
)
def test_the_number_that_is_enough_is_the_least_that_gives_no_warning(
    n_poses: int, n_known: int, components: int, enough: int
) -> None:
    (text,) = too_few_warning(n_poses, n_known, components, 27)
    assert f"plan at least {enough} poses" in text
    assert too_few_warning(enough, n_known, components, 27) == ()
    assert too_few_warning(enough - 1, n_known, components, 27)


@pytest.mark.parametrize(("poses", "warned"), [(3, True), (20, False)])
def test_a_plan_of_three_poses_is_warned_of(poses: int, warned: bool) -> None:
    settings = CampaignSettings("calibrate", poses=poses, n_candidates=200)
    plan = plan_campaign(arm("puma560").robot, settings)
    assert any("fewer than the" in text for text in plan.warnings) == warned
