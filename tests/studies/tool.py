"""Running robacc, and the few figures that every study prints."""

import argparse
import contextlib
import json
import math
import os
import re
import shlex
import subprocess
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from arm import Setup
from least_squares import fit, identifiable


@dataclass(frozen=True)
class Answer:
    """What one command returned: the JSON document, or why there is none."""

    status: int
    result: dict[str, Any] | None
    error: str
    seconds: float


def run(command: Sequence[str], limit: float) -> Answer:
    """Run one command with ``--format json`` on one thread."""
    start = time.perf_counter()
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [*command, "--format", "json"], capture_output=True, text=True, timeout=limit, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        return Answer(124, None, f"no answer in {limit:.0f} s", limit)
    seconds = time.perf_counter() - start
    try:
        return Answer(done.returncode, json.loads(done.stdout), done.stderr.strip(), seconds)
    except json.JSONDecodeError:
        return Answer(done.returncode, None, (done.stderr.strip() or "no JSON")[-300:], seconds)


def generator(name: str) -> np.random.Generator:
    """The random numbers of the set of this name: the same on every machine and whatever else is run."""
    return np.random.default_rng(zlib.crc32(name.encode()))


def arguments(description: str | None, seeds: int | None) -> argparse.ArgumentParser:
    """Options that every study has."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robacc", default="robacc", help="command to run (default: %(default)s)")
    parser.add_argument(
        "--seeds", type=int, default=seeds, help="sets for each cell of the design (default: %(default)s)"
    )
    parser.add_argument("--first-seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", default="", help="regular expression on the names of sets; several with a space")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write summary and rows there")
    parser.add_argument("--limit", type=float, default=600, metavar="S", help="seconds for one command")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the files of each set there")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="append each set as it is done; skip those there")
    parser.add_argument("--summary", action="store_true", help="print the figures of the sets in --rows, run none")
    parser.add_argument("--list", action="store_true", help="print the names of the sets and end")
    parser.add_argument("-v", action="store_true", help="print a line for each set")
    return parser


def chosen(names: Sequence[str], options: argparse.Namespace) -> list[str]:
    """The sets to run."""
    patterns = [re.compile(part) for part in options.only.split()]
    return [name for name in names if all(pattern.search(name) for pattern in patterns)]


def earlier(path: Path | None) -> dict[str, dict[str, Any]]:
    """The sets that a file of rows has already, by name; a line that was cut off is no set."""
    rows = {}
    if path and path.exists():
        for line in path.read_text().splitlines():
            with contextlib.suppress(json.JSONDecodeError):
                row = json.loads(line)
                rows[row["name"]] = row
    return rows


def command(options: argparse.Namespace) -> list[str]:
    """The tool's own words."""
    return shlex.split(options.robacc)


def intervals(
    setup: Setup,
    answer: Mapping[str, Any],
    q: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
    tolerance: float,
) -> list[dict[str, Any]]:
    """Each declared coefficient's estimate, standard error and truth, where the truth is well defined.

    robacc holds coefficients that the poses cannot identify (``std`` null) at their value and the others make up for
    them. Their truth is what noise-free measurements of the same poses give with the same ones held. Where
    that leaves more than ``tolerance`` m, something identifiable was held: then only coefficients count that no
    combination of the others can stand for, with their plain truth. Frames are reported as they stand, the rest as
    differences from the robot file.
    """
    index = {name: i for i, name in enumerate(setup.names)}
    nominal = {name: 0.0 for name in setup.names}
    nominal |= dict(zip(setup.names[6:9], setup.arm.tool.tolist(), strict=True))
    given = {p["name"]: p for p in answer["parameters"] if p["name"] in index and p.get("std") is not None}
    free = np.zeros(len(truth), bool)
    free[[index[name] for name in given]] = True
    twin = fit(setup, q, setup.positions(truth, q), free, cutoff=1e-12)
    wanted = dict(zip(setup.names, twin.values, strict=True))
    counted = set(given)
    if twin.rms > tolerance:
        wanted = dict(zip(setup.names, truth, strict=True))
        names = np.array(setup.names)[mask]
        counted &= set(names[identifiable(setup.jacobian(truth, q, mask))])
    return [
        {"name": name, "value": p["value"] - nominal[name], "std": p["std"], "truth": float(wanted[name])}
        for name, p in given.items()
        if name in counted and mask[index[name]]
    ]


