"""Options that `calibrate` and `trace` have in common."""

from __future__ import annotations

from typing import Annotated

import typer

NeededRobotOption = Annotated[
    str, typer.Option("--robot", metavar="FILE", help="Robot file (YAML) or URDF that commanded the poses.")
]
WriteModelOption = Annotated[
    str | None,
    typer.Option("--write-model", metavar="FILE", help="Write the robot file that predicts what was fitted."),
]
HoldoutOption = Annotated[
    str | None, typer.Option("--holdout", metavar="FILE", help="Poses of their own to judge on, instead of folds.")
]
FoldsOption = Annotated[
    int, typer.Option("--folds", metavar="K", min=2, max=50, help="Folds of cross-fitting: poses held out in turn.")
]
