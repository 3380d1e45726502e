"""How good a run was: associations, trajectory, consistency, map. Only here does a trace meet the truth.

`docs/metrics.md` states every rule; `evaluate` gives all of them as one plain dictionary.
"""

from __future__ import annotations

from tomthumb.metrics.consistency import chi2_band
from tomthumb.metrics.decisions import Decisions, decide
from tomthumb.metrics.evaluation import evaluate, score
from tomthumb.metrics.truth import TruthTable, collect

__all__ = ["Decisions", "TruthTable", "chi2_band", "collect", "decide", "evaluate", "score"]
