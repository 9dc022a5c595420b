"""``python -m robacc`` and the command ``robacc``, with their signal handlers."""

import signal
import sys
import time
from types import FrameType
from typing import NoReturn

_REPEAT_TIME = 1.0
"""Time in s after an interrupt in which another is ignored, so that the clean-up is not disturbed."""
_last_interrupt = -_REPEAT_TIME


def main() -> None:
    """Run the command line and exit with its status."""
    try:
        _handle_signals()
        # Inside the try: the imports take half the time of a short command.
        from robacc.cli.main import main as run

        run()
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)


def _handle_signals() -> None:
    """Raise an exception for signals, so that partial files are removed and processes are ended."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, _raise_interrupt)
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _leave)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _last_interrupt
    elapsed, _last_interrupt = time.monotonic() - _last_interrupt, time.monotonic()
    if elapsed > _REPEAT_TIME:
        _raise_interrupt(number, frame)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Raise an interrupt; within an import wait until it ends, since extension modules clear exceptions."""
    while frame is not None and hasattr(signal, "setitimer"):
        if "importlib._bootstrap" in frame.f_code.co_filename:
            signal.setitimer(signal.ITIMER_REAL, 0.01)  # s, after which it is raised again
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


if __name__ == "__main__":
    main()
