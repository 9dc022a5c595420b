"""What a verdict presumes of noise and repeatability, and how the table states them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robacc.documents.fit import NOISE, REPEATABILITY
from robacc.error_model.structure import Repeatability
from robacc.fitting.warnings import LackOfFit
from robacc.modelling.model import Noise
from robacc.render.views.fit import _remaining_error, _residual
from robacc.tracing.trace import assumption_of, is_hidden_noise

ESTIMATED = LackOfFit(Noise(2e-5, None, "residual"), None, 1.0)
TINY = LackOfFit(Noise(4e-8, None, "residual"), None, 1.0)
KNOWN = LackOfFit(Noise(2e-5, None, "file"), 0.3, 1.0)
SCATTER = Repeatability((("j1", 3e-5),), 8.6e-5, "residual", 0.0)


def test_the_verdict_presumes_what_the_residual_alone_tells() -> None:
    noise_alone = assumption_of("explained", ESTIMATED, None)
    assert noise_alone.startswith("explained if the measurement noise is 0.02 mm along each axis")
    both = assumption_of("explained", ESTIMATED, SCATTER)
    assert both is not None
    assert "the arm's own repeatability is 0.086 mm rms at the target and the measurement noise is 0.02 mm" in both
    assert assumption_of("explained", KNOWN, None) is None
    assert assumption_of("partly_explained", ESTIMATED, SCATTER) is None


def test_noise_that_the_scatter_of_the_joints_hides_gets_no_number() -> None:
    """Of 50 poses of an arm, measured once each, the joints' scatter took all but 65 nm of the residual."""
    assert is_hidden_noise(TINY, SCATTER)
    assert not is_hidden_noise(ESTIMATED, SCATTER)
    assert not is_hidden_noise(TINY, None)
    assert not is_hidden_noise(TINY, replace(SCATTER, source="repeated visits"))
    size = "the arm's own repeatability is 0.086 mm rms at the target"
    assert assumption_of("explained", TINY, SCATTER) == f"explained if {size}; repeated poses would test this"


def test_noise_that_file_or_repeats_tell_is_not_presumed() -> None:
    """Noise estimated beside scatter has no test, yet sigma columns or repeated visits tell it."""
    for source in ("file", "repeats"):
        known = LackOfFit(Noise(2e-5, None, source), None, 1.0)
        assert assumption_of("explained", known, replace(SCATTER, source="repeated visits")) is None
        text = assumption_of("explained", known, SCATTER)
        assert text is not None
        assert "measurement noise" not in text
        assert "neither sigma columns nor repeated poses" not in _residual(result_of(known, SCATTER, 7.7e-5, None))


def result_of(noise: LackOfFit, repeatability: Repeatability | None, rms: float, noise_rms: float | None) -> Any:
    return {
        "noise": NOISE.write(noise),
        "repeatability": REPEATABILITY.document(repeatability),
        "before": {"fitted": {"position": {"rms_m": 1.2e-4}}},
        "unexplained": {
            "rms_m": rms,
            "noise_rms_m": noise_rms,
            "structured": False,
            "p_value": 0.4,
            "hints": [],
            "parts": {"noise_m": rms},
        },
        "explained_share": 0.77,
        "findings": ["one"],
        "robot": {"joints": [{"name": "j1", "type": "revolute"}]},
    }


def test_the_table_names_hidden_noise() -> None:
    hidden = _residual(result_of(TINY, SCATTER, 7.7e-5, None))
    assert hidden == (
        "baseline: 0.120 mm rms; measurement noise: not distinguishable from the arm's repeatability (see the "
        "remaining error) because the file has neither sigma columns nor repeated poses"
    )
    assert "measurement noise: 0.0346 mm rms, estimated" in _residual(result_of(ESTIMATED, SCATTER, 7.7e-5, None))
    shares = [line for line in _remaining_error(result_of(TINY, SCATTER, 7.7e-5, None)) if "explainable" in line]
    assert shares == ["77 % of the explainable error is explained (held-out variance above noise and repeatability)"]


@pytest.mark.parametrize(
    ("noise_rms", "text"),
    [
        (1.3e-3, "1.01 mm rms on the calibration poses; measurement noise alone is 1.30 mm"),
        (0.4e-3, "1.01 mm rms on the calibration poses, of which 0.400 mm is measurement noise"),
    ],
)
def test_noise_is_no_part_of_a_smaller_error(noise_rms: float, text: str) -> None:
    assert next(iter(_remaining_error(result_of(KNOWN, None, 1.01e-3, noise_rms)))) == text
