"""Performance profiles and the growth of a cost.

References: E. Dolan, J. More, "Benchmarking optimization software with performance profiles", Math. Program. 91, 2002.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.types import Array


@dataclass(frozen=True, slots=True)
class Profile:
    """Of one method: `share (n,)` of the problems it solves within `ratio (n,)` times the best method's cost."""

    name: str
    ratio: Array
    share: Array


def performance_profiles(names: tuple[str, ...], costs: Array) -> list[Profile]:
    """Profiles from `costs (problems, k)`, smaller is better, NaN or infinite where a method failed.

    Problems that nobody solved count against everybody. A best cost of 0 is met at ratio 1 by those who have it, and at
    no ratio by the others.
    """
    table = np.where(np.isfinite(costs), costs, np.inf)
    best = table.min(1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(table == best, 1.0, table / best)
    ratios[~np.isfinite(table)] = np.inf
    return [_profile(name, ratios[:, j]) for j, name in enumerate(names)]


def _profile(name: str, ratios: Array) -> Profile:
    solved = np.sort(ratios[np.isfinite(ratios)])
    ratio, last = np.unique(solved, return_index=True)
    count = np.append(last[1:], len(solved)) if len(ratio) else np.empty(0)
    return Profile(name, ratio, count / max(len(ratios), 1))


def growth(sizes: Array, costs: Array) -> float:
    """The exponent b of costs ~ sizes^b, by least squares on logarithms; NaN with fewer than two sizes."""
    good = (sizes > 0) & (costs > 0)
    x, y = np.log(sizes[good]), np.log(costs[good])
    if len(np.unique(x)) < 2:
        return np.nan
    return float(((x - x.mean()) * (y - y.mean())).sum() / np.square(x - x.mean()).sum())
