"""New programs that go to given joints: one motion to each, slow, with a stop for the measurement."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from robacc.errors import refuse
from robacc.programs.targets import N_AXES, shortened

LAYOUT: Mapping[str, Any] = {
    "data": "",
    "line": "{line}",
    "number": "{value}",
    "decimals": 5,
    "bare_point": False,
    "comma": ",",
    "half": ",",
    "units": (1e3, 180 / np.pi),
    "joints": range(1, N_AXES + 1),
    "padded": 0,
    "line_end": "\r\n",
}
"""What most dialects share of a new program's layout.

``program``
    whole text, with its ``{name}`` and the lines of ``{data}`` and of ``{moves}``
``data``
    data of the target number ``k``, with its ``{numbers}`` and its ``{comment}``
``move``, ``wait``
    lines of the motion to it, and of the stop
``line``
    a line of the motions and waits, of number ``i``
``number``, ``decimals``, ``bare_point``, ``units``
    a number of joint ``key``; whether 0.5 is .5; of a length in m and an angle in rad
``comma``, ``half``
    text between numbers, and between the third and the fourth
``joints``, ``padded``
    numbers of joints that a target may have, the text that says so (``has``), and the number to which zeros fill it up
"""


def write_program(
    layout: Mapping[str, Any],
    targets: Sequence[tuple[str, Sequence[float]]],
    *,
    name: str = "robacc",
    linear: Collection[int] = (),
) -> str:
    """Return the text of a new program that goes to each target, joint by joint, and waits there for 2 s.

    The speed is a tenth of the largest, and tool and base are those of the controller.

    Args:
        layout: Layout of the language, as :data:`LAYOUT`.
        targets: Name and joint variables, rad and m, of each target.
        name: Name of the program.
        linear: Numbers of the prismatic joints, counted from 0.

    Raises:
        UsageError: A target has more joints, or fewer, than those of the language have.
    """
    data: list[str] = []
    moves: list[str] = []
    for k, (target, q) in enumerate(targets, start=1):
        refuse((len(q) not in layout["joints"], f"target {target} has {len(q)} joints; {layout['has']}"))
        values = [value * layout["units"][i not in linear] for i, value in enumerate(q)]
        values += [0.0] * (layout["padded"] - len(q))
        texts = [shortened(f"{value:.{layout['decimals']}f}", layout["bare_point"]) for value in values]
        entries = [layout["number"].format(key=key, value=text) for key, text in enumerate(texts, start=1)]
        halves = (layout["comma"].join(half) for half in (entries[:3], entries[3:]) if half)
        words = {"k": k, "numbers": layout["half"].join(halves), "comment": re.sub(r"[^\x20-\x7e]", "?", target)[:60]}
        data.append(layout["data"].format(**words))
        moves += [*layout["move"].format(**words).split("\n"), layout["wait"]]
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII) or "robacc"
    identifier = identifier if identifier[0].isalpha() else f"p{identifier}"
    lines = "\n".join(layout["line"].format(i=i, line=line) for i, line in enumerate(moves, start=1))
    whole: str = layout["program"].format(
        name=identifier, NAME=identifier.upper()[:36], data="\n".join(data), moves=lines
    )
    return whole.replace("\n", layout["line_end"])
