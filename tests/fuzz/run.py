"""Attack the readers for as long as is wanted: ``python tests/fuzz/run.py READER --seconds N``.

READER is one of ``targets.READERS``, or ``all`` of them in turn. What makes robacc crash, hang or say nothing is kept
in ``--keep FOLDER``, once for each place that it comes from; the exit status is 1 where there is anything. With atheris
installed (``pip install atheris``), ``--guided`` lets the code that a file reaches guide the next one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FrameType

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, os.fspath(Path(__file__).parent))

LONGEST = 60
"""Seconds that one file may take."""
MEMORY = 6 * 2**30
"""Bytes of address space, of which the libraries take most."""


class Hang(BaseException):
    """A file took longer than LONGEST."""


class Attack:
    """One reader, and what was found of it."""

    def __init__(self, reader: str, keep: Path) -> None:
        self.reader, self.keep = reader, keep
        self.found: set[str] = set()
        self.cases = 0
        self.call: Callable[[bytes], None] = _targets().READERS[reader]

    def __call__(self, data: bytes) -> None:
        """Try one file; what goes wrong is kept."""
        self.cases += 1
        signal.alarm(LONGEST)
        try:
            self.call(data)
        except (Exception, Hang) as error:
            self._note(error, data)
        finally:
            signal.alarm(0)

    def _note(self, error: BaseException, data: bytes) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "robacc" in frame.filename] or frames
        place = f"{type(error).__name__} {Path(own[-1].filename).name}:{own[-1].lineno}"
        if place in self.found:
            return
        self.found.add(place)
        self.keep.mkdir(parents=True, exist_ok=True)
        name = f"{self.reader}-{hashlib.sha256(place.encode()).hexdigest()[:8]}"
        (self.keep / name).write_bytes(data)
        (self.keep / f"{name}.txt").write_text("".join(traceback.format_exception(error)))
        print(f"{self.reader}: {place}: {str(error)[:200]!r} -> {self.keep / name}", flush=True)


def _targets() -> object:
    import targets

    return targets


def _ring(_: int, __: FrameType | None) -> None:
    raise Hang


def _limits() -> None:
    signal.signal(signal.SIGALRM, _ring)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def blind(attack: Attack, seconds: float, seed: int) -> None:
    """Mutations of the seeds, and of what was made of them, by chance alone."""
    from mutations import of_text, of_tree
    from targets import seeds

    rng = random.Random(f"{attack.reader} {seed}")
    pool = list(seeds(attack.reader))
    mutate = of_tree if _is_tree(pool[0]) else of_text
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        data = rng.choice(pool)
        for _ in range(rng.choice((1, 1, 2))):
            data = mutate(data, rng)
        attack(data)
    print(f"{attack.reader}: {attack.cases} files, {len(attack.found)} findings", flush=True)


def guided(attack: Attack, seconds: float, seed: int) -> None:
    """The same mutations, led by coverage; ends the process."""
    import atheris

    with atheris.instrument_imports(include=["robacc", "yaml"]):
        import yaml  # noqa: F401
        from mutations import of_text, of_tree
        from targets import seeds

        attack.call = _targets().READERS[attack.reader]
    corpus = attack.keep / "corpus" / attack.reader
    corpus.mkdir(parents=True, exist_ok=True)
    for i, data in enumerate(seeds(attack.reader)):
        (corpus / f"seed{i}").write_bytes(data)
        mutate = of_tree if _is_tree(data) else of_text
        attack(data)

    def mutated(data: bytes, most: int, number: int) -> bytes:
        rng = random.Random(number)
        return (mutate(data, rng) if rng.random() < 0.8 else atheris.Mutate(data, most))[:most]

    options = [f"-max_total_time={seconds:.0f}", f"-seed={seed + 1}", "-max_len=2000000", "-len_control=0"]
    options += ["-rss_limit_mb=6000", f"-timeout={3 * LONGEST}", "-verbosity=0", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *options, os.fspath(corpus)], attack, custom_mutator=mutated)
    atheris.Fuzz()


def _is_tree(data: bytes) -> bool:
    try:
        return isinstance(json.loads(data), dict)
    except ValueError:
        return False


def main() -> int:
    """Run as the command line says; 1 where something was found."""
    from targets import READERS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", choices=[*READERS, "all"])
    parser.add_argument("--seconds", type=float, default=60.0, help="for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, required=True, help="folder for what is found")
    parser.add_argument("--guided", action="store_true")
    options = parser.parse_args()
    _limits()
    found = 0
    for reader in READERS if options.reader == "all" else (options.reader,):
        attack = Attack(reader, options.keep)
        (guided if options.guided else blind)(attack, options.seconds, options.seed)
        found += len(attack.found)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
