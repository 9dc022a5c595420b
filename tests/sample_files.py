"""Places of the sample data and of the robots beside the package, and files that tests write."""

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
