"""Figure 4, step by step, by what each step does; the rules of wallet, wear, boots and award; the options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomthumb.errors import TomThumbError
from tomthumb.forest.family import ground_of, trail_strengths
from tomthumb.forest.figure4 import Event, simulated_tom_thumb
from tomthumb.forest.rules import Rules
from tomthumb.forest.tell import as_json, outcome_of, tell
from tomthumb.forest.world import Forest, bare, plant, read_forest, show_forest, with_awards
from tomthumb.kernels.forest import CROWN, HAT, HOME, MOUNTAIN, OGRE, PALACE
from tomthumb.tale.window import PARENTS

SMALL = """
..a..........^..
.H......b....^..
........^.......
....c...^...d...
........^.......
.....O..........
...........a....
...K.......e....
......^^........
..b.............
"""


def events(forest: Forest, seed: int = 3, **rules: object) -> list[Event]:
    return list(simulated_tom_thumb(forest, np.random.default_rng(seed), Rules(**rules)))  # type: ignore[arg-type]


def of(told: Sequence[Event], step: int) -> list[Event]:
    return [e for e in told if e.step == step]


def sees(forest: Forest, place: tuple[int, int], code: int) -> bool:
    rows, columns = forest.shape
    window = [(place[0] + i, place[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return any(forest.cells[r % rows, c % columns] == code for r, c in window)


@pytest.fixture(scope="module")
def forest() -> Forest:
    return read_forest(SMALL)


@pytest.fixture(scope="module")
def told(forest: Forest) -> list[Event]:
    """A tale in which every step happens: found by trying seeds, so that no seed is magic."""
    infinite = with_awards(forest, np.array([math.inf]))
    for seed in range(200):
        tale = events(infinite, seed)
        if {e.step for e in tale} == set(range(1, 28)):
            return tale
    raise AssertionError("no tale with all 27 steps")


def test_steps_1_to_5_set_the_stage(told: list[Event], forest: Forest) -> None:
    assert [e.step for e in told[:6]] == [1, 2, 3, 4, 5, 6]
    assert (told[0].family.window == np.ones((3, 3))).all()
    assert f"{forest.shape[0]} x {forest.shape[1]}" in told[1].what
    assert set(np.unique(forest.cells)) == {OGRE, 0, MOUNTAIN, HOME, PALACE}
    assert told[3].family.place == forest.home
    assert told[4].family.wallet == 0.0
    assert told[4].family.alpha == 1.0


def test_every_iteration_is_in_the_figures_order(told: list[Event]) -> None:
    allowed = {
        6: {7}, 7: {8, 9}, 8: {9}, 9: {10}, 10: {11}, 11: {12}, 12: {13}, 13: {14}, 14: {15}, 15: {16, 6},
        16: {17, 18, 19}, 17: {17, 18, 19}, 18: {6}, 19: {20}, 20: {21}, 21: {22, 23, 24}, 22: {22, 23, 24},
        23: {6}, 24: {25}, 25: {26}, 26: {27, 6}, 27: set(),
    }  # fmt: skip
    for before, after in pairwise(told[5:]):
        assert after.step in allowed[before.step]


def test_steps_6_to_8_wallet_and_stones_first(told: list[Event]) -> None:
    assert all(e.family.wallet == 0.0 for e in of(told, 6))
    allowed = [e.iteration for e in of(told, 7) if "allow" in e.what]
    assert allowed == [1]
    assert [e.iteration for e in of(told, 8)] == list(range(2, told[-1].iteration + 1))


def test_step_9_hats_and_alpha_one_again(told: list[Event]) -> None:
    for event in of(told, 9):
        assert event.family.wear == HAT
        assert event.family.alpha == 1.0
        assert (event.family.window == 1.0).all()  # the parents are back in their cell


def test_step_10_is_a_flight_from_home_that_mountains_stop(told: list[Event], forest: Forest) -> None:
    for event in of(told, 10):
        assert event.moves == 10
        assert event.distance == len(event.path)
        way = np.vstack(([forest.home], event.path))
        gap = np.abs(np.diff(way, axis=0))
        gap = np.minimum(gap, np.array(forest.shape) - gap)
        assert gap.max() == 1
        assert not (forest.cells[event.path[:, 0], event.path[:, 1]] == MOUNTAIN).any()
        assert event.family.place == tuple(event.path[-1])


def test_steps_11_and_12_leave_marks_and_teach(forest: Forest) -> None:
    for event in simulated_tom_thumb(forest, np.random.default_rng(0), Rules(tau=1e9, birds=0.0)):
        rows, columns = event.path[:, 0], event.path[:, 1]
        if event.step == 11:
            stones = event.iteration == 1
            assert (
                (event.ground.laid[rows, columns] == -1).all()
                if stones
                else (event.ground.laid[rows, columns] != 0).all()
            )
            assert (event.ground.number[rows, columns] <= np.arange(1, len(rows) + 1)).all()
        if event.step == 12:
            assert (event.ground.way[rows, columns].max(axis=1) > 0.0).all()
            assert event.ground.way.min() >= 0.0
            assert event.ground.way.max() <= 1.0
        if event.iteration > 3:
            break
    assert event.ground.sights.w.any()


def test_steps_13_and_14_zero_the_parents_cell(told: list[Event]) -> None:
    for event in of(told, 14):
        assert event.family.window[PARENTS] == 0.0
        assert (np.delete(event.family.window.ravel(), 0) == HAT).all()


def test_step_15_goes_down_the_numbers(told: list[Event], forest: Forest) -> None:
    first = of(told, 15)[0]  # stones: all the way home
    assert "home" in first.what
    assert sees(forest, first.family.place, HOME)
    assert first.moves <= of(told, 10)[0].distance


def test_steps_16_to_19_search_until_home_or_ogre(told: list[Event], forest: Forest) -> None:
    for before, event in pairwise(told):
        if event.step == 17:
            assert before.family.wear == HAT
        if event.step == 18:
            assert sees(forest, event.family.place, HOME)
        if event.step == 19:
            assert sees(forest, event.family.place, OGRE)
            assert not sees(forest, event.family.place, HOME)


def test_steps_20_to_23_crowns_boots_and_maybe_home(told: list[Event], forest: Forest) -> None:
    for event in of(told, 20):
        assert event.family.wear == CROWN
        assert (np.delete(event.family.window.ravel(), 0) == -1.0).all()
        assert event.family.window[PARENTS] == 0.0
    assert {e.family.alpha for e in of(told, 21)} == {min(7.0, min(forest.shape) // 2 - 1)}
    assert all(sees(forest, e.family.place, HOME) for e in of(told, 23))
    assert all(e.family.alpha > 1.0 for e in of(told, 22))


def test_steps_24_to_27_king_home_award_stop(told: list[Event], forest: Forest) -> None:
    assert [e.step for e in told[-4:]] == [24, 25, 26, 27]
    assert sees(forest, told[-4].family.place, PALACE)
    assert told[-3].family.place == forest.home
    assert math.isinf(told[-2].family.wallet)


def test_a_finite_award_ends_at_the_next_look_at_the_wallet(forest: Forest) -> None:
    tale = events(forest)
    assert [e.step for e in tale[-2:]] == [26, 6]
    assert tale[-1].family.wallet == 1.0


def test_an_empty_purse_leaves_the_wallet_empty(forest: Forest) -> None:
    out = outcome_of(events(with_awards(forest, np.array([0.0])), max_iterations=60))
    assert out.iterations == 60
    assert out.awards > 0
    assert out.award == 0.0


def test_several_kings_until_enough_and_exhausted_ones() -> None:
    forest = plant(np.random.default_rng(4), 24, palaces=3)
    out = outcome_of(events(forest, exhausts=True, enough=2.0))
    assert out.award == 3.0
    assert out.awards >= 3


def test_palaces_that_move() -> None:
    forest = plant(np.random.default_rng(4), 24)
    tale = events(forest, palace_every=5)
    places = {tuple(e.palaces[0]) for e in tale}
    assert len(places) > 1
    assert tale[-1].family.wallet == 1.0
    assert (forest.cells == PALACE).sum() == 1
    assert tuple(forest.palaces[0]) == tuple(tale[0].palaces[0])


def test_stones_alone_never_reach_an_award() -> None:
    for seed in range(20):
        forest = plant(np.random.default_rng(seed), 24)
        out = outcome_of(events(forest, seed, stones="always", max_iterations=30))
        assert out.award == 0.0
        assert out.homes == 30
        assert out.moves_by_leg["walk"] == 0


@pytest.mark.parametrize("boundary", ["torus", "reflect", "clip"])
@pytest.mark.parametrize("directions", ["eight", "four", "angle", "entrywise"])
def test_stones_lead_home_whatever_the_walk(boundary: str, directions: str) -> None:
    forest = plant(np.random.default_rng(9), 20, mountains=0.2)
    out = outcome_of(
        events(forest, boundary=boundary, directions=directions, stones="always", max_iterations=20, outward=40)
    )
    assert out.homes == 20


OPTIONS = [
    {"boundary": "reflect"}, {"boundary": "clip"}, {"directions": "four"}, {"directions": "angle"},
    {"directions": "entrywise"}, {"lengths": "pareto"}, {"lengths": "mantegna", "lam": 2.5}, {"sense": "walk"},
    {"king_anywhere": True}, {"parents_eyes": False}, {"flee": 0.5}, {"trust": 0.0}, {"plasticity": None},
]  # fmt: skip


@pytest.mark.parametrize("rules", OPTIONS)
def test_every_option_reaches_the_king(rules: dict[str, object]) -> None:
    forest = plant(np.random.default_rng(2), 24)
    out = outcome_of(events(forest, **rules))
    assert out.award == 1.0
    assert out.home


def test_king_anywhere_needs_no_ogre() -> None:
    forest = bare(16, (0, 0), None, (8, 8))
    assert outcome_of(events(forest, king_anywhere=True)).ogre_visits == 0
    assert outcome_of(events(forest, max_iterations=50)).award == 0.0  # the default: only in the ogre's branch


def test_parents_who_stay_lead_home() -> None:
    out = outcome_of(events(bare(16), flee=0.0, max_iterations=5))
    assert out.homes == 5
    assert out.moves_by_leg["led home"] > 0


def test_ogre_is_not_noticed_under_a_crown() -> None:
    forest = bare(16, (0, 0), (5, 6), None)
    tale = events(forest, max_iterations=30, stones="never")
    for before, after in pairwise(tale):
        if after.step == 22:
            assert before.family.wear == CROWN
    assert len(of(tale, 19)) == len(of(tale, 23))  # from the ogre only home can end it


def test_crumbs_fade_and_stones_stay(forest: Forest) -> None:
    rules = Rules(tau=20.0)
    ground = ground_of(forest, rules)
    ground.laid[0, 0], ground.laid[0, 1] = -1, 1
    ground.counts[0] = 40
    strength = trail_strengths(ground, rules.tau)
    assert strength[0, 0] == 1.0
    assert strength[0, 1] == pytest.approx(math.exp(-40 / 20))
    assert strength[5, 5] == 0.0


def test_how_often_the_tale_is_told_does_not_change_it() -> None:
    forest = plant(np.random.default_rng(5), 32)
    finely = outcome_of(simulated_tom_thumb(forest, np.random.default_rng(6), chunk=1))
    assert finely == tell(forest, np.random.default_rng(6))


def test_the_same_seed_tells_the_same_tale() -> None:
    """Golden: whole numbers from one seed, on any machine."""
    told = as_json(tell(plant(np.random.default_rng(1), 32), np.random.default_rng(2)))
    assert told == {
        "iterations": 5, "moves": 129, "distance": 319, "ogre_visits": 1, "award": 1.0, "award_infinite": False,
        "home": True, "homes": 4,
        "moves_by_leg": {"outward": 50, "led home": 0, "trail": 16, "walk": 49, "boots": 14},
        "distance_by_leg": {"outward": 113, "led home": 0, "trail": 16, "walk": 88, "boots": 102},
    }  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    lam=st.floats(1.05, 2.95),
    mountains=st.floats(0.0, 0.3),
    birds=st.floats(0.0, 1.0),
    outward=st.integers(1, 40),
    boundary=st.sampled_from(["torus", "reflect", "clip"]),
    directions=st.sampled_from(["eight", "four", "angle", "entrywise"]),
    lengths=st.sampled_from(["power", "pareto", "mantegna"]),
    sense=st.sampled_from(["flight", "walk"]),
    stones=st.sampled_from(["first", "always", "never"]),
)
def test_whatever_the_rules_the_tale_keeps_its_word(seed: int, mountains: float, **rules: object) -> None:
    forest = plant(np.random.default_rng(seed), 16, mountains)
    before = forest.cells.copy()
    moves = 0
    for event in simulated_tom_thumb(forest, np.random.default_rng(seed), Rules(max_moves=3000, **rules)):  # type: ignore[arg-type]
        moves += event.moves
        cells = forest.cells[event.path[:, 0], event.path[:, 1]]
        assert not (cells == MOUNTAIN).any()
        assert event.family.place[0] in range(16)
        assert event.family.place[1] in range(16)
        assert event.family.wear in (HAT, CROWN)
        assert event.distance >= 0
    ground = event.ground
    assert ground.way.min() >= 0.0
    assert ground.way.max() <= 1.0
    assert ground.number.min() >= 0
    assert moves <= 3000 + 100 * 16  # one iteration may end after the last move counted
    assert (forest.cells == before).all()


def test_text_and_back(forest: Forest) -> None:
    again = read_forest(show_forest(forest))
    assert (again.cells == forest.cells).all()
    assert (again.features == forest.features).all()


def test_bad_input_is_one_clear_line(forest: Forest) -> None:
    rng = np.random.default_rng(0)
    for wrong in (
        lambda: read_forest("H.\n..."),
        lambda: read_forest("H?"),
        lambda: read_forest("HH"),
        lambda: plant(rng, 3),
        lambda: plant(rng, 8, ogres=90),
        lambda: with_awards(forest, np.array([1.0, 2.0])),
        lambda: Rules(lam=1.0),
        lambda: Rules(birds=1.5),
        lambda: Rules(directions="up"),  # type: ignore[arg-type]
        lambda: tell(forest, rng, Rules(boots=99.0)),
        lambda: list(simulated_tom_thumb(forest, rng, chunk=0)),
    ):
        with pytest.raises(TomThumbError, match=r"^[^\n]+$"):
            wrong()
