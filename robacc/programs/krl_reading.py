"""Findings in one KRL file: declarations, assignments, motions and the statements that decide $TOOL and $BASE."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from robacc.programs.krl_syntax import NAME, Aggregate, KrlLine, aggregate_at, lines
from robacc.programs.source import ProgramSource

_ANY = re.IGNORECASE
_DECLARATION = re.compile(
    rf"\s*(?:(?:GLOBAL|DECL|CONST)\s+)*(E6POS|POS|E6AXIS|AXIS|FRAME|FDAT)\s+({NAME})\s*(=?)\s*(.*)", _ANY
)
_ASSIGNMENT = re.compile(rf"\s*({NAME})(\s*\.\s*\w+)?\s*=(?!=)\s*", _ANY)
_INDEXED = re.compile(r"\s*([A-Za-z_]\w*)\s*\[[^\]=]*\][^=]*=(?!=)", _ANY)
_MOTION = re.compile(r"\s*(S?(?:PTP|LIN|CIRC)|SPL|ASYPTP)(_REL)?(?![\w.\[])\s*(?!=)", _ANY)
_ROUTINE = re.compile(r"\s*(?:GLOBAL\s+)?(DEFDAT|DEFFCT|DEF)\s+(?:\w+(?:\[\s*\])?\s+)?(\$?\w+)", _ANY)
_ROUTINE_END = re.compile(r"\s*END(?:DAT|FCT)?\s*\Z", _ANY)
_BLOCK = re.compile(
    r"\s*(IF|SWITCH|FOR|WHILE|LOOP|REPEAT|ELSE|CASE|DEFAULT|ENDIF|ENDSWITCH|ENDFOR|ENDWHILE|ENDLOOP|UNTIL)\b", _ANY
)
_CALL = re.compile(r"\s*(\w+)\s*\(", _ANY)
_BAS = re.compile(r"\s*BAS\s*\(\s*#(\w+)\s*(?:,\s*(\w+))?", _ANY)


@dataclass(slots=True)
class KrlReading:
    """Findings in one file."""

    source: ProgramSource
    masked: str = ""
    literals: dict[str, list[tuple[str, Aggregate]]] = field(default_factory=dict)
    """Declarations and assignments with an aggregate, by name in capitals: type (empty for an assignment)."""
    changes: dict[str, list[int]] = field(default_factory=dict)
    """Places of assignments that are no aggregate of numbers, by name."""
    declared: dict[str, str] = field(default_factory=dict)
    motions: list[tuple[KrlLine, re.Match[str]]] = field(default_factory=list)
    statements: list[tuple[int, str, str]] = field(default_factory=list)
    """Place, kind and text of statements that matter for $TOOL and $BASE."""
    spelling: dict[str, str] = field(default_factory=dict)
    """Names as written, by names in capitals."""
    data_frames: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Numbers of tool and base of each FDAT."""
    fixed_tool: set[str] = field(default_factory=set)
    """FDAT whose tool stands in the cell (IPO_FRAME #TCP)."""


def read_krl(source: ProgramSource) -> KrlReading:
    """Return every statement of a file that matters."""
    masked, each = lines(source)
    reading = KrlReading(source, masked)
    for line in each:
        if (match := _MOTION.match(line.text)) is not None:
            reading.motions.append((line, match))
        elif (match := _ROUTINE.match(line.text)) is not None:
            reading.statements.append((line.start, "routine", match[2].upper()))
        elif _ROUTINE_END.match(line.text):
            reading.statements.append((line.start, "end", ""))
        elif (match := _BLOCK.match(line.text)) is not None:
            reading.statements.append((line.start, match[1].upper(), ""))
        elif (match := _DECLARATION.match(line.text)) is not None:
            _read_declaration(reading, line, match)
        elif (match := _BAS.match(line.text)) is not None:
            reading.statements.append((line.start, f"BAS {match[1].upper()}", (match[2] or "").upper()))
        elif (match := _ASSIGNMENT.match(line.text)) is not None:
            _read_assignment(reading, line, match)
        elif (match := _INDEXED.match(line.text)) is not None:
            reading.changes.setdefault(f"{match[1].upper()}[", []).append(line.start)
        elif (match := _CALL.match(line.text)) is not None:
            reading.statements.append((line.start, "call", match[1].upper()))
    return reading


def key_of(name: str) -> str:
    """Return a name without blanks, in capitals."""
    return re.sub(r"\s", "", name).upper()


def _read_declaration(reading: KrlReading, line: KrlLine, match: re.Match[str]) -> None:
    kind, name = match[1].upper(), key_of(match[2])
    if not match[3]:
        for other in [match[2], *match[4].split(",")]:
            reading.declared[key_of(other).partition("[")[0]] = kind
        return
    start = line.start + match.start(4)
    aggregate = aggregate_at(reading.source.text, reading.masked, start, line.end)
    if kind == "FDAT":
        text = match[4]
        tool, base = (re.search(rf"{key}_NO\s+(\d+)", text, _ANY) for key in ("TOOL", "BASE"))
        if tool and base:
            reading.data_frames[name] = (tool[1], base[1])
        if re.search(r"IPO_FRAME\s+#TCP", text, _ANY):
            reading.fixed_tool.add(name)
        return
    reading.declared[name] = kind
    reading.spelling[name] = match[2].strip()
    if aggregate is None or reading.masked[aggregate.end : line.end].strip():
        reading.changes.setdefault(name, []).append(line.start)
    else:
        reading.literals.setdefault(name, []).append((kind, aggregate))


def _read_assignment(reading: KrlReading, line: KrlLine, match: re.Match[str]) -> None:
    name = key_of(match[1])
    value = line.text[match.end() :]
    if name in ("$TOOL", "$BASE"):
        text = "component" if match[2] else value
        reading.statements.append((line.start + match.end(), name, text))
        return
    if name == "FDAT_ACT" and not match[2]:
        reading.statements.append((line.start, "FDAT", key_of(value)))
        return
    start = line.start + match.end()
    aggregate = None if match[2] else aggregate_at(reading.source.text, reading.masked, start, line.end)
    if aggregate is not None and aggregate.is_literal and (aggregate.frame() or aggregate.axes()):
        reading.literals.setdefault(name, []).append(("", aggregate))
        reading.spelling.setdefault(name, match[1].strip())
    else:
        reading.changes.setdefault(name, []).append(line.start)
