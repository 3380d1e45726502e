"""The Gymnasium environment passes Gymnasium's own checker, and its episodes end as figure 4 says."""

from __future__ import annotations

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra gym")

import tomthumb.forest.gym  # noqa: E402 - registers the environment
from tomthumb.errors import TomThumbError  # noqa: E402
from tomthumb.kernels.forest import HOME, PALACE  # noqa: E402


@pytest.mark.parametrize("mode", [None, "ansi", "rgb_array"])
def test_gymnasiums_checker(mode: str | None) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(gymnasium.make("tomthumb/Forest-v0", size=12, render_mode=mode).unwrapped)


def test_random_episodes_end_at_home_or_palace_with_their_reward() -> None:
    env = gymnasium.make("tomthumb/Forest-v0", size=16)
    env.action_space.seed(1)
    ends = set()
    for seed in range(40):
        env.reset(seed=seed)
        over = False
        while not over:
            observation, reward, over, _, info = env.step(env.action_space.sample())
        assert info["found"] in (HOME, PALACE)
        assert info["found"] in observation["window"]
        assert reward == pytest.approx({HOME: 0.099, PALACE: 0.999}[info["found"]])
        assert info["found"] == HOME or observation["wear"] == 1
        ends.add(info["found"])
    assert ends == {HOME, PALACE}


def test_same_seed_same_episode() -> None:
    env = gymnasium.make("tomthumb.forest.gym:tomthumb/Forest-v0")
    runs = []
    for _ in range(2):
        first, _ = env.reset(seed=5)
        steps = [env.step(a)[4]["place"] for a in (9, 0, 12, 3, 15)]
        runs.append((first["window"].tolist(), steps))
    assert runs[0] == runs[1]


def test_pictures() -> None:
    env = gymnasium.make("tomthumb/Forest-v0", size=12, render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape[2] == 3
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    with pytest.raises(TomThumbError, match="render_mode"):
        tomthumb.forest.gym.ForestEnv(render_mode="human")
