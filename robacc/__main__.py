"""``python -m robacc``, and the command ``robacc``: the signals that end it, from its first moment on."""

from __future__ import annotations

import signal
import sys
import time
from types import FrameType
from typing import NoReturn

_IMPATIENT = 1.0
"""s within which a second interrupt is the first one's echo: what is being cleared away then must not be disturbed."""
_last_interrupt = -_IMPATIENT


def main() -> None:
    """Run the command line and exit with its status."""
    try:
        _answer_signals()
        # Within the try, for the imports are half of the time that a short command takes.
        from robacc.cli.main import main as run

        run()
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)


def _answer_signals() -> None:
    """Be ended by an exception, which lets files half written and processes at work be cleared away."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _leave)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _last_interrupt
    since, _last_interrupt = time.monotonic() - _last_interrupt, time.monotonic()
    if since > _IMPATIENT:
        raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


if __name__ == "__main__":
    main()
