"""Print statements, functions, classes and modules of each room of the package: ``python tests/tools/size.py``.

Exits with 1 if the package has more statements than :data:`MOST`, which only goes down.
"""

import ast
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2] / "robacc"
MOST = 22_280
"""Statements of the package, docstrings apart."""


def counted(path: Path) -> Counter[str]:
    """Count a module."""
    counts = Counter(modules=1)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        is_text = (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        )
        counts["statements"] += isinstance(node, ast.stmt) and not is_text
        counts["functions"] += isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        counts["classes"] += isinstance(node, ast.ClassDef)
    return counts


def main() -> int:
    """Print the table and return the exit status."""
    rooms: dict[str, Counter[str]] = {}
    for path in sorted(ROOT.rglob("*.py")):
        rooms.setdefault(path.relative_to(ROOT).parts[0], Counter()).update(counted(path))
    total = sum(rooms.values(), Counter())
    kinds = ("statements", "functions", "classes", "modules")
    for name, counts in [*sorted(rooms.items(), key=lambda room: -room[1]["statements"]), ("total", total)]:
        print(f"{name:20}", *(f"{counts[kind]:7d} {kind}" for kind in kinds))
    print(f"at most {MOST} statements")
    return int(total["statements"] > MOST)


if __name__ == "__main__":
    sys.exit(main())
