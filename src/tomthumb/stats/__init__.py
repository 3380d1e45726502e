"""Statistics for paired Monte Carlo: one row is one run, pairs share world and seed. See `docs/bench.md`."""

from __future__ import annotations

from tomthumb.stats.bootstrap import bootstrap_means, error_bound, mean_interval
from tomthumb.stats.comparison import BETTER, CANNOT_TELL, SAME, WORSE, Comparison, compare, correct, holm
from tomthumb.stats.power import Pilot, normal_pilot, pilot, power, seeds_needed
from tomthumb.stats.profiles import Profile, growth, performance_profiles
from tomthumb.stats.ranks import Ranking, critical_difference, rank
from tomthumb.stats.signed_rank import SignedRank, hodges_lehmann, signed_rank, walsh_averages

__all__ = [
    "BETTER",
    "CANNOT_TELL",
    "SAME",
    "WORSE",
    "Comparison",
    "Pilot",
    "Profile",
    "Ranking",
    "SignedRank",
    "bootstrap_means",
    "compare",
    "correct",
    "critical_difference",
    "error_bound",
    "growth",
    "hodges_lehmann",
    "holm",
    "mean_interval",
    "normal_pilot",
    "performance_profiles",
    "pilot",
    "power",
    "rank",
    "seeds_needed",
    "signed_rank",
    "walsh_averages",
]
