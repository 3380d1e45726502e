"""Which figures of a run stand in which table, and how they are written: the terminal and the page share this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Column:
    """One metric: its key in the row, heading, format, factor before formatting, and what it means."""

    key: str
    heading: str
    form: str
    factor: float
    meaning: str

    def text(self, row: Mapping[str, Any]) -> str:
        """The value as written; a dash where it is not known."""
        value = row.get(self.key)
        return "–" if value is None else format(value * self.factor, self.form)


OVERVIEW = (
    Column(
        "match_rate", "match %", ".2f", 100, "right decisions of all scored observations, pairings and non-pairings"
    ),
    Column("precision", "precision %", ".2f", 100, "right pairings of all pairings"),
    Column("recall", "recall %", ".2f", 100, "right pairings of those that were to be had"),
    Column("wrong_ids", "wrong ids", "d", 1, "observations paired with another landmark than their own"),
    Column("fn", "missed", "d", 1, "left unpaired though their landmark was in the map"),
    Column("duplicates", "dupl.", "d", 1, "landmarks mapped more than once, at the end"),
    Column("rmse_x_m", "RMS x m", ".3f", 1, "root mean square error in x, without alignment"),
    Column("rmse_y_m", "RMS y m", ".3f", 1, "root mean square error in y, without alignment"),
    Column("ate_m", "ATE m", ".3f", 1, "root mean square error of the positions after rigid alignment"),
    Column("map_rmse_m", "map m", ".3f", 1, "root mean square error of the landmarks after rigid alignment"),
    Column("nees", "NEES", ".2f", 1, "average normalised squared error of the pose; 3 is right"),
    Column("associate_us_p50", "assoc. µs", ".0f", 1, "median time of one scan's association"),
)

NARROW = ("match_rate", "wrong_ids", "fn", "duplicates", "rmse_x_m", "rmse_y_m", "nees", "associate_us_p50")

GROUPS: dict[str, tuple[Column, ...]] = {
    "Associations": (
        *OVERVIEW[:6],
        Column("purity", "purity %", ".2f", 100, "observations that agree with the majority of their landmark"),
        Column("idf1", "IDF1 %", ".2f", 100, "observations on the one landmark assigned to their true one"),
        Column("match_rate_final", "final match %", ".2f", 100, "match rate after later revision and merging"),
        Column("scans_right", "scans right %", ".2f", 100, "scans in which every decision is right"),
        Column("ghosts", "ghosts", "d", 1, "confirmed landmarks that are clutter"),
        Column("landmarks", "landmarks", "d", 1, "confirmed landmarks (stones) at the end"),
        Column("crumbs", "crumbs", "d", 1, "tentative landmarks at the end"),
    ),
    "Trajectory": (
        *OVERVIEW[6:9],
        Column("ate_raw_m", "ATE raw m", ".3f", 1, "the same without alignment"),
        Column("ate_final_m", "ATE final m", ".3f", 1, "aligned, after later revision"),
        Column("rmse_heading_deg", "RMS heading deg", ".3f", 1, "root mean square error of the heading"),
        Column("rpe_m", "RPE m", ".3f", 1, "error of the motion over each metre of the true path"),
        Column("rpe_heading_deg", "RPE deg", ".3f", 1, "the same, of the turn"),
        Column("end_error_m", "end m", ".3f", 1, "error of the last position"),
        Column("largest_error_m", "largest m", ".3f", 1, "largest error of a position"),
    ),
    "Consistency": (
        Column("nees", "NEES", ".2f", 1, "average normalised squared error of the pose; 3 is right"),
        Column("nees_inside", "NEES inside %", ".1f", 100, "steps within the 95 % band of one value"),
        Column("nis", "NIS / dof", ".3f", 1, "average normalised squared innovation; 1 is right"),
        Column("nis_low", "NIS low", ".3f", 1, "lower end of its 95 % band"),
        Column("nis_high", "NIS high", ".3f", 1, "upper end of its 95 % band"),
    ),
    "Map": (
        Column("map_rmse_m", "RMSE m", ".3f", 1, "error of the landmarks after rigid alignment"),
        Column("map_rmse_raw_m", "RMSE raw m", ".3f", 1, "the same without alignment"),
        Column("gospa_m", "GOSPA m", ".3f", 1, "error, missed and false landmarks in one (cutoff 0.5 m)"),
    ),
    "Cost": (
        Column("steps", "steps", "d", 1, "steps run"),
        Column("observations", "observations", "d", 1, "observations taken in"),
        Column("step_ms_p50", "step ms", ".2f", 1, "median time of a step"),
        Column("associate_us_p50", "assoc. µs", ".0f", 1, "median time of one scan's association"),
        Column("associate_us_p99", "assoc. µs p99", ".0f", 1, "99th percentile of the same"),
        Column("run_s", "run s", ".2f", 1, "time of the whole run"),
        Column("real_time_factor", "x real time", ".1f", 1, "duration of the log by the time of the run"),
    ),
}
