"""Fuzz the readers for a given time: ``python tests/fuzz/run.py READER --seconds N``.

READER is one of ``targets.READERS``, or ``all`` of them in turn. A file that makes robacc crash, hang or end without a
message is saved in ``--keep FOLDER``, once for each place in the code; the exit status is 1 where there is such a file.
"""

import argparse
import hashlib
import os
import random
import resource
import signal
import sys
import time
import traceback
from pathlib import Path
from types import FrameType

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = map(os.fspath, Path(__file__).resolve().parents[:2])

from mutations import mutate_json, mutate_text  # noqa: E402 (the path and the threads come first)
from targets import READERS, seeds  # noqa: E402

TIME_LIMIT = 60
"""s for one file."""
MEMORY = 6 * 2**30
"""Bytes of address space; the libraries need most of it."""


class Hang(BaseException):
    """A file took longer than TIME_LIMIT."""


class Attack:
    """Reader under test, and its findings."""

    def __init__(self, reader: str, folder: Path) -> None:
        self.reader, self.folder = reader, folder
        self.findings: set[str] = set()
        self.cases = 0
        self.call = READERS[reader]

    def __call__(self, data: bytes) -> None:
        """Try one file and save it where the reader fails."""
        self.cases += 1
        signal.alarm(TIME_LIMIT)
        try:
            self.call(data)
        except (Exception, Hang) as error:
            self._note(error, data)
        finally:
            signal.alarm(0)

    def _note(self, error: BaseException, data: bytes) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        robacc_frames = [frame for frame in frames if "robacc" in frame.filename] or frames
        place = f"{type(error).__name__} {Path(robacc_frames[-1].filename).name}:{robacc_frames[-1].lineno}"
        if place in self.findings:
            return
        self.findings.add(place)
        self.folder.mkdir(parents=True, exist_ok=True)
        name = f"{self.reader}-{hashlib.sha256(place.encode()).hexdigest()[:8]}"
        (self.folder / name).write_bytes(data)
        (self.folder / f"{name}.txt").write_text("".join(traceback.format_exception(error)))
        print(f"{self.reader}: {place}: {str(error)[:200]!r} -> {self.folder / name}", flush=True)


def _ring(_: int, __: FrameType | None) -> None:
    raise Hang


def _limits() -> None:
    signal.signal(signal.SIGALRM, _ring)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def blind(attack: Attack, seconds: float, seed: int) -> None:
    """Try random mutations of the seeds."""
    rng = random.Random(f"{attack.reader} {seed}")
    pool = seeds(attack.reader)
    mutate = mutate_json if pool[0].startswith(b"{") else mutate_text
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        data = rng.choice(pool)
        for _ in range(rng.choice((1, 1, 2))):
            data = mutate(data, rng)
        attack(data)
    print(f"{attack.reader}: {attack.cases} files, {len(attack.findings)} findings", flush=True)


def main() -> int:
    """Run the command line; return 1 where there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", choices=[*READERS, "all"])
    parser.add_argument("--seconds", type=float, default=60.0, help="for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, required=True, help="folder for files that make a reader fail")
    options = parser.parse_args()
    _limits()
    findings = 0
    for reader in READERS if options.reader == "all" else (options.reader,):
        attack = Attack(reader, options.keep)
        blind(attack, options.seconds, options.seed)
        findings += len(attack.findings)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
