"""What work costs, as a process of its own or as a call, beside what is wanted; a miss is printed, no test fails."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROBACC = (sys.executable, "-m", "robacc")


class Cost(NamedTuple):
    """What a process alone took."""

    seconds: float
    """Of the processor."""
    clock: float
    """Seconds from its start to its end."""
    megabytes: float


def users_environment(bytecode: Path) -> dict[str, str]:
    """As of a user, who has the bytecode of what is installed; the first run of a command writes it there."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPYCACHEPREFIX": str(bytecode)}


def costs(environment: dict[str, str], times: int, *commands: Sequence[str]) -> list[Cost]:
    """The least of each that a command took in so many runs by turns; each must succeed."""
    found: list[list[Cost]] = [[] for _ in commands]
    launcher = (sys.executable, "-S", str(Path(__file__).with_name("child.py")))
    for _ in range(times):
        for command, of_command in zip(commands, found, strict=True):
            output = subprocess.run(
                (*launcher, *command), env=environment, cwd=ROOT, check=True, capture_output=True, text=True
            ).stdout
            of_command.append(Cost(*json.loads(output)))
    return [Cost(*map(min, zip(*of_command, strict=True))) for of_command in found]


def fastest(call: Callable[[], object], times: int = 3) -> float:
    """Least processor time of a call, s."""
    taken = []
    for _ in range(times):
        begin = time.process_time()
        call()
        taken.append(time.process_time() - begin)
    return min(taken)


def report(capsys: pytest.CaptureFixture[str], what: str, *figures: tuple[float, str, float | None]) -> None:
    """Print figures, each with its unit and the largest that is wanted; None for one without a limit."""
    texts = [
        f"{value:.3g} {unit}" + ("" if most is None else f" ({'wanted' if value <= most else 'MISSED'} {most:g})")
        for value, unit, most in figures
    ]
    with capsys.disabled():
        print(f"\n  {what}: {', '.join(texts)}")
