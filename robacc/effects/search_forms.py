"""Effects in the forms that a search builds: periodic errors of one order, profiles, and processes over the joints."""

from __future__ import annotations

from robacc.effects.base import Effect
from robacc.effects.pose_correction import PoseCorrection
from robacc.effects.transmission_error import TransmissionError
from robacc.robots.arm import Arm

# Periodic errors of one joint as a search builds them: of one order, or the joint's profile of orders.

PERIODIC = TransmissionError.name
"""Name of the effect that a search over orders finds."""

_LOW = 2.5
"""Order up to which a periodic error is a slow function of the joint's angle."""


def periodic_joints(arm: Arm) -> tuple[str, ...]:
    """Return the joints that can have a periodic error."""
    return TransmissionError.possible_joints(arm)


def of_order(joint: str, order: float) -> Effect:
    """Return the periodic error of ``joint`` of one order (periods per turn)."""
    return TransmissionError((joint,), (order,))


def orders_of(effect: Effect) -> tuple[float, ...]:
    """Return the orders of a periodic error; none of any other effect."""
    return effect.orders if isinstance(effect, TransmissionError) else ()


def searched_order(effect: Effect) -> float | None:
    """Return the order of an effect that a search found: a single order that is not 1 or 2."""
    orders = orders_of(effect)
    return orders[0] if len(orders) == 1 and not effect.is_profile() and orders[0] not in (1.0, 2.0) else None


def low_orders(effect: Effect) -> bool:
    """Return whether an effect is a periodic error of orders about 1 and 2 only."""
    orders = orders_of(effect)
    return bool(orders) and not effect.is_profile() and max(orders) <= _LOW


# Effects that stand in a model file for processes over the joints: errors without a cause.


def profile(joint: str, orders: tuple[float, ...]) -> Effect:
    """Return the periodic error of ``joint`` of all ``orders``, shrunk by a common prior."""
    return TransmissionError((joint,), orders, True)


pose_correction = PoseCorrection.over
