"""Findings on poses of which two were exchanged: rows that are metres off do not hide what the others show."""

from __future__ import annotations

import dataclasses

import numpy as np
from arms import arm

import robacc


def test_an_effect_is_found_beside_two_exchanged_rows() -> None:
    """It was withdrawn, because the two rows outweighed what held-out poses gain by it."""
    robot = arm("puma560").robot
    sagging = {"effect": "joint_compliance", "joints": ["j2"], "values": {"j2": 1e-5}}
    real = dataclasses.replace(robot, effects=(sagging,))
    data = robacc.simulate(real, poses=80, seed=4, noise=2e-5, sampling="random").data
    position = data.position.copy()
    position[:, [30, 61]] = position[:, [61, 30]]
    data = dataclasses.replace(data, position=position, rotation=None)
    traced = robacc.trace(data, robot=robot, declared="base_frame,tool_frame,joint_offset", folds=5)
    assert [(finding.effect, finding.joints) for finding in traced.findings] == [("joint_compliance", ("j2",))]
    assert not any("withdrawn" in warning for warning in traced.warnings)
    assert np.flatnonzero(~traced.fit.inliers).tolist() == [30, 61]
