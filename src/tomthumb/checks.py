"""What goes into the loop is checked here: everything that cannot be, said in one line."""

from __future__ import annotations

import math

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.types import Array, Control, Observations


def check_step(index: int, t: float, last: float, control: Control | None, seen: Observations) -> None:
    """Everything that cannot be, said in one line. Raises `TomThumbError`."""
    if not math.isfinite(t):
        raise TomThumbError(f"step {index}: the time is {t}; it must be finite")
    if t < last:
        raise TomThumbError(f"step {index}: time runs back from {last:g} s to {t:g} s")
    if control is not None and not (np.isfinite(control.u).all() and math.isfinite(control.dt) and control.dt >= 0):
        raise TomThumbError(
            f"step {index}: the control {control.u} over {control.dt} s must be finite, its time not negative"
        )
    if control is not None and control.cov is not None and not _positive(control.cov, semi=True):
        raise TomThumbError(f"step {index}: the control's covariance is not positive semi-definite")
    check_observations(seen, f"step {index}")


def check_observations(seen: Observations, where: str) -> None:
    """Shapes, finite values, positive definite noise. Raises `TomThumbError`."""
    m = len(seen.z)
    if seen.z.shape != (m, 2) or seen.R.shape != (m, 2, 2):
        raise TomThumbError(f"{where}: z {seen.z.shape} and R {seen.R.shape} must be (m, 2) and (m, 2, 2)")
    if not m:
        return
    if not np.isfinite(seen.z).all():
        raise TomThumbError(f"{where}: observation {int(np.argwhere(~np.isfinite(seen.z))[0, 0])} is not finite")
    a, b, c, d = seen.R[:, 0, 0], seen.R[:, 0, 1], seen.R[:, 1, 0], seen.R[:, 1, 1]
    good = (a > 0) & (a * d - b * c > 0) & (np.abs(b - c) <= 1e-9 * (a + d))
    if not good.all():
        raise TomThumbError(f"{where}: the covariance of observation {int(np.argmin(good))} is not positive definite")


def _positive(matrix: Array, semi: bool = False) -> bool:
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
        return False
    low = float(np.linalg.eigvalsh(matrix)[0])
    return low >= -1e-12 * float(np.trace(matrix)) if semi else low > 0.0
