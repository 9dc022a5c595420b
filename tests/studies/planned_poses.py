#!/usr/bin/env python3
"""How much are planned poses worth: error after a fit to planned poses over the error after random ones, and the bound.

For each arm, `robacc plan` chooses poses from random candidates. The predicted error over the candidates' region is
computed here, from derivatives of this folder, and compared with random candidates in the same number; below 1 is
better. `refined` starts from the planned poses and moves them continuously within the joint ranges. `bound` is the
least ratio that any choice of that many of these candidates can reach: the optimum over weights (V. V. Fedorov,
"Theory of Optimal Experiments", 1972), less its duality gap.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import tool
from arm import ARMS, Setup, read_csv, write_poses, write_robot

EFFECTS = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
RANDOM_DRAWS = 20


class Task:
    """Rows of the identifiable directions at N candidates, and the criterion: mean variance over all of them."""

    def __init__(self, setup: Setup, q: np.ndarray) -> None:
        self.setup, self.mask = setup, setup.declared(EFFECTS)
        self.nominal = np.zeros(len(setup.names))
        flat = self._jacobian(q)
        _, singular, rows = np.linalg.svd(flat, full_matrices=False)
        rank = int(np.sum(singular > 1e-9 * singular[0]))
        # Coordinates in which the mean over the region is the trace: W is the unit matrix.
        self.map = rows[:rank].T / singular[:rank] * np.sqrt(len(q))
        self.rows = self.of(q)

    def _jacobian(self, q: np.ndarray) -> np.ndarray:
        return self.setup.jacobian(self.nominal, q, self.mask)

    def of(self, q: np.ndarray) -> np.ndarray:
        """Return rows (N, 3, R) of poses."""
        return (self._jacobian(q) @ self.map).reshape(len(q), 3, -1)

    def error(self, rows: np.ndarray) -> float:
        """Return the RMS error over the region after a fit to poses with these rows, in units of the noise."""
        flat = rows.reshape(-1, rows.shape[2])
        return float(np.sqrt(np.trace(np.linalg.inv(flat.T @ flat))))


def bound(rows: np.ndarray, count: int, steps: int) -> float:
    """Return the least RMS error of ``count`` poses in any proportions, less the duality gap."""
    n = len(rows)
    weights = np.full(n, 1.0 / n)
    best = 0.0
    for _ in range(steps):
        inverse = np.linalg.inv(np.einsum("n,nip,niq->pq", weights, rows, rows))
        # Minus the derivative of the trace to each weight; its weighted mean is the trace itself.
        slope = np.sum(np.square(rows @ inverse), axis=(1, 2))
        value = float(np.trace(inverse))
        # 1 / trace is concave in the information: no design exceeds the tangent, max slope / value^2.
        best = max(best, value**2 / float(slope.max()))
        weights *= np.sqrt(slope / value)
        weights /= weights.sum()
    return float(np.sqrt(best / count))


def refined(task: Task, q: np.ndarray, trials: int, rng: np.random.Generator) -> float:
    """Return the error after random moves of single poses within the joint ranges; a move stays where it is better."""
    low, high = task.setup.span.T
    q, rows = q.copy(), task.of(q)
    error = task.error(rows)
    for trial in range(trials):
        i = trial % len(q)
        step = (high - low) * 10.0 ** rng.uniform(-3, -0.5) * rng.normal(size=q.shape[1])
        moved = np.clip(q[i] + step * (rng.random(q.shape[1]) < 0.5), low, high)
        trial_rows = rows.copy()
        trial_rows[i] = task.of(moved[None])[0]
        value = task.error(trial_rows)
        if value < error:
            q[i], rows, error = moved, trial_rows, value
    return error


def planned(setup: Setup, q: np.ndarray, options: argparse.Namespace, folder: Path) -> np.ndarray:
    """Return the numbers of the candidates that the tool plans."""
    robot, candidates, plan = folder / "robot.yaml", folder / "candidates.csv", folder / "plan.csv"
    write_robot(setup.arm, robot, masses=False)
    write_poses(candidates, q, np.zeros((len(q), 3)), {"pose": [str(i) for i in range(len(q))]})
    words = [*tool.command(options), "plan", str(robot), "--for", "calibrate", "--poses", str(options.poses)]
    words += ["--candidates", str(candidates), "--task", str(candidates), "--noise", "0.05mm", "--margin", "0"]
    words += ["--repeatability", "0mm", "--repeats", "0", "--check-every", "0", "--output", str(plan)]
    subprocess.run(words, check=True, capture_output=True, text=True, timeout=options.limit)
    return np.array([int(number) for number in read_csv(plan)["pose"]])


def run_arm(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Compare the choices on one arm, as shares of the mean error of random poses."""
    setup, rng = Setup(ARMS[name]), tool.generator(f"planned poses {name}")
    q = rng.uniform(*setup.span.T, (options.candidates, setup.n))
    task = Task(setup, q)
    random = [rng.choice(len(q), options.poses, replace=False) for _ in range(RANDOM_DRAWS)]
    mean = float(np.mean([task.error(task.rows[at]) for at in random]))
    with tool.folder_of(name, options) as folder:
        chosen = planned(setup, q, options, folder)
    errors = {
        "planned": task.error(task.rows[chosen]),
        "refined": refined(task, q[chosen], options.trials, rng),
        "bound": bound(task.rows, options.poses, options.steps),
    }
    return {"name": name, **{key: value / mean for key, value in errors.items()}}


def main() -> int:
    """Compare the choices on the arms."""
    parser = tool.arguments(__doc__, 1)
    parser.add_argument("--poses", type=int, default=30)
    parser.add_argument("--candidates", type=int, default=1000)
    parser.add_argument("--trials", type=int, default=6000, help="moves of the refinement (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=60, help="steps towards the bound (default: %(default)s)")
    options = parser.parse_args()
    return tool.run_all(list(ARMS), options, run_arm, lambda rows: summary(rows, options.poses))


def summary(rows: list[dict[str, Any]], poses: int) -> dict[str, Any]:
    """Print the table."""
    keys = ("planned", "refined", "bound")
    print(f"error over that of {poses} random poses (mean of {RANDOM_DRAWS} draws)")
    print(tool.table(("arm", *keys), [(row["name"], *(f"{row[key]:.3f}" for key in keys)) for row in rows]))
    return {}


if __name__ == "__main__":
    sys.exit(main())
