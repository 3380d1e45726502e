"""Results on their way out: TUM, KITTI, g2o, CSV, Parquet, JSON, .rrd for the rerun viewer, GIF and MP4, ROS bags.

Every exporter is one function ``(trace, path, scenario) -> None``; `scenario` may be None where the format needs no
more than the trace.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.types import Scenario, Trace


@dataclass(frozen=True, slots=True)
class Format:
    """A way out: its function as ``module:function``, what it makes, its suffix ("" for a folder), the extra needed."""

    name: str
    function: str
    help: str
    suffix: str
    extra: str = ""
    needs_scenario: bool = False


FORMATS = {
    f.name: f
    for f in (
        Format("tum", "text:save_tum", "trajectory: t x y z qx qy qz qw (evo, TUM tools)", ".tum"),
        Format("kitti", "text:save_kitti", "trajectory: a 3 x 4 matrix a line (evo, KITTI tools)", ".kitti"),
        Format("json", "text:save_json", "trajectory, map and identities in one object, null for the unknown", ".json"),
        Format("csv", "text:save_csv", "a folder with trajectory.csv, map.csv, observations.csv", ""),
        Format("g2o", "g2o:save_g2o", "factor graph with the identities found", ".g2o", needs_scenario=True),
        Format("parquet", "parquet:save_parquet", "a folder of the CSV tables as Parquet", "", extra="parquet"),
        Format("rrd", "rrd:save_rrd", "recording for the rerun viewer", ".rrd", extra="rerun"),
        Format("gif", "animation:save_animation", "animation of the run", ".gif"),
        Format("mp4", "animation:save_animation", "film of the run (needs ffmpeg)", ".mp4"),
        Format("rosbag", "rosbag:save_bag", "ROS 2 bag: odometry, path, markers", "", extra="ros"),
    )
}


def export(trace: Trace, path: Path, *, format: str | None = None, scenario: Scenario | None = None) -> None:
    """Write a run in one of `FORMATS`, told by the suffix of `path` where `format` is None.

    Raises UnknownName for a format that is not there, TomThumbError where an extra or the scenario is missing or the
    path cannot be written.
    """
    chosen = _by_suffix(path) if format is None else FORMATS.get(format)
    if chosen is None:
        raise UnknownName("format", format or path.suffix, FORMATS)
    if chosen.needs_scenario and scenario is None:
        raise TomThumbError(f"{chosen.name} needs the scenario of the run, not the trace alone")
    module, _, function = chosen.function.partition(":")
    try:
        save = getattr(import_module(f"tomthumb.export.{module}"), function)
        save(trace, path, scenario)
    except ModuleNotFoundError as error:
        if not chosen.extra:
            raise
        raise TomThumbError(f"{chosen.name} needs {error.name}: pip install 'tomthumb[{chosen.extra}]'") from None
    except OSError as error:
        raise TomThumbError(f"{path}: cannot be written: {error.strerror or error}") from None


def _by_suffix(path: Path) -> Format | None:
    return next((f for f in FORMATS.values() if f.suffix and f.suffix == path.suffix), None)
