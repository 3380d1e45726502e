"""Frames: what is drawn is what was, and a long tale is thinned without losing its turns."""

from __future__ import annotations

import numpy as np

from tomthumb.forest import Rules, plant, simulated_tom_thumb
from tomthumb.forest.frames import MILESTONES, frames, gather, thin


def told(seed: int = 3):  # type: ignore[no-untyped-def]
    rules = Rules()
    return frames(
        simulated_tom_thumb(plant(np.random.default_rng(seed), 20), np.random.default_rng(seed), rules, 4), rules.tau
    )


def test_frames_are_copies_of_their_moment() -> None:
    streamed = [(frame, frame.trail.copy(), frame.ways.copy()) for frame in told()]
    for frame, trail, ways in streamed:  # the tale has gone on since
        assert (frame.trail == trail).all()
        assert (frame.ways == ways).all()
    assert any((streamed[0][0].trail != frame.trail).any() for frame, _, _ in streamed)
    moves = [frame.moves for frame, _, _ in streamed]
    assert moves == sorted(moves)


def test_crumbs_are_drawn_fainter_with_time_and_stones_are_not() -> None:
    for frame in told():
        assert frame.trail.min() >= 0.0
        assert frame.trail.max() <= 1.0
        assert (frame.trail[frame.stones] == 1.0).all()


def test_thinning_keeps_first_last_and_milestones() -> None:
    everything = list(told())
    few = thin(everything, 12)
    assert few[0] is everything[0]
    assert few[-1] is everything[-1]
    assert len(few) < len(everything)
    turns = [frame for frame in everything if frame.step in MILESTONES]
    room = thin(everything, 2 * len(turns))
    assert all(any(frame is kept for kept in room) for frame in turns)


def test_gathering_never_holds_much_more_than_asked() -> None:
    everything = list(told())
    few = gather(iter(everything * 10), 8)
    assert 2 <= len(few) <= 24
