"""``robacc predict``: accuracy predicted from parameter tolerances, and compared with measured poses."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets


def predict(
    call: Call,
    *,
    per_pose: Annotated[
        str | None, Help("CSV to write with the prediction at each pose.", "FILE", holds="output")
    ] = None,
    warranty_map: Annotated[
        str | None, Help("CSV to write with the errors and the grade by voxel.", "FILE", holds="output")
    ] = None,
    voxel: Annotated[str, Help("Edge of a voxel of `warranty_map`, such as 50mm.", "SIZE")] = "100mm",
    outlets: Outlets,
) -> None:
    """Predict covariances, error budget and grade from parameter tolerances or the fit of a model file.

    The prediction is for the joints of --poses, else of --against, else for configurations over the joint ranges. With
    a model that --write-model wrote, it is for the calibrated arm; with --tolerances, it is for arms made with these
    tolerances.

    Example: robacc predict robot.yaml --tolerances tolerances.yaml --allocate C
    """
    from robacc.cli.output import deliver
    from robacc.io.files import write_text
    from robacc.render.views.elements import draw
    from robacc.render.views.expected import prediction_view

    result = call()
    if warranty_map is not None:
        write_text(warranty_map, result.map_csv(voxel))
    if per_pose is not None:
        write_text(per_pose, result.per_pose_csv())
    source = "" if result.comparison is None else result.comparison.source
    deliver(outlets, result, lambda stream: draw(prediction_view(result.payload(), source, "full"), stream))
