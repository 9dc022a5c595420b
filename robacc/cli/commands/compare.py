"""``robacc compare``: compare stored results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets


def compare(
    call: Call,
    *,
    paired: Annotated[bool, Help("Compare two CSVs of the same targets, before and after a correction.")] = False,
    model: Annotated[str | None, Help("With `paired`: model of the correction.", "FILE")] = None,
    nominal: Annotated[str | None, Help("With `paired`: nominal robot, for CSVs without cmd_ columns.", "FILE")] = None,
    noise: Annotated[str | None, Help("With `paired`: measurement noise along each axis.", "SIZE")] = None,
    outlets: Outlets,
) -> None:
    """Compare stored results: significant differences, ranking and confirmed grades.

    Differences are paired if the results have the same poses. --paired compares two CSVs of the same targets, measured
    before and after a correction: the gain, what remains, and whether the correction was loaded.

    Example: robacc compare arm1.json arm2.json --grade D
    """
    from robacc.api.compare import compare_paired
    from robacc.cli.output import deliver
    from robacc.render.views.compare import comparison_view, paired_view
    from robacc.render.views.elements import draw

    given = call.keywords
    stored = {name: given.get(name) for name in ("baseline", "by", "grade", "scale")}
    if _is_paired(
        paired,
        call.args,
        {"model": model, "nominal": nominal, "noise": noise},
        {**stored, "gate": outlets.gate, "report": outlets.report},
    ):
        names = call.args[0], call.args[1]
        changes = compare_paired(*names, model=model, nominal=nominal, noise=noise)
        deliver(outlets, changes, lambda stream: draw(paired_view(changes.payload(), names), stream))
        return
    result = call()
    deliver(outlets, result, lambda stream: draw(comparison_view(result.payload()), stream))


def _is_paired(
    paired: bool,
    results: Sequence[str],
    paired_options: Mapping[str, str | None],
    stored_options: Mapping[str, str | None],
) -> bool:
    """Return whether the call compares targets before and after a correction.

    Raises:
        UsageError: The options do not fit together.
    """
    from robacc.errors import UsageError

    if not paired:
        for name, value in paired_options.items():
            if value is not None:
                raise UsageError(f"--{name} needs --paired")
        return False
    if len(results) != 2:
        raise UsageError(f"--paired compares two CSVs, before and after a correction, found {len(results)}")
    for name, value in stored_options.items():
        if value is not None:
            raise UsageError(f"--{name} compares stored results; leave it out with --paired")
    return True
