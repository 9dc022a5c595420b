"""Imports point one way: each module may use its own layer and those below it, and nothing above."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "robacc"

LAYERS = (
    ("robacc.errors", "robacc.version"),
    ("robacc.geometry", "robacc.plug_ins", "robacc.quantities", "robacc.workers"),
    ("robacc.io",),
    ("robacc.measurements", "robacc.statistics"),
    ("robacc.poses",),
    ("robacc.robots",),
    ("robacc.programs",),
    ("robacc.gravity",),
    ("robacc.effects",),
    ("robacc.modelling",),
    ("robacc.fitting",),
    ("robacc.error_model",),
    ("robacc.accuracy",),
    ("robacc.simulation", "robacc.diagnostics"),
    ("robacc.tracing",),
    ("robacc.correction", "robacc.exporters", "robacc.iso_9283", "robacc.prediction"),
    ("robacc.planning",),
    ("robacc.comparison", "robacc.gates"),
    ("robacc.documents",),
    ("robacc.history",),
    ("robacc.render.text",),
    ("robacc.render.views",),
    ("robacc.render.plots",),
    ("robacc.render.page",),
    ("robacc.render",),
    ("robacc.api",),
    ("robacc.cli",),
    ("robacc", "robacc.__main__"),
)
"""From the ground up. A package stands for all of its modules."""
PLACES = {name: number for number, names in enumerate(LAYERS) for name in names}
OPENS_FILES = (
    "robacc.io.",
    "robacc.documents.envelope",
    "robacc.documents.accuracy",
    "robacc.documents.envelope",
    "robacc.history",
    "robacc.modelling.robot_file",
    "robacc.programs.program",
    "robacc.poses.cameras",
    "robacc.poses.reading",
    "robacc.api.",
    "robacc.cli.",
)
"""Modules that name a file to read or write; all but those of io do so through io."""
FILE_CALLS = {"open", "read_text", "write_text", "read_bytes", "write_bytes"}


@cache
def modules() -> dict[str, Path]:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of this package that a file imports, inside functions and for type checking too."""
    found = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                member = f"{node.module}.{alias.name}"
                found.add(member if member in known else str(node.module))
    return {name for name in found if name == "robacc" or name.startswith("robacc.")}


def layer(module: str) -> int:
    """The layer of a module, or of the nearest package around it that has one."""
    name = module
    while name not in PLACES:
        assert "." in name.removeprefix("robacc."), f"{module} has no layer; give it one in {__name__}.LAYERS"
        name = name.rpartition(".")[0]
    return PLACES[name]


def test_imports_point_down() -> None:
    known = modules()
    above = {
        (module, name) for module in known for name in imports(known[module], known) if layer(name) > layer(module)
    }
    assert not above, "modules import from layers above their own"


def test_no_import_goes_round_in_a_circle() -> None:
    known = modules()
    graph = {name: imports(path, known) - {name} for name, path in known.items()}
    TopologicalSorter(graph).prepare()


def test_the_package_does_not_know_its_plug_ins() -> None:
    for module, path in modules().items():
        assert "robacc_plugins" not in path.read_text(encoding="utf-8"), module


def test_reports_and_files_leave_each_other_alone() -> None:
    known = modules()
    for module, path in known.items():
        for one, other in (("robacc.documents", "robacc.render"), ("robacc.render", "robacc.documents")):
            if module.startswith(f"{one}."):
                assert not any(name.startswith(other) for name in imports(path, known)), module


def test_the_checks_see_a_wrong_import(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("def f():\n    from robacc.cli import main\n", encoding="utf-8")
    assert imports(wrong, modules()) == {"robacc.cli.main"}
    assert layer("robacc.cli.main") > layer("robacc.render.text") > layer("robacc.geometry")


def test_only_io_opens_files() -> None:
    for module, path in modules().items():
        if module.startswith(OPENS_FILES):
            continue
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Call):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                assert name not in FILE_CALLS, f"{module} line {node.lineno} opens a file"


def test_the_command_line_starts_without_numpy() -> None:
    names = [name for name in modules() if name.startswith("robacc.cli.")]
    code = f"import sys, {', '.join(names)}; print([m for m in ('numpy', 'yaml', 'scipy') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent, check=True)
    assert run.stdout.strip() == "[]"
