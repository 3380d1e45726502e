"""What a weighted set of particles says as a whole: mean and covariance of the pose and of the landmarks."""

from __future__ import annotations

import numpy as np

from tomthumb import geometry
from tomthumb.estimators import pages
from tomthumb.estimators.pages import Pages
from tomthumb.types import Array, Ids, Mask


def pose(w: Array, x: Array, cov: Array) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3) of poses (M, 3) with their own covariances; headings averaged on the circle."""
    heading = float(np.arctan2(w @ np.sin(x[:, 2]), w @ np.cos(x[:, 2])))
    mean = np.array([*(w @ x[:, :2]), heading])
    away = x - mean
    away[:, 2] = geometry.wrap(away[:, 2])
    total: Array = np.einsum("p,pi,pj->ij", w, away, away) + np.tensordot(w, cov, 1)
    return mean, total


def landmarks(w: Array, m: Pages) -> tuple[Ids, Array, Array, Mask]:
    """Ids (n,) of the heaviest particle's landmarks, with mean, covariance over all that hold them, and which are stones."""
    slots = np.flatnonzero(m.live)
    page = m.table[:, slots // pages.SIZE]
    there = (page >= 0) & m.has[page, slots % pages.SIZE]
    held = there[int(w.argmax())]
    slots, page, there = slots[held], page[:, held], there[:, held]
    weight = there * w[:, None]
    weight /= weight.sum(0)
    mean, cov = m.mean[page, slots % pages.SIZE], m.cov[page, slots % pages.SIZE]
    centre = np.einsum("pn,pni->ni", weight, np.where(there[..., None], mean, 0.0))
    away = np.where(there[..., None], mean - centre, 0.0)
    own = np.einsum("pn,pni->ni", weight, np.where(there[..., None], cov, 0.0))
    covs = np.einsum("pn,pni,pnj->nij", weight, away, away) + own[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return m.ids[slots], centre, covs, m.stone[slots]


def in_body(pose: Array, cov: Array) -> Array:
    """Covariances (M, 3, 3) of the poses (M, 3) in their own frames."""
    B = np.zeros((len(pose), 3, 3))
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    B[:, 0, 0] = B[:, 1, 1] = c
    B[:, 0, 1], B[:, 1, 0], B[:, 2, 2] = s, -s, 1.0
    turned: Array = B @ cov @ B.transpose(0, 2, 1)
    return turned
