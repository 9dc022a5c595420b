"""Effects: deviations of an arm from its nominal table, one effect per file.

Importing the package fills the registry in the order of the catalogue, which is also the order in which parameters keep
their place if they are not distinguishable on the poses: frames before joints, constants before what varies.
"""

from robacc.effects import (  # noqa: I001  the order is the catalogue's
    base_frame as base_frame,
    tool_frame as tool_frame,
    joint_offset as joint_offset,
    link_geometry as link_geometry,
    gear_ratio as gear_ratio,
    joint_coupling as joint_coupling,
    transmission_error as transmission_error,
    backlash as backlash,
    friction_windup as friction_windup,
    approach_lag as approach_lag,
    joint_compliance as joint_compliance,
    joint_hardening as joint_hardening,
    compliance_variation as compliance_variation,
    counterbalance as counterbalance,
    lateral_compliance as lateral_compliance,
    payload_compliance as payload_compliance,
    base_compliance as base_compliance,
    axis_wobble as axis_wobble,
    rail_errors as rail_errors,
    thermal_expansion as thermal_expansion,
    joint_warmup as joint_warmup,
    frame_drift as frame_drift,
    step as step,
    read_back as read_back,
    instrument_scale as instrument_scale,
    tracker_error as tracker_error,
    target_decentre as target_decentre,
    joint_correction as joint_correction,
)
from robacc.effects.base import REGISTRY, Effect, Part, Term, effect_class

__all__ = ["REGISTRY", "Effect", "Part", "Term", "effect_class"]
