"""``robacc compare``: compare stored results."""

from __future__ import annotations

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
    """Compare stored results or files of poses: significant differences, ranking and confirmed grades.

    Differences are paired if the results have the same poses. Files of poses are estimated first, as robacc estimate
    does with --robot and --align. A prediction is not ranked with measured arms.

    --paired compares two CSVs of the same targets, measured before and after a correction: the gain, what remains, and
    whether the correction was loaded.

    Example: robacc compare arm1.json arm2.json --grade D
    """
    from robacc.api.compare import compare_paired
    from robacc.cli.output import deliver
    from robacc.errors import UsageError
    from robacc.render.views.compare import comparison_view, paired_view
    from robacc.render.views.elements import draw

    targets = {"model": model, "nominal": nominal, "noise": noise}
    stored = {name: call.keywords.get(name) for name in ("baseline", "by", "grade", "scale", "robot", "align")}
    stored |= {"gate": outlets.gate, "report": outlets.report}
    for name, value in (stored if paired else targets).items():
        if value is not None:
            why = "compares stored results; leave it out with --paired" if paired else "needs --paired"
            raise UsageError(f"--{name} {why}")
    if paired:
        if len(call.args) != 2:
            raise UsageError(f"--paired compares two CSVs, before and after a correction, found {len(call.args)}")
        changes = compare_paired(*call.args, model=model, nominal=nominal, noise=noise)
        deliver(outlets, changes, lambda stream: draw(paired_view(changes.payload(), call.args), stream))
        return
    result = call()
    deliver(outlets, result, lambda stream: draw(comparison_view(result.payload(), "full"), stream))
