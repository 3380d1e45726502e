"""The forest: the paper's own algorithm (figure 4) in a grid world, its ancestors, and what random search is worth.

import numpy as np
from tomthumb.forest import plant, simulated_tom_thumb

for event in simulated_tom_thumb(plant(np.random.default_rng(1)), np.random.default_rng(2)):
    print(event.step, event.what)
"""

from tomthumb.forest.figure4 import Event, simulated_tom_thumb
from tomthumb.forest.rules import Rules
from tomthumb.forest.tell import Outcome, tell
from tomthumb.forest.world import Forest, plant, read_forest, show_forest

__all__ = ["Event", "Forest", "Outcome", "Rules", "plant", "read_forest", "show_forest", "simulated_tom_thumb", "tell"]
