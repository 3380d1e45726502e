"""Does the filter know how wrong it is? NEES of the pose and NIS of the innovations, with their chi-square bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.geometry import wrap
from tomthumb.types import Array, Ids, Mask


@dataclass(frozen=True)
class Consistency:
    """`mean`, the `low` and `high` ends of its 95 % band, and the share of steps `inside` their own; NaN if unknown."""

    mean: float
    low: float
    high: float
    inside: float


def chi2_band(dof: float, runs: int = 1, level: float = 0.95) -> tuple[float, float]:
    """Two-sided interval for the average of `runs` independent chi-square values of `dof` degrees of freedom.

    References: Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
    """
    tail = 0.5 * (1.0 - level)
    return float(chdtri(dof * runs, 1.0 - tail)) / runs, float(chdtri(dof * runs, tail)) / runs


SINGULAR = 1e-10  # least over greatest eigenvalue: a robot that starts exactly known has no error to speak of sideways


def nees(pose: Array, cov: Array, truth: Array) -> Array:
    """Squared errors of the poses (K, 3) by their own covariances (K, 3, 3); NaN where either is not to be had."""
    error = pose - truth
    error[:, 2] = wrap(error[:, 2])
    values = np.full(len(pose), np.nan)
    finite = np.flatnonzero(np.isfinite(error).all(1) & np.isfinite(cov).all((1, 2)))
    spread = np.linalg.eigvalsh(cov[finite])
    usable = finite[spread[:, 0] > SINGULAR * spread[:, 2]]
    values[usable] = np.einsum("ki,ki->k", error[usable], np.linalg.solve(cov[usable], error[usable, :, None])[..., 0])
    return values


def pose_consistency(pose: Array, cov: Array, truth: Array, scored: Mask) -> Consistency:
    """Average NEES of the pose, 3 degrees of freedom. The band is that of one value: a run's errors are correlated."""
    values = nees(pose, cov, truth)[scored]
    values = values[np.isfinite(values)]
    low, high = chi2_band(3)
    if not len(values):
        return Consistency(float("nan"), low, high, float("nan"))
    return Consistency(float(values.mean()), low, high, float(((values >= low) & (values <= high)).mean()))


def innovation_consistency(nis: Array, dof: Ids, scored: Mask) -> Consistency:
    """NIS per degree of freedom (1 is right); white innovations make the band that of their sum."""
    use = scored & (dof > 0) & np.isfinite(nis)
    total = int(dof[use].sum())
    if not total:
        return Consistency(*[float("nan")] * 4)
    low, high = chi2_band(total)
    inside = (nis[use] >= chdtri(dof[use], 0.975)) & (nis[use] <= chdtri(dof[use], 0.025))
    return Consistency(float(nis[use].sum()) / total, low / total, high / total, float(inside.mean()))
