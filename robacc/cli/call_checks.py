"""Checks of the options of a call before anything is computed; commands share them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any


def check_call(parameters: Mapping[str, Any], outputs: Sequence[str]) -> None:
    """Raise an error for options that cannot work, before anything is computed.

    Args:
        parameters: Values of the options by the names of their parameters.
        outputs: Parameters that name files to write.

    Raises:
        UsageError: an output has no name or would overwrite an input or another output, standard input is named twice,
            ``--junit`` is given without ``--gate``, or a library that ``--report`` needs is not installed.
        InputError: the gate cannot be read, or an output is a folder or in a folder that does not exist.
    """
    from robacc.errors import UsageError

    if parameters.get("junit") is not None and parameters.get("gate") is None:
        raise UsageError("--junit writes the outcome of a gate, so it needs --gate")
    if parameters.get("report") is not None:
        from robacc.render.plots.canvas import need

        need("matplotlib", "plotly", "jinja2")
    texts = [text for name, value in parameters.items() if name not in outputs for text in _texts(value)]
    if texts.count("-") > 1:
        raise UsageError("standard input can be read only once, but - is given more than once; name files")
    inputs = [text for text in texts if _is_file(text)]
    # A gate from a pipe can be read only once, which happens when there is a result to check.
    if (gate := parameters.get("gate")) is not None and not _is_stream(gate):
        from robacc.documents.gate import baseline_path, read_gate

        inputs += [baseline_path(gate, name) for name in read_gate(gate).gate.baselines]
    _check_outputs(parameters, outputs, inputs)


def _check_outputs(parameters: Mapping[str, Any], outputs: Sequence[str], inputs: Sequence[str]) -> None:
    from robacc.errors import UsageError
    from robacc.io.files import target_of

    is_folder_allowed = len(_texts(parameters.get("poses"))) > 1
    written: dict[str, str] = {}
    for name in sorted(outputs):
        option = f"--{name.replace('_', '-')}"
        for path in _texts(parameters[name]):
            if not path:
                raise UsageError(f"{option}: expected the name of a file, found nothing")
            if path == "-":
                other = written.setdefault(path, option)
                if other != option:
                    raise UsageError(f"{other} and {option} both name standard output; name a file for one of them")
                continue
            if _is_file(path) and any(os.path.samefile(path, file) for file in inputs):
                raise UsageError(f"{option} {path} is also an input and would be overwritten; name another file")
            other = written.setdefault(os.path.realpath(path), option)
            if other != option:
                raise UsageError(f"{other} and {option} both name {path}; name two files")
            # With several files of poses, each result is a file in a folder, which is made.
            if not (is_folder_allowed and (path.endswith(("/", os.sep)) or os.path.isdir(path))):
                target_of(path)


def _texts(value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    return tuple(item for item in value if isinstance(item, str)) if isinstance(value, list | tuple) else ()


def _is_stream(path: str) -> bool:
    return path == "-" or (os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path))


def _is_file(path: str) -> bool:
    try:
        return os.path.isfile(path)
    except ValueError:  # a NUL in the name
        return False
