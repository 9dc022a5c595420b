"""Effects: deviations of an arm from its nominal table, each a class that declares its terms, settings and traits.

Importing the package fills the registry in the order of the catalogue, which is also the order in which parameters keep
their place if they are not distinguishable on the poses: frames before joints, constants before what varies.
"""

from robacc.effects import campaign, elastic, frames, joints, periodic  # noqa: F401
from robacc.effects.base import REGISTRY, Effect, Part, Term, effect_class

_ORDER = (
    "base_frame",
    "tool_frame",
    "joint_offset",
    "link_geometry",
    "gear_ratio",
    "joint_coupling",
    "transmission_error",
    "backlash",
    "friction_windup",
    "approach_lag",
    "joint_compliance",
    "joint_hardening",
    "compliance_variation",
    "counterbalance",
    "lateral_compliance",
    "payload_compliance",
    "base_compliance",
    "axis_wobble",
    "rail_errors",
    "thermal_expansion",
    "joint_warmup",
    "frame_drift",
    "step",
    "read_back",
    "instrument_scale",
    "tracker_error",
    "target_decentre",
    "joint_correction",
)
REGISTRY.update({name: REGISTRY.pop(name) for name in _ORDER})

__all__ = ["REGISTRY", "Effect", "Part", "Term", "effect_class"]
