"""Residuals that repeat: how much of a scan is news, measured from the correlation of successive residuals.

The residuals of a filter that is told the truth about its sensor are white: what one scan shows says nothing about the
error of the next. Where a landmark's residual is like its last one, with correlation rho, N scans tell no more than
N (1 - rho) / (1 + rho) independent ones (noise of first order), so R is multiplied by (1 + rho) / (1 - rho).

References: R. Mehra, IEEE T-AC 15(2), 1970 (whiteness of the innovations); Y. Bar-Shalom, X. R. Li, T. Kirubarajan,
"Estimation with Applications to Tracking and Navigation", 2001, sec. 5.4.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tomthumb.types import Array, Ids

DEAD = 0.2  # correlation below which nothing is done: that of white noise over 100 pairs is below it (2 sigma)
MOST = 0.98  # and no more than this is believed
PRIOR = 100.0  # white pairs that the estimate starts from


@dataclass(slots=True)
class Echo:
    """`last (n, 2)`: each slot's last residual in standard deviations of R, NaN for none; sums of products and squares."""

    last: Array = field(default_factory=lambda: np.empty((0, 2)))
    product: Array = field(default_factory=lambda: np.zeros(2))
    square: Array = field(default_factory=lambda: np.full(2, PRIOR))

    @property
    def rho(self) -> Array:
        """Correlation (2,) of successive residuals of a landmark, by component; 0 where it may be chance."""
        rho: Array = np.minimum(self.product / self.square, MOST)
        return np.where(rho > DEAD, rho, 0.0)


def listen(e: Echo, slots: Ids, residual: Array) -> Array:
    """Residuals (m, 2) of the landmarks in `slots` (m,; -1 none) are taken in; factors (2,) that their variances deserve."""
    held = slots >= 0
    slots, residual = slots[held], residual[held]
    if len(slots) and int(slots.max()) >= len(e.last):
        more = max(int(slots.max()) + 1 - len(e.last), 64, len(e.last) // 2)
        e.last = np.concatenate([e.last, np.full((more, 2), np.nan)])
    before = e.last[slots]
    again = np.isfinite(before[:, 0])
    e.product += (residual[again] * before[again]).sum(0)
    e.square += (residual[again] ** 2).sum(0)
    e.last[slots] = residual
    raised: Array = (1.0 + e.rho) / (1.0 - e.rho)
    return raised


def forget(e: Echo, slot: int) -> None:
    """A slot whose landmark is gone: the next one in it begins anew."""
    if slot < len(e.last):
        e.last[slot] = np.nan


def copy(e: Echo) -> Echo:
    """A copy that shares nothing."""
    return Echo(e.last.copy(), e.product.copy(), e.square.copy())
