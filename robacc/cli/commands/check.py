"""``robacc check``: check a stored result against a gate."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets


def check(
    call: Call, *, gate: Annotated[str, Help("Gate file (YAML) with the criteria.", "FILE")], outlets: Outlets
) -> None:
    """Check a stored result against a gate; exit 0: pass, 4: fail, 5: inconclusive.

    Example: robacc check result.json --gate gate.yaml
    """
    from robacc.cli.output import conclude

    outcome = call(gate=gate)
    conclude(outlets, "check", outcome.document(), None, outcome)
