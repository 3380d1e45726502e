"""What a row measures: which way is better, how it is written, and which columns tell of time and place only."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from tomthumb.errors import UnknownName


@dataclass(frozen=True, slots=True)
class Measure:
    """`larger` is better, or smaller, or neither (None). `scale` and `unit` are how it is printed."""

    key: str
    title: str
    larger: bool | None
    scale: float = 1.0
    unit: str = ""
    digits: int = 3

    def text(self, value: float | None) -> str:
        """The value as printed; a dash where there is none."""
        if value is None or value != value:
            return "–"
        return f"{value * self.scale:.{self.digits}f}{self.unit}"


def _share(key: str, title: str) -> Measure:
    return Measure(key, title, True, 100.0, " %", 3)


MEASURES: dict[str, Measure] = {
    m.key: m
    for m in (
        _share("match_rate", "match rate"),
        _share("match_rate_final", "match rate, final"),
        _share("precision", "precision"),
        _share("recall", "recall"),
        _share("purity", "purity"),
        _share("idf1", "IDF1"),
        _share("scans_right", "scans entirely right"),
        Measure("wrong_ids", "wrong identities", False, digits=2),
        Measure("duplicates", "duplicates", False, digits=2),
        Measure("ghosts", "ghosts", False, digits=2),
        Measure("ate_m", "ATE", False, unit=" m", digits=4),
        Measure("ate_raw_m", "ATE, not aligned", False, unit=" m", digits=4),
        Measure("ate_final_m", "ATE, final", False, unit=" m", digits=4),
        Measure("rmse_x_m", "x error", False, unit=" m", digits=4),
        Measure("rmse_y_m", "y error", False, unit=" m", digits=4),
        Measure("rmse_heading_deg", "heading error", False, unit="°", digits=3),
        Measure("rpe_m", "RPE", False, unit=" m", digits=4),
        Measure("end_error_m", "end error", False, unit=" m", digits=4),
        Measure("largest_error_m", "largest error", False, unit=" m", digits=4),
        Measure("nees", "average NEES", None, digits=2),
        Measure("nis", "average NIS", None, digits=2),
        Measure("map_rmse_m", "map error", False, unit=" m", digits=4),
        Measure("gospa_m", "GOSPA", False, unit=" m", digits=3),
        Measure("landmarks", "landmarks", None, digits=1),
        Measure("step_ms_p50", "step, median", False, unit=" ms", digits=3),
        Measure("associate_us_p50", "association, median", False, unit=" µs", digits=1),
        Measure("associate_us_p99", "association, p99", False, unit=" µs", digits=1),
        Measure("run_s", "run", False, unit=" s", digits=3),
    )
}

DEFAULT = ("match_rate", "wrong_ids", "duplicates", "ate_m")
PLACE = ("host", "pid", "finished", "attempts", "detail")
_TIME = re.compile(r"_(s|ms|us)(_p\d+|_max|_mean)?$|^seconds$|^real_time_factor$")


def measure(key: str) -> Measure:
    """By its key in a row. Raises UnknownName."""
    if key not in MEASURES:
        raise UnknownName("measure", key, MEASURES)
    return MEASURES[key]


def directed(keys: Sequence[str]) -> list[Measure]:
    """Of these, the ones of which more or less is better."""
    return [m for m in (measure(key) for key in keys) if m.larger is not None]


def is_time_or_place(column: str) -> bool:
    """True for columns that two runs of the same thing may differ in."""
    return column in PLACE or _TIME.search(column) is not None
