"""The effect that a how-to page adds passes the checks that every effect of the catalogue passes."""

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from arms import arm
from sample_files import saved

from robacc.effects import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "docs" / "tools"), str(ROOT / "tests" / "effects")]

import test_effects_contract as contract  # noqa: E402
from transcripts import blocks  # noqa: E402

PAGE = ROOT / "docs" / "how-to" / "own-effect.md"
NAME = "zero_drift"


@pytest.fixture(autouse=True)
def _registered(tmp_path: Path) -> Iterator[None]:
    """The page's file, imported as its reader would."""
    known = dict(REGISTRY)
    (source,) = (block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.file == f"{NAME}.py")
    spec = importlib.util.spec_from_file_location(NAME, saved(tmp_path / f"{NAME}.py", source))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    try:
        spec.loader.exec_module(module)
        yield
    finally:
        REGISTRY.clear()
        REGISTRY.update(known)
        del sys.modules[NAME]


def values_of(check: object, argument: str) -> tuple[object, ...] | None:
    """Values that a check is parametrised by."""
    for mark in getattr(check, "pytestmark", ()):
        if mark.name == "parametrize" and mark.args[0] == argument:
            return tuple(mark.args[1])
    return None


def checks() -> list[str]:
    """Checks of the contract that run over the whole registry."""
    return [name for name, check in vars(contract).items() if values_of(check, "name") == contract.EFFECTS]


@pytest.mark.parametrize("name", checks())
def test_the_effect_of_the_page_keeps_the_contract(name: str) -> None:
    check = getattr(contract, name)
    arms: tuple[object, ...] = values_of(check, "arm_name") or tuple(arm(known) for known in contract.ARMS)
    if check.__code__.co_argcount == 1:
        check(NAME)
    else:
        for second in arms:
            check(NAME, second)


def test_the_contract_has_checks() -> None:
    assert len(checks()) >= 8
