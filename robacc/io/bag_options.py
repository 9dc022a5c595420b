"""Statements on a recording of messages: the topics to read, and the samples to use."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields

from robacc.errors import UsageError

_CHOICES: Mapping[str, tuple[str, ...]] = {"clock": ("stamp", "recorder"), "at": ("any", "rest")}
EXAMPLE = "joints=/joint_states,measured=/tracker/pose,at=rest"


@dataclass(frozen=True, slots=True)
class BagOptions:
    """Topics of a recording and how their samples are associated."""

    joints: str | None = None
    """Topic of joint states; likewise the next two."""
    measured: str | None = None
    commanded: str | None = None
    clock: str = "stamp"
    """Time of a sample: ``stamp`` of the message's header, or the time at which the ``recorder`` received it."""
    at: str | None = None
    """``rest``: one pose for each stand of the robot, the mean of its samples; ``any``: every sample."""

    @classmethod
    def of(cls, text: str | None) -> BagOptions:
        """Return the statements of a text ``key=value,…``.

        Raises:
            UsageError: A key or a value is unknown.
        """
        stated: dict[str, str] = {}
        known = [field.name for field in fields(cls)]
        for part in (text or "").split(",") if text else ():
            key, sign, value = (item.strip() for item in part.partition("="))
            if not sign or not value or key not in known:
                near = difflib.get_close_matches(key, known, 1)
                hint = f"; did you mean {near[0]}?" if near and key not in known else ""
                raise UsageError(f"`bag`: expected {', '.join(known)} as in {EXAMPLE}, found {part!r}{hint}")
            if key in stated:
                raise UsageError(f"`bag`: {key} is given twice")
            if value not in _CHOICES.get(key, (value,)):
                raise UsageError(f"`bag`: expected {key}={' or '.join(_CHOICES[key])}, found {part!r}")
            stated[key] = value
        return cls(**stated)


NO_BAG_OPTIONS = BagOptions()
"""No statement: the recording decides."""
