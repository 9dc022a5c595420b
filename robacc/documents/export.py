"""Document of ``robacc export``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from robacc.documents.keys import Key, array, digest, number, ordinal, part, text

if TYPE_CHECKING:
    pass

EXPORT = part(
    {
        "format": Key(text, "Format of the written file: urdf, mdh, json, ur-calibration …"),
        "file_sha256": Key(
            digest, "SHA-256 of the written file.", lambda exported: hashlib.sha256(exported.text.encode()).hexdigest()
        ),
        "urdf_sha256": Key(
            digest | None,
            "SHA-256 of the URDF if one was written; null for a file of another format.",
            lambda _: None,
        ),
        "not_carried": Key(array(text), "Parts of the model that the format cannot represent."),
        "refitted": Key(
            array(text),
            "Effects that the format lacks and that its numbers take up as far as they can, by another fit.",
            optional=True,
        ),
        "arm": Key(
            text | None, "Arm of Universal Robots that the differences refer to; null for other formats.", optional=True
        ),
        "tool": Key(
            part(
                {
                    "xyz_m": Key(array(number), "Place, m."),
                    "rpy_rad": Key(array(number), "Roll, pitch and yaw about fixed axes, rad."),
                }
            ),
            "Measured target in the last frame of the format, to be set as the tool of the controller.",
            optional=True,
        ),
        "remaining_error": Key(
            part(
                {
                    "n_poses": Key(ordinal, "Number of poses.", "poses"),
                    "position": Key(
                        part(
                            {
                                "rms_m": Key(number, "Root mean square, m.", "position_rms"),
                                "max_m": Key(number, "Largest distance, m.", "position_max"),
                            }
                        ),
                        "Distance between the target's positions.",
                        "",
                    ),
                    "orientation": Key(
                        part(
                            {
                                "rms_rad": Key(number, "Root mean square, rad.", "orientation_rms"),
                                "max_rad": Key(number, "Largest angle, rad.", "orientation_max"),
                            }
                        ),
                        "Angle between the target's orientations.",
                        "",
                    ),
                }
            ),
            "Difference between the model and what the format holds, over poses within the joint limits.",
            "remaining",
            optional=True,
        ),
    },
    about="Export of a model for a controller, a driver or a simulator.",
)


def urdf_payload(sha256: str, losses: Sequence[str]) -> dict[str, Any]:
    """Return the keys of a URDF whose numbers are not fitted again."""
    return {"format": "urdf", "file_sha256": sha256, "urdf_sha256": sha256, "not_carried": list(losses)}
