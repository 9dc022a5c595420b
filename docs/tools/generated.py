"""Generated parts of the reference, between ``<!-- made: NAME -->`` and ``<!-- end -->``."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterator
from typing import Any

from schema_tables import results

_PART = re.compile(r"(<!-- made: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_made_parts(page: str) -> str:
    """Return the page with every generated part as the program is now."""
    return _PART.sub(lambda match: match[1] + "\n" + _MAKERS[match[2]]().strip() + "\n\n" + match[3], page)


def _effects() -> str:
    """Return the catalogue: a table of all effects, then each effect."""
    from robacc.effects import REGISTRY

    rows = "\n".join(f"| [`{name}`](#{name}) | {_prose(cls.about.summary)} |" for name, cls in REGISTRY.items())
    parts = [f"| effect | what it is |\n| --- | --- |\n{rows}"]
    for name, cls in REGISTRY.items():
        about = cls.about
        properties = [
            ("equation", about.equation),
            ("unit", about.unit),
            ("usual size", about.usual_size),
            ("needs", about.needs),
            ("confused with", about.confused_with),
            ("tested", "joint by joint" if cls.traits.per_joint else "as a whole"),
            ("written as", "parameters of the robot" if cls.traits.is_constant else "an entry under `effects:`"),
            ("source", about.source),
        ]
        table = "\n".join(f"| {key} | {_prose(value) if key != 'written as' else value} |" for key, value in properties)
        entry = f"```yaml\neffects:\n  - {about.example}\n```"
        parts.append(f"## {name}\n\n{_sentence(_prose(about.summary))}\n\n| | |\n| --- | --- |\n{table}\n\n{entry}")
    return "\n\n".join(parts)


def _commands() -> str:
    """Return every command: its purpose, synopsis and options, as ``--help`` prints them."""
    from robacc.cli.main import COMMANDS, FORMS

    names = (name for head in COMMANDS for name in (head, *(form for form in FORMS if form.split()[0] == head)))
    return "\n\n".join(f"## {name}\n\n{_command(name)}" for name in names)


def _command(name: str) -> str:
    from robacc.cli.command import load
    from robacc.cli.main import FORMS

    command = load(name, FORMS.get(name))
    context = command.make_context(f"robacc {name}", [], resilient_parsing=True)
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    synopsis = [_argument(p, context) for p in arguments]
    synopsis += [f"{p.opts[0]} {_value(p, context)}" for p in options if p.required]
    rows = [f"| `{_argument(p, context)}` | {_prose(p.help or '')} |" for p in arguments]
    rows += [f"| {_names(p, context)} | {_prose(_help(p, context))} |" for p in options]
    return "\n\n".join(
        (
            _paragraphs(command.help or ""),
            f"```text\n{' '.join(('robacc', name, *synopsis))} [OPTIONS]\n```",
            "| argument or option | meaning |\n| --- | --- |\n" + "\n".join(rows),
        )
    )


def _argument(parameter: Any, context: Any) -> str:
    name = str(parameter.make_metavar(context))
    name = name[1:-1] if name[0] + name[-1] in ("{}", "[]") else name
    return name if parameter.required else f"[{name}]"


def _value(parameter: Any, context: Any) -> str:
    if parameter.is_flag:
        return ""
    name = str(parameter.make_metavar(context))
    return name[1:-1] if name[0] + name[-1] in ("<>", "[]", "{}") else name


def _names(parameter: Any, context: Any) -> str:
    names = ", ".join(f"`{name}`" for name in parameter.opts)
    if parameter.secondary_opts:
        names += " / " + ", ".join(f"`{name}`" for name in parameter.secondary_opts)
    value = _value(parameter, context)
    return f"{names} `{value}`".replace("|", "\\|") if value else names


def _help(parameter: Any, context: Any) -> str:
    default = parameter.get_default(context)
    text = str(parameter.help or "")
    if parameter.required:
        return f"{text} Required."
    if parameter.is_flag and parameter.secondary_opts:
        return f"{text} Default: {(parameter.opts if default else parameter.secondary_opts)[0]}."
    if default is None or parameter.is_flag or default == "":
        return text
    return f"{text} Default: {'the current folder' if default == '.' else getattr(default, 'value', default)}."


def _paragraphs(text: str) -> str:
    """Return a help text with its example commands set as code."""
    pieces = re.split(r"(?<=Example: )(robacc [a-z0-9-]+ [^;]*?\S)(?=; |\. |\.$|$)", " ".join(text.split()))
    return "".join(f"`{piece}`" if number % 2 else _prose(piece) for number, piece in enumerate(pieces))


def _gate_keys() -> str:
    """Return the keys that a criterion may name; the four statistics of a figure share a row."""
    from robacc.gates import KEYS, LARGER_IS_BETTER

    rows = [
        f"| `{key}` | {kind}{', larger is better' if key in LARGER_IS_BETTER else ''} |"
        for key, kind in _folded(dict(KEYS))
    ]
    return "| key | kind of value |\n| --- | --- |\n" + "\n".join(rows)


def _folded(keys: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield keys and kinds, the four statistics of a figure in one row."""
    done = set()
    for key, kind in keys.items():
        stem, _, last = key.rpartition(".")
        if last in ("rms", "mean_error", "p95", "max") and all(
            f"{stem}.{statistic}" in keys for statistic in ("rms", "mean_error", "p95", "max")
        ):
            if stem not in done:
                done.add(stem)
                yield f"{stem}.{{rms, mean_error, p95, max}}", kind
        else:
            yield key, kind


def _rules() -> str:
    from robacc.gates import RULES

    return "| rule | decides |\n| --- | --- |\n" + "\n".join(f"| `{k}` | {_prose(v)} |" for k, v in RULES.items())


def _prose(text: str) -> str:
    """Return a text of the program as Markdown, with its markup characters escaped."""
    plain = re.sub(r"\s+", " ", text)
    return re.sub(r"([\\`*_\[\]|])", r"\\\1", html.escape(plain, quote=False))


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."


_MAKERS: dict[str, Callable[[], str]] = {
    "effects": _effects,
    "commands": _commands,
    "gate-keys": _gate_keys,
    "gate-rules": _rules,
    "results": results,
}
