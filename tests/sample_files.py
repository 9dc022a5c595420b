"""Places of the sample data and of the robots beside the package, and files that tests write."""

import os
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SAMPLES, CONFIGS = ROOT / "sample_data", ROOT / "configs" / "robots"
POSES, ROBOT = SAMPLES / "poses.csv", SAMPLES / "robot.yaml"
TRACED_POSES, TRACED_ROBOT, TRUTH = (SAMPLES / "trace" / name for name in ("poses.csv", "robot.yaml", "truth.yaml"))
PUMA, SCARA, UR10 = (CONFIGS / f"{name}.yaml" for name in ("puma560", "scara", "ur10"))


def saved(path: Path, content: str | bytes) -> Path:
    """Write a file and return its path."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def agreed(name: str, text: str) -> str:
    """Return what is agreed in ``tests/golden``; with ``UPDATE_GOLDEN=1`` it is this text, a change to review."""
    path = ROOT / "tests" / "golden" / name
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(text, encoding="utf-8")
    return path.read_text(encoding="utf-8")


def rounded(text: str) -> str:
    """Return a text with its numbers to nine decimals; beyond them processors differ."""
    return re.sub(r"-?\d+\.\d+(?:e-?\d+)?", lambda number: f"{round(float(number[0]), 9) + 0.0}", text)