def covered(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """Whether value ± 1.96 std holds the truth; 1e-12 stands for rounding in files."""
    return [bool(abs(row["value"] - row["truth"]) <= 1.96 * row["std"] + 1e-12) for row in rows]


def wilson(hits: int, n: int) -> tuple[float, float]:
    """The 95 % score interval of a share."""
    if not n:
        return 0.0, 1.0
    z, share = 1.96, hits / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def coverage(sets: Sequence[Sequence[bool]]) -> tuple[float, float, float, int]:
    """Share of intervals that hold the truth, its 95 % bounds (the set is the unit, not the interval), their number."""
    lists = [flags for flags in sets if flags]
    n = sum(map(len, lists))
    if not n:
        return math.nan, 0.0, 1.0, 0
    share = sum(map(sum, lists)) / n
    if len(lists) < 2:
        return share, 0.0, 1.0, n
    spread = sum((sum(flags) - share * len(flags)) ** 2 for flags in lists) * len(lists) / (len(lists) - 1)
    half = 1.96 * max(math.sqrt(spread) / n, math.sqrt(0.95 * 0.05 / n))
    return share, share - half, share + half, n


def claim(words: str, low: float, high: float, allowed: tuple[float, float]) -> str:
    """Whether the bounds of a figure hold, refute or leave open a claim."""
    if low > allowed[1] or high < allowed[0]:
        outcome = "REFUTED"
    elif low >= allowed[0] and high <= allowed[1]:
        outcome = "holds"
    else:
        outcome = "open: more sets decide"
    return f"{words}: {outcome}"


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Columns padded to their widest cell."""
    cells = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    return "\n".join("  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)) for row in cells)


def percent(share: float) -> str:
    """A share in percent, or a dash."""
    return "-" if math.isnan(share) else f"{100 * share:.1f} %"


def median(numbers: Sequence[float]) -> float:
    """Median, or not a number where there is none."""
    return float(np.median(numbers)) if len(numbers) else math.nan


def groups(rows: Sequence[dict[str, Any]], key: Callable[[dict[str, Any]], str]) -> dict[str, list[dict[str, Any]]]:
    """Rows by key, in the order of appearance."""
    out: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        out.setdefault(key(row), []).append(row)
    return out


def shown(row: Mapping[str, Any]) -> str:
    """One set in a line."""
    return str({key: value for key, value in row.items() if key not in ("covered", "covered_zeros", "missed")})


def run_all(
    names: Sequence[str],
    options: argparse.Namespace,
    run_set: Callable[[str, argparse.Namespace], dict[str, Any]],
    summary: Callable[[list[dict[str, Any]]], Mapping[str, Any]],
    shown: Callable[[dict[str, Any]], str] = shown,
) -> int:
    """Run each chosen set that ``--rows`` lacks and print the summary of those with a result; ``--list``: names alone.

    The exit status is 1 where a set gave no result.
    """
    names = chosen(names, options)
    if options.list:
        print("\n".join(names))
        return 0
    rows, before = [], earlier(options.rows)
    for name in names:
        if name in before:
            rows.append(before[name])
        elif not options.summary:
            rows.append(run_set(name, options))
            if options.rows:
                with options.rows.open("a") as file:
                    file.write(json.dumps(rows[-1], default=float) + "\n")
            if options.v:
                print(shown(rows[-1]), flush=True)
    good = [row for row in rows if not row.get("error")]
    figures = summary(good) if good else {}
    if options.json:
        text = json.dumps({"summary": {"sets": len(rows), **figures}, "rows": rows}, indent=1, default=float)
        options.json.write_text(text)
    failed = [row for row in rows if row.get("error")]
    for row in failed:
        print(f"no result: {row['name']}: {row['error']}")
    return int(bool(failed))


@contextlib.contextmanager
def folder_of(name: str, options: argparse.Namespace) -> Iterator[Path]:
    """A folder for the files of a set, kept with ``--keep``."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.keep / name) if options.keep else Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        yield folder


def fit_and_test(ask: Sequence[str], folder: Path, options: argparse.Namespace) -> tuple[Answer, Answer | None]:
    """The result of a command with its effects, and the errors of its model at the poses of ``test.csv`` if there."""
    words, model = command(options), folder / "model.yaml"
    model.unlink(missing_ok=True)
    asked = [*words, ask[0], str(folder / "poses.csv"), "--robot", str(folder / "robot.yaml"), *ask[1:], "--seed", "0"]
    answer = run([*asked, "--write-model", str(model)], options.limit)
    if not (folder / "test.csv").exists():
        return answer, None
    return answer, run([*words, "estimate", str(folder / "test.csv"), "--robot", str(model)], options.limit)


def seeds_of(options: argparse.Namespace) -> range:
    """Numbers of the sets of each cell of the design."""
    return range(options.first_seed, options.first_seed + options.seeds)


def rms(errors: np.ndarray) -> float:
    """Root mean square of the length of errors (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def pooled(sizes: Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(sizes))))


def mean_ratio(ratios: Sequence[float]) -> tuple[float, float, float]:
    """Geometric mean and its 95 % bounds."""
    logs = np.log(ratios)
    half = 1.96 * float(np.std(logs, ddof=1)) / np.sqrt(len(logs)) if len(logs) > 1 else np.inf
    middle, low, high = (float(np.exp(np.mean(logs) + h)) for h in (0.0, -half, half))
    return middle, low, high
