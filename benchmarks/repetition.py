"""Over which path do a sensor's errors repeat themselves? The residuals of a log against its truth, by labels.

    python benchmarks/repetition.py DATA/victoria_park

Residuals (measured less expected from the true pose and the true landmark) of two sightings of one landmark, multiplied and
averaged by the path between them; the integral of that correlation over the path, as far as it falls, is what a sensor's
`memory` may be told. Pairs more than 60 s apart are other visits. Residuals beyond five standard deviations are left out.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.geometry import wrap
from tomthumb.scenarios.catalogue import load
from tomthumb.types import Scenario

EDGES = np.array([0, 0.05, 0.1, 0.2, 0.3, 0.6, 1, 1.5, 2, 3, 4, 6, 8, 10, 13, 17, 22, 30, 40.0])  # m of path
VISIT = 60.0  # s


def residuals(scenario: Scenario) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Landmark, time s, path so far m and residual (2,) of every sighting with a label and a true pose."""
    if scenario.landmarks is None:
        raise TomThumbError(f"{scenario.name}: no true landmarks to measure against")
    rows, path, last = [], 0.0, None
    for step in scenario.steps:
        if step.truth is None or step.truth.pose is None:
            continue
        pose = step.truth.pose
        path += 0.0 if last is None else float(np.hypot(*(pose - last)[:2]))
        last = pose
        if step.observations is None or step.truth.ids is None:
            continue
        held = np.flatnonzero(step.truth.ids >= 0)
        ids = step.truth.ids[held]
        nu = step.observations.z[held] - scenario.sensor.expect(pose, scenario.landmarks[ids])[0]
        nu[:, list(scenario.sensor.angles)] = wrap(nu[:, list(scenario.sensor.angles)])
        rows += [(i, step.t, path, *e) for i, e in zip(ids.tolist(), nu.tolist(), strict=True)]
    found = np.array(rows)
    spread = 1.4826 * np.median(np.abs(found[:, 3:]), axis=0)
    found = found[(np.abs(found[:, 3:]) < 5.0 * spread).all(1)]
    found = found[np.lexsort((found[:, 1], found[:, 0]))]
    return found[:, 0], found[:, 1], found[:, 2], found[:, 3:]


def correlation(who: np.ndarray, t: np.ndarray, path: np.ndarray, nu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correlation (bins, 2) by path between two sightings of one landmark, and how many pairs (bins,)."""
    total, count = np.zeros((len(EDGES) - 1, 2)), np.zeros(len(EDGES) - 1)
    for apart in range(1, len(who)):
        first, second = np.arange(len(who) - apart), np.arange(apart, len(who))
        same = (who[first] == who[second]) & (t[second] - t[first] < VISIT)
        if not same.any():
            break
        first, second = first[same], second[same]
        at = np.searchsorted(EDGES, path[second] - path[first], side="right") - 1
        inside = at < len(count)
        np.add.at(total, at[inside], nu[first[inside]] * nu[second[inside]])
        np.add.at(count, at[inside], 1.0)
    return total / np.maximum(count, 1.0)[:, None] / (nu**2).mean(0), count


def main() -> None:
    """JSON, an object a line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    scenario = load(parser.parse_args().log)
    who, t, path, nu = residuals(scenario)
    rho, count = correlation(who, t, path, nu)
    for low, high, pairs, one in zip(EDGES[:-1], EDGES[1:], count, rho.round(3).tolist(), strict=True):
        if pairs:
            print(json.dumps({"path_m": [low, high], "pairs": int(pairs), "correlation": one}))
    seen = count > 0
    falling = np.maximum(np.minimum.accumulate(rho[seen], axis=0), 0.0)
    length = (falling * np.diff(EDGES)[seen, None]).sum(0)
    print(
        json.dumps(
            {"log": scenario.name, "rms": np.sqrt((nu**2).mean(0)).tolist(), "length_m": length.round(2).tolist()}
        )
    )


if __name__ == "__main__":
    main()
