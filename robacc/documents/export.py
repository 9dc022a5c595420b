"""Document of ``robacc export``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

from robacc.controllers.formats import ExportedModel


def export_payload(exported: ExportedModel, form: str) -> dict[str, Any]:
    """Return the keys of an export in the format ``form``."""
    remaining = exported.remaining
    return {
        "format": form,
        "file_sha256": hashlib.sha256(exported.text.encode()).hexdigest(),
        "urdf_sha256": None,
        "not_carried": list(exported.not_carried),
        "refitted": list(exported.refitted),
        "arm": exported.arm,
        "tool": {"xyz_m": list(exported.tool.xyz), "rpy_rad": list(exported.tool.rpy)},
        "remaining_error": {
            "n_poses": remaining.poses,
            "position": {"rms_m": remaining.position_rms, "max_m": remaining.position_max},
            "orientation": {"rms_rad": remaining.orientation_rms, "max_rad": remaining.orientation_max},
        },
    }


def urdf_payload(sha256: str, losses: Sequence[str]) -> dict[str, Any]:
    """Return the keys of a URDF whose numbers are not fitted again."""
    return {"format": "urdf", "file_sha256": sha256, "urdf_sha256": sha256, "not_carried": list(losses)}
