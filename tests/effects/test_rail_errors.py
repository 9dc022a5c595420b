"""An arm on a rail that is bent and twisted: kinematics are those of the independent arm, carried by hand."""

from __future__ import annotations

from independent_arm import measured_on_a_rail, robot_on_a_rail
from searched import error_at, fitted, found, searched

from robacc.robots.arm import Arm

ARM = Arm.of(robot_on_a_rail())


def test_a_rails_curves_are_found_and_predict_other_poses() -> None:
    data, fresh = measured_on_a_rail(140, 51, 1e-5, 1.0), measured_on_a_rail(60, 52, 0.0, 1.0)
    effects, _, error = searched(data, fresh, ARM)
    assert [str(effect) for effect in effects] == ["rail_errors[rail]"]
    assert error < 2e-5
    assert error_at(fitted(data, (), ARM), fresh) > 5e-5


def test_a_straight_rail_is_left_alone() -> None:
    assert found(measured_on_a_rail(90, 53, 1e-5, 0.0), ARM) == ()
