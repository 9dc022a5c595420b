"""Universal Robots URScript: joint lists and poses that motions go to, with the TCP of ``set_tcp``.

Source: Universal Robots, The URScript Programming Language (SW 3.x, 5.x), modules motion and internals.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial

from robacc.errors import refuse
from robacc.programs.program import Program, ProgramFrame, ProgramSource, ProgramTarget
from robacc.programs.targets import N_AXES
from robacc.robots.description import Frame
from robacc_plugins.dialects import (
    LAYOUT,
    ROTATION_VECTOR,
    RUN_TIME,
    Draft,
    EventKind,
    FrameEvent,
    Place,
    arguments,
    items,
    mask,
    numbers,
    stripped,
    timeline,
    unclosed,
    write_program,
)

SIGN = re.compile(r"^\s*(?:def|thread|sec)\s+\w+\s*\([^)\n]*\)\s*:|\b(?:movej|movel|movep|movec)\s*\(", re.M)
_HIDDEN = re.compile(r"\"[^\"\r\n]*\"|'[^'\r\n]*'|#[^\r\n]*")
"""Strings and comments."""
_ASSIGNMENT = re.compile(
    r"^[ \t]*(?:(?:global|local)[ \t]+)?([A-Za-z_]\w*)[ \t]*(\[[^\]\r\n]*\])?[ \t]*=(?!=)"
    r"[ \t]*(?:(p?\s*\[[^\]]*\])[ \t;]*(?=[\r\n]|\Z))?",
    re.M,
)
_MOTION = re.compile(
    r"^[ \t]*(?:def|thread)[ \t]+\w+[ \t]*\(|\b(movej|movel|movep|movec|servoj|servoc|set_tcp)\s*\(", re.M
)
_INVERSE = re.compile(r"get_inverse_kin\s*\(")
_BLOCK = re.compile(
    r"^[ \t]*(?:(def|thread|sec|if|while|elif|else|end)\b(?:[ \t]+(\w+))?|([A-Za-z_]\w*)[ \t]*\()", re.M
)
"""Words of blocks, and calls."""
_EVENTS: dict[str, EventKind] = {
    **dict.fromkeys(("def", "thread", "sec"), "routine"),
    **dict.fromkeys(("elif", "else"), "next"),
    "if": "open",
    "while": "loop",
    "end": "close",
}
_ONE_LINE = re.compile(r"[^\r\n]*\bend[ \t]*(?=[\r\n]|\Z)")
_KEYWORD = re.compile(r"(?:q|pose|pose_via|pose_to|x|b)\s*=(?!=)")
_NAME = re.compile(r"[A-Za-z_]\w*\Z")
_BASE = ProgramFrame("base", Frame())


def parse(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a URScript file.

    Raises:
        InputError: The text is truncated.
    """
    draft, text, fix = Draft(source, "urscript"), mask(source.text, _HIDDEN), "save the script again"
    words = list(_BLOCK.finditer(text))
    opened = unclosed(
        (match[1], match.start(1), match[1] != "end")
        for match in words
        if _EVENTS.get(match[1]) not in (None, "next") and (match[1] == "end" or not _ONE_LINE.match(text, match.end()))
    )
    word, start = next(iter(opened), ("", 0))
    brackets = unclosed((m[0], m.start(), m[0] in "[(") for m in re.finditer(r"[\[\]()]", text))
    bracket, at = next(reversed(brackets), ("", 0))
    refuse(
        (word, source.problem(f"is truncated: this {word} has no end", start, fix)),
        (bracket, source.problem("is truncated: this bracket is not closed", at, fix)),
    )
    literals: dict[str, Place] = {}
    """Variables that are assigned once, as numbers."""
    changed: dict[str, int] = {}
    """Variables that the program computes, and where."""
    for match in _ASSIGNMENT.finditer(text):
        name, place = match[1], match.span(3)
        if match[2] or not match[3] or not _written(text, place) or name in {**literals, **changed}:
            changed.setdefault(name, match.start(1))
        else:
            literals[name] = place
    literals = {name: place for name, place in literals.items() if name not in changed}
    used: dict[int, int | None] = {}
    """Index of the target of each literal by its place; None for one that is a TCP."""

    def argument(place: Place) -> tuple[str, Place]:
        """Return the variable of an argument, empty for none, and the place of its numbers, without its keyword."""
        if keyword := _KEYWORD.match(text, *place):
            place = stripped(text, (keyword.end(), place[1]))
        name = _NAME.match(text, *place)
        return (name[0], literals.get(name[0], place)) if name else ("", place)

    def target(place: Place) -> list[int | None] | str:
        """Return the target of an argument, which is added at its first use, or the reason why it has none."""
        name, place = argument(place)
        inverse = _INVERSE.match(text, *place)
        if inverse is not None:
            inner, end = arguments(text, inverse.end())
            if end + 1 != place[1]:
                return RUN_TIME
            name, place = argument(inner[0])
        if name in changed:
            return f"the program assigns {name} at run time in line {source.line(changed[name])}"
        written = _written(text, place)
        if written is None or (inverse is not None and written.convention is None):
            return RUN_TIME
        if used.get(place[0]) is None:
            used[place[0]] = draft.add(name, written)
        return [used[place[0]]]

    calls = [match for match in _MOTION.finditer(text) if match[1]]
    events = [FrameEvent(m.start(), _EVENTS.get(m[1], "call"), name=m[2] or m[3] or "") for m in words]
    for match in (match for match in calls if match[1] == "set_tcp"):
        # The TCP is unknown before the first of these calls.
        _, place = argument(arguments(text, match.end())[0][0])
        written, frame = _written(text, place), None
        if written is not None and written.convention is not None:
            used.setdefault(place[0])
            frame = ProgramFrame("", written.frame)
        events.append(FrameEvent(match.start(), "set", frame))
    tools = timeline(sorted(events, key=lambda event: event.position))
    for match in (match for match in calls if match[1] != "set_tcp"):
        places, end = arguments(text, match.end())
        for place in places[: 2 if match[1] in ("movec", "servoc") else 1]:
            draft.move((match.start(), end + 1), target(place), tools(match.start()), _BASE)
    for place in literals.values():
        if place[0] not in used and text[place[0]] == "p":
            draft.note(place, "is a pose that no motion goes to directly")
    return draft.program()


def _written(text: str, place: Place) -> ProgramTarget | None:
    """Return the joints ``[…]`` or the pose ``p[…]`` of six numbers; None for anything else."""
    is_pose = text[place[0] : place[1]][:1] == "p"
    values = numbers(text, items(text, (place[0] + is_pose, place[1])), (1.0,) * 6)
    return None if values is None else ProgramTarget(ROTATION_VECTOR if is_pose else None, values)


NEW_SUFFIX = ".script"
"""Suffix of a new program."""
write = partial(
    write_program,
    {
        **LAYOUT,
        "joints": [N_AXES],
        "has": f"a URScript target has {N_AXES}",
        "program": "def {name}():\n  # written by robacc: check the speed, the TCP and every motion before you run it\n"
        "{moves}\nend\n",
        "move": "  # {comment}\n  movej([{numbers}], a=0.5, v=0.314)",
        "wait": "  sleep(2)",
        "decimals": 7,
        "units": (1.0, 1.0),
        "line_end": "\n",
    },
)
"""Return the text of a new program; see :func:`robacc_plugins.dialects.write_program`."""
