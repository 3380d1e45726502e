"""tomthumb: landmark SLAM with data association.

    import tomthumb

    scenario = tomthumb.load("cloister", seed=1)
    trace = tomthumb.run(scenario, associator="stt")
    print(tomthumb.evaluate(trace, scenario)["match_rate"])

The public names below are imported when first used, so that `import tomthumb` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0.dev0"

_PUBLIC = {
    "associate": "tomthumb.plain",
    "problem": "tomthumb.plain",
    "explain": "tomthumb.associators.explain",
    "Explanation": "tomthumb.associators.explain",
    "run": "tomthumb.runner",
    "evaluate": "tomthumb.metrics",
    "load": "tomthumb.scenarios",
    "minimize": "tomthumb.optimize",
    "simulated_tom_thumb": "tomthumb.forest",
    "Slam": "tomthumb.slam",
    "LifeCycle": "tomthumb.lifecycle",
    "TomThumbError": "tomthumb.errors",
} | dict.fromkeys(
    (
        "Association",
        "AssociationProblem",
        "Control",
        "Estimate",
        "Observations",
        "Predictions",
        "Prior",
        "Scenario",
        "Step",
        "StepRecord",
        "Trace",
        "Truth",
    ),
    "tomthumb.types",
)

__all__ = ["__version__", *_PUBLIC]

if TYPE_CHECKING:
    from tomthumb.lifecycle import LifeCycle as LifeCycle
    from tomthumb.metrics import evaluate as evaluate
    from tomthumb.runner import run as run
    from tomthumb.scenarios import load as load
    from tomthumb.slam import Slam as Slam


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _PUBLIC:
        raise AttributeError(f"module 'tomthumb' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
