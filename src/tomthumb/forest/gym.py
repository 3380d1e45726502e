"""The forest as a Gymnasium environment, `tomthumb/Forest-v0` (extra `gym`): the children's part of figure 4.

An episode begins where the parents have fled (step 14) and ends when HOME is seen, or, with crowns on, the palace.

    import gymnasium

    env = gymnasium.make("tomthumb.forest.gym:tomthumb/Forest-v0", size=24)

The name alone serves once this module has been imported (Gymnasium 1.0 finds no environments by itself).
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from tomthumb.errors import TomThumbError
from tomthumb.forest.exact import EIGHT
from tomthumb.forest.family import Family, Ground, trail_strengths
from tomthumb.forest.figure4 import simulated_tom_thumb
from tomthumb.forest.flights import Lengths, alpha_of, lengths_of
from tomthumb.forest.frames import Frame
from tomthumb.forest.rules import BOUNDARIES, Rules
from tomthumb.forest.world import Forest, plant
from tomthumb.kernels.forest import CROWN, FREE, HAT, HOME, OGRE, PALACE, fly, sense

NAME = "tomthumb/Forest-v0"
_EYES = np.ones((3, 3), np.bool_)
Observation = dict[str, Any]


RENDER_MODES = ("ansi", "rgb_array")


class ForestEnv(gymnasium.Env[Observation, np.int64]):
    """Tom Thumb alone in the forest.

    Actions: 0 to 7, one cell in a direction (row by row through the window); 8 to 15, a Lévy flight that way, with the
    boots' lengths once the ogre has been met. Observations: `window (3, 3)` cell codes (-1 ogre, 0 free, 1 mountain,
    2 home, 3 palace), `trail (3, 3)` strengths of the marks, `ways (8,)` learned weights, `wear` 0 hat, 1 crown.
    Rewards: -0.001 a move, 0.1 for coming home, 1 for the king's award.

    Args:
        size: cells on a side; a new forest is planted at every reset.
        mountains: share of cells that block.
        rules: options of figure 4.
        render_mode: "ansi", "rgb_array" or None.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 8}  # noqa: RUF012 - Gymnasium's own convention

    def __init__(
        self, size: int = 24, mountains: float = 0.05, rules: Rules | None = None, render_mode: str | None = None
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise TomThumbError(f"render_mode is one of {', '.join(RENDER_MODES)}, not {render_mode!r}")
        self.size, self.mountains, self.rules = size, mountains, rules or Rules(stones="never")
        self.render_mode = render_mode
        self.action_space = spaces.Discrete(16)
        self.observation_space = spaces.Dict(
            {
                "window": spaces.Box(-1, 3, (3, 3), np.int8),
                "trail": spaces.Box(0.0, 1.0, (3, 3), np.float32),
                "ways": spaces.Box(0.0, 1.0, (8,), np.float32),
                "wear": spaces.Discrete(2),
            }
        )
        self._forest: Forest
        self._ground: Ground
        self._family: Family
        self._walk: Lengths
        self._boots: Lengths
        self._moves = self._distance = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """A new forest, and the family led out into it; again if home can be seen from where the parents fled."""
        super().reset(seed=seed)
        shape = (self.size, self.size)
        self._walk = lengths_of(self.rules, shape, 1.0)
        self._boots = lengths_of(self.rules, shape, alpha_of(self.rules, shape))
        while True:
            self._forest = plant(self.np_random, self.size, self.mountains)
            self._ground, self._family = self._led_out()
            if self._seen() == FREE:
                break
        self._moves = self._distance = 0
        return self._observation(), self._info()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One move of the family; the ogre's house changes hats for crowns and puts the boots on."""
        direction, far = int(action) % 8, int(action) >= 8
        booted = self._family.wear == CROWN
        length = int((self._boots if booted else self._walk)(self.np_random, 1)[0]) if far else 1
        dr, dc = (int(v) * length for v in EIGHT[direction])
        place = np.array(self._family.place)
        boundary = BOUNDARIES[self.rules.boundary]
        self._distance += fly(self._ground.cells, place, dr, dc, booted, False, boundary)
        self._moves += 1
        self._ground.counts[0] += 1
        alpha = alpha_of(self.rules, (self.size, self.size)) if booted else 1.0
        self._family = Family((int(place[0]), int(place[1])), self._family.window, self._family.wear, alpha)
        found = self._seen()
        if found == OGRE:
            self._family = self._family.wearing(CROWN)
        reward = -0.001 + {HOME: 0.1, PALACE: 1.0}.get(found, 0.0)
        return self._observation(), reward, found in (HOME, PALACE), False, self._info() | {"found": found}

    def render(self) -> Any:
        """The forest in letters around Tom (`ansi`), or as a picture (`rgb_array`)."""
        if self.render_mode is None:
            return None
        frame = self._frame()
        if self.render_mode == "rgb_array":
            from tomthumb.forest.animation import pixels

            return pixels(self._forest, frame)
        from rich.console import Console

        from tomthumb.forest.terminal import picture

        console = Console(width=2 * self.size + 50, height=self.size + 6, record=True, quiet=True)
        console.print(picture(self._forest, frame, console.width, console.height))
        return console.export_text()

    def _led_out(self) -> tuple[Ground, Family]:
        told = simulated_tom_thumb(self._forest, self.np_random, self.rules)
        event = next(e for e in told if e.step == 14)
        return event.ground, event.family

    def _seen(self) -> int:
        row, column = self._family.place
        royal = self._family.wear == CROWN or self.rules.king_anywhere
        boundary = BOUNDARIES[self.rules.boundary]
        return int(sense(self._ground.cells, row, column, _EYES, self._family.wear, royal, boundary))

    def _observation(self) -> Observation:
        row, column = self._family.place
        window = np.ix_(np.arange(row - 1, row + 2) % self.size, np.arange(column - 1, column + 2) % self.size)
        return {
            "window": self._ground.cells[window],
            "trail": trail_strengths(self._ground, self.rules.tau)[window].astype(np.float32),
            "ways": self._ground.way[row, column].copy(),
            "wear": int(self._family.wear != HAT),
        }

    def _info(self) -> dict[str, Any]:
        return {"place": self._family.place, "moves": self._moves, "distance": self._distance}

    def _frame(self) -> Frame:
        g = self._ground
        return Frame(
            step=22 if self._family.wear == CROWN else 17,
            what="random walk",
            iteration=1,
            moves=self._moves,
            distance=self._distance,
            family=self._family,
            trail=trail_strengths(g, self.rules.tau),
            stones=g.laid < 0,
            ways=g.way.max(axis=2),
            path=np.array([self._family.place]),
            palaces=self._forest.palaces,
        )


def register() -> None:
    """Make `gymnasium.make("tomthumb/Forest-v0")` work; done when this module is imported."""
    if NAME not in gymnasium.registry:
        gymnasium.register(NAME, entry_point="tomthumb.forest.gym:ForestEnv", max_episode_steps=5000)


register()
