"""What the kernels leave on the ground: trails with losses, learned ways, features, flights."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from tomthumb.forest.family import eaten, ground_of, stdp_constants
from tomthumb.forest.flights import Flights, displacements, lengths_of, pareto_law
from tomthumb.forest.rules import Rules
from tomthumb.forest.world import bare, plant
from tomthumb.kernels.forest import FREE, HOME, REFLECT, TORUS, fold, follow, learn_features, march
from tomthumb.tale.levy import power_law
from tomthumb.tale.stdp import PairMemory, Plasticity
from tomthumb.tale.trail import followed_length

EYES = np.ones((3, 3), np.bool_)
P = Plasticity()


def walked(flights, rules: Rules, start=(5, 5), size: int = 40, laps: int = 1, stone: bool = False):  # type: ignore[no-untyped-def]
    """Ground after `laps` marches on these flights from `start`; home far away in a corner."""
    forest = bare(size, (size - 1, size - 1))
    ground, path = ground_of(forest, rules), np.empty((1000, 2), np.int64)
    for _ in range(laps):
        place = np.array(start)
        ground.counts[1] = 0
        ground.recent[:] = -1
        ground.recent[0] = (*start, ground.tick)
        ground.counts[2] = 0
        n = march(
            ground.cells, ground.number, ground.laid, ground.way, ground.touched, ground.recent, ground.counts, place,
            np.array(flights), stone, TORUS, rules.tau, rules.faintest, stdp_constants(rules), path,
        )  # fmt: skip
    return ground, place, path[:n].copy()


@pytest.mark.parametrize("loss", [0.05, 0.2, 0.6])
def test_followed_length_of_a_straight_trail_with_losses(loss: float) -> None:
    rules, rng, length = Rules(tau=1e9), np.random.default_rng(3), 20
    followed = []
    for _ in range(1500):
        ground, place, path = walked([(0, length)], rules)
        eaten(ground, path[:-1], loss, rng)  # they stand on the last one
        ground.laid[5, 5], ground.number[5, 5] = 0, 0  # the trail ends where it began: T marks behind them
        way = np.empty((length + 1, 2), np.int64)
        count, found = follow(
            ground.cells, ground.number, ground.laid, ground.counts, place, EYES, TORUS, rules.tau, 0.5, way
        )
        assert found == FREE
        followed.append(count)
    expected = followed_length(loss, length - 1)
    assert np.mean(followed) == pytest.approx(expected, abs=3 * np.std(followed) / math.sqrt(len(followed)))


def test_stones_are_not_eaten_and_lead_all_the_way_over_crossings() -> None:
    rng = np.random.default_rng(0)
    for seed in range(30):
        flights = displacements(np.random.default_rng(seed), power_law(1.5, 8).draw, "eight", 25)
        ground, place, path = walked(flights, Rules(), size=16, stone=True)
        assert eaten(ground, path, 1.0, rng) == 0
        way = np.empty((int(ground.counts[1]) + 1, 2), np.int64)
        ground.cells[5, 5], ground.cells[15, 15] = HOME, FREE
        _, found = follow(ground.cells, ground.number, ground.laid, ground.counts, place, EYES, TORUS, 1.0, 0.5, way)
        assert found == HOME


def test_learned_ways_are_the_closed_form() -> None:
    ground, _, _ = walked([(0, 3)], Rules(forgetting=1e12))
    west, east = 3, 4  # directions, row by row through the window without its middle
    once = P.a_plus * math.exp(-1 / P.tau_plus)
    assert ground.way[5, 6, west] == pytest.approx(once)
    assert ground.way[5, 6, east] == 0.0
    back, _, _ = walked([(0, 1), (0, -1)], Rules(forgetting=1e12))
    assert back.way[5, 6, west] == pytest.approx(once * (1 - P.a_minus * math.exp(-1 / P.tau_minus)))
    trace = math.exp(-1 / P.tau_plus)  # (5, 5) comes after (5, 6)
    assert back.way[5, 5, east] == pytest.approx(P.a_plus * trace)


def test_three_laps_of_a_ring_teach_where_one_comes_from_everywhere() -> None:
    ring = [(0, 6), (6, 0), (0, -6), (-6, 0)]
    ground, _, path = walked(ring, Rules(), laps=3, stone=True)
    offsets = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    before = np.roll(path, 1, axis=0)
    for here, there in zip(path, before, strict=True):
        assert offsets[int(ground.way[tuple(here)].argmax())] == tuple(there - here)


def test_what_was_learned_with_crumbs_fades_and_with_stones_stays() -> None:
    rules = Rules(forgetting=50.0)
    for stone in (True, False):
        ground, _, _ = walked([(0, 3)], rules, stone=stone)
        ground.counts[0] += 100
        before = ground.way[5, 6].max()
        place, path = np.array([5, 5]), np.empty((9, 2), np.int64)
        still = stdp_constants(rules)
        still[2] = 1e-300  # looks at the cell, and learns next to nothing
        ground.recent[:] = -1
        march(
            ground.cells, ground.number, ground.laid, ground.way, ground.touched, ground.recent, ground.counts, place,
            np.array([(0, 2)]), stone, TORUS, 30.0, 0.2, still, path,
        )  # fmt: skip
        faded = math.exp(-103 / 50) if not stone else 1.0
        assert ground.way[5, 6].max() == pytest.approx(before * faded, rel=0.05)


def test_features_learn_their_successor() -> None:
    features = np.zeros((9, 60), np.int8)
    features[4, 5::10] = np.arange(1, 7)
    path = np.stack((np.full(180, 4), np.arange(180) % 60), axis=1)
    memory, seen = PairMemory(6, Plasticity(tau_plus=10.0, tau_minus=10.0)), np.zeros(6, np.bool_)
    constants = np.array([10.0, 10.0, 0.1, 0.105, 1.0, 1.0])
    learn_features(features, path, seen, memory.w, memory.x, memory.y, constants, TORUS)
    assert memory.w.argmax(axis=0).tolist() == [1, 2, 3, 4, 5, 0]


@pytest.mark.parametrize(("directions", "headings"), [("eight", 8), ("four", 4)])
def test_directions_are_even_and_lengths_as_the_law_says(directions: str, headings: int) -> None:
    moves = displacements(np.random.default_rng(0), power_law(2.0, 16).draw, directions, 80_000)
    length = np.abs(moves).max(axis=1)
    units, counts = np.unique(moves // length[:, None], axis=0, return_counts=True)
    assert len(units) == headings
    assert np.abs(counts / 80_000 - 1 / headings).max() < 0.006
    assert length.mean() == pytest.approx(power_law(2.0, 16).mean, rel=0.03)


def test_entrywise_is_anisotropic_and_angles_are_not() -> None:
    rng, law = np.random.default_rng(0), power_law(2.0, 64)
    along = {}
    for kind in ("entrywise", "angle"):
        moves = displacements(rng, law.draw, kind, 50_000).astype(float)
        far = moves[np.hypot(*moves.T) > 8]
        angle = np.abs((np.degrees(np.arctan2(far[:, 0], far[:, 1])) + 45) % 90 - 45)
        along[kind] = float(np.mean(angle < 22.5))
    assert along["angle"] == pytest.approx(0.5, abs=0.03)
    assert along["entrywise"] > 0.7  # equation 1 entry by entry flies along the axes


def test_pareto_table_is_the_rounded_continuous_law() -> None:
    rng = np.random.default_rng(1)
    lengths = np.floor(2.0 * (1 - rng.random(300_000)) ** (-1 / 1.0) + 0.5)
    counts = np.bincount(lengths[lengths <= 20].astype(int), minlength=21)[1:] / (lengths <= 20).sum()
    assert np.abs(counts - pareto_law(2.0, 20, 2.0).pmf).max() < 0.004


def test_batches_do_not_show() -> None:
    rules = Rules()
    streams = [Flights(np.random.default_rng(3), lengths_of(rules, (32, 32), 1.0), "eight", 64) for _ in range(2)]
    one, many = [], []
    for most, into, stream in ((64, one, streams[0]), (5, many, streams[1])):
        while len(into) < 300:
            moves, _ = stream.look(most)
            into.extend(moves.tolist())
            stream.use(len(moves))
    assert one[:300] == many[:300]


def test_mirrors_and_tori() -> None:
    assert [fold(x, 4, REFLECT) for x in range(-4, 9)] == [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert [fold(x, 4, TORUS) for x in (-5, -1, 0, 3, 4, 9)] == [3, 3, 0, 3, 0, 1]


@pytest.mark.slow
def test_a_large_forest_fits_in_a_gibibyte() -> None:
    resource = pytest.importorskip("resource", reason="needs POSIX to measure memory")
    assert resource
    code = (
        "import resource, numpy as np\n"
        "from tomthumb.forest import Rules, plant, tell\n"
        "out = tell(plant(np.random.default_rng(1), 4096), np.random.default_rng(2), Rules(max_moves=2_000_000))\n"
        "print(out.moves, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    moves, kilobytes = map(int, done.stdout.split())
    assert moves >= 2_000_000
    assert kilobytes < 2**20


def test_every_cell_of_a_large_forest_would_still_fit() -> None:
    """The worst case, every page trodden: the bytes of all arrays of a 4096 x 4096 run, counted on a small one."""
    forest = plant(np.random.default_rng(0), 64)
    ground = ground_of(forest, Rules())
    arrays = (forest.cells, forest.features, ground.cells, ground.number, ground.laid, ground.way, ground.touched)
    per_cell = sum(a.nbytes for a in arrays) / forest.cells.size
    assert per_cell * 4096**2 < 0.8 * 2**30
