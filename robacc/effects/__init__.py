"""Effects: deviations of an arm from its nominal table, each a class that declares its terms, settings and traits.

The registry is in the order of the catalogue, which is also the order in which parameters keep their place if they are
not distinguishable on the poses: frames before joints, constants before what varies.
"""

from importlib import import_module

from robacc.effects import base
from robacc.effects.base import Effect, Part, Term, effect_class

__all__ = ["REGISTRY", "Effect", "Part", "Term", "effect_class"]

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


def __getattr__(name: str) -> dict[str, type[Effect]]:
    """Return ``REGISTRY``, every effect by name; the modules of the effects are loaded when it is first asked for."""
    if name != "REGISTRY":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    known, earlier = base.REGISTRY, dict(base.REGISTRY)  # a user's effect may replace one of the package
    for module in ("frames", "joints", "elastic", "periodic", "campaign"):
        import_module(f"robacc.effects.{module}")
    known.update({effect: earlier.get(effect, known.pop(effect)) for effect in dict.fromkeys((*_ORDER, *known))})
    return known
