"""Plans with fewer measured coordinates than the fit has coefficients."""

from __future__ import annotations

import math


def too_few_warning(n_poses: int, n_known: int, components: int, n_coefficients: int) -> tuple[str, ...]:
    """Return a warning about a plan that cannot determine its fit; nothing if it can.

    Args:
        n_poses: Planned poses.
        n_known: Poses that are measured already.
        components: Measured coordinates of a pose: 3 of a position, 6 with the orientation.
        n_coefficients: Coefficients that the feasible poses identify.
    """
    measured = components * (n_poses + n_known)
    if measured >= n_coefficients:
        return ()
    enough = math.ceil(n_coefficients / components) - n_known
    return (
        f"{n_poses + n_known} pose{'s' * (n_poses + n_known != 1)} measure {measured} coordinates, fewer than the "
        f"{n_coefficients} coefficients of the fit: the fit would stay near the nominal model in some directions and "
        f"be arbitrary in others; plan at least {enough} poses, and more for a check on held-out poses",
    )
