"""The causes of an arm's error, as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robacc.accuracy.stages import Stage
from robacc.render.text.effect_label import effect_label
from robacc.render.text.layout import TextLine, columns, wrapped
from robacc.render.text.numbers import three_digits
from robacc.render.text.units import IN_MM
from robacc.tracing.causes import ErrorCause

_IN_HEADLINE = 3
_NOTABLE = 0.01
"""Least share of the error of a cause that is listed."""


def draw_causes(
    causes: Sequence[ErrorCause], nominal: Stage, after: Stage, width: int, most: int = 8
) -> Iterator[TextLine]:
    """Yield what the error was and is, its largest causes, and a table of at most ``most`` causes."""
    apart = nominal.held_out is not None and after.held_out is not None
    was, now = (
        (stage.held_out if apart and stage.held_out is not None else stage.fitted).position.rms * IN_MM
        for stage in (nominal, after)
    )
    notable = [cause for cause in causes if cause.share is None or cause.share >= _NOTABLE or not cause.declared]
    named = ", ".join(_label(cause) for cause in notable[:_IN_HEADLINE]) or "no single cause"
    yield from wrapped(
        f"{three_digits(was)} mm rms to {three_digits(now)} mm rms"
        f"{' on held-out poses' if apart else ''}: {named}{' and others' if len(notable) > _IN_HEADLINE else ''}",
        width,
    )
    if not causes:
        return
    is_mixed = len({cause.declared for cause in causes}) > 1
    rows = [
        [
            f"{_label(cause)}{' (declared)' * (cause.declared and is_mixed)}",
            three_digits(cause.size * IN_MM),
            " to ".join(three_digits(end * IN_MM) for end in cause.interval),
            three_digits(cause.left * IN_MM),
            "–" if cause.share is None else f"{100 * cause.share:.0f} %",
        ]
        for cause in notable[:most]
    ]
    if rows:
        yield from columns(["effect", "moves, mm", "95 % interval", "without it, mm", "share"], rows)
    if hidden := len(causes) - len(rows):
        yield TextLine(f"and {hidden} smaller; the JSON result has all of them", "dim")
    note = (
        "moves: rms distance by which the effect alone moves the tool; without it: rms error that no other effect can "
        "describe; share: of the nominal model's mean square error"
    )
    yield from (TextLine(line.text, "dim") for line in wrapped(note, width))


def _label(cause: ErrorCause) -> str:
    return effect_label(cause.effect, cause.joints, cause.settings)
