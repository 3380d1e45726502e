"""Every scenario by name, and one string that leads to any of them: built-in, file, folder, plug-in."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.modules import module_at
from tomthumb.scenarios.params import accepted, convert
from tomthumb.types import Scenario

GROUP = "tomthumb.scenarios"
WORDS = 500  # characters of a message about a path


@dataclass(frozen=True, slots=True)
class Entry:
    """A kind of scenario: its function as ``module:function``, the files it needs ("" for a simulator), a line of help.

    `marks` are file patterns of which one must be there for a folder or a file to be recognised as this kind.
    """

    name: str
    function: str
    needs: str
    help: str
    marks: tuple[str, ...] = ()


def _entry(name: str, where: str, needs: str, help: str, *marks: str) -> Entry:
    return Entry(name, f"tomthumb.scenarios.{where}", needs, help, marks)


CATALOGUE: tuple[Entry, ...] = (
    _entry("cloister", "cloister:cloister", "", "the paper's square cloister between double walls of 88 landmarks"),
    _entry("square", "worlds:square", "", "a square corridor of any size with landmarks on both sides"),
    _entry("random", "worlds:random", "", "a field of landmarks of any size and density, driven through at random"),
    _entry("golden", "golden:golden", "FILE.mat", "a recorded run of the reference cloister program", "s*_x*_*.mat"),
    _entry(
        "lost_in_the_woods",
        "lost_in_the_woods:lost_in_the_woods",
        "a folder with dataset2.mat",
        "UTIAS, indoor laser, 17 tubes, 21 minutes",
        "dataset2.mat",
    ),
    _entry(
        "car_park",
        "car_park:car_park",
        "a folder with data_set.mat, beac_juan3.mat, derived/",
        "ACFR, car with laser among 15 reflective poles, GPS",
        "beac_juan3.mat",
        "data_set.mat",
    ),
    _entry(
        "victoria_park",
        "victoria_park:victoria_park",
        "a folder with raw_acfr/, features/, derived/",
        "ACFR, car with laser among 299 trees, 4 km, 26 minutes",
        "raw_acfr/victoria_park_ascii.zip",
    ),
    _entry(
        "mrclam",
        "mrclam:mrclam",
        "a folder with Barcodes.dat, RobotN_*.dat",
        "UTIAS MRCLAM, any set, robot=1 to 5 with a camera among 15 barcode tubes",
        "Barcodes.dat",
        "Barcodes.dat.*",
        "*/Barcodes.dat",
        "*/Barcodes.dat.*",
    ),
    _entry(
        "dlr",
        "dlr:dlr",
        "map.circles(.gz), beside it derived/",
        "DLR Spatial Cognition, indoor camera, 576 circles, 505 m",
        "map.circles",
        "map.circles.gz",
    ),
    _entry(
        "slsjf",
        "courses:slsjf",
        "a folder with sensor_data.mat, store_*.mat",
        "simulated set of 2-D I-SLSJF",
        "store_beaconsTrue.mat",
        "*/store_beaconsTrue.mat",
    ),
    _entry(
        "freiburg",
        "courses:freiburg",
        "a folder with sensor_data.dat, world.dat",
        "landmark exercise of the Freiburg robot-mapping course",
        "sensor_data.dat",
    ),
    _entry(
        "cones",
        "cones:cones",
        "a folder with *perceptionLog*.txt, *velocityLog*.txt",
        "Formula Student lap, coloured cones, no truth",
        "*perceptionLog*.txt*",
    ),
    _entry(
        "track",
        "tracks:track",
        "FILE.yaml, .csv or .sdf",
        "a PacSim, FSSIM, EUFS or FSDS cone track as a simulated world",
        "*.yaml",
        "*.yml",
        "*.sdf",
    ),
    _entry(
        "graph",
        "graph_files:graph",
        "FILE.g2o, .graph, .toro, .txt",
        "a g2o, iSAM or TORO pose graph with landmarks, CityTrees10000 among them",
        "*.g2o*",
        "*.graph*",
        "*.toro*",
        "cityTrees*.txt*",
    ),
    _entry(
        "rosbag",
        "rosbag:load_bag",
        "a mapping FILE.toml that names the bag and its topics",
        "a ROS 1, ROS 2 or MCAP bag: see docs/logs.md",
    ),
    _entry(
        "jsonl",
        "jsonl:load_jsonl",
        "FILE.jsonl",
        "our own layout in one file; also what saving a scenario writes",
        "*.jsonl",
        "*.jsonl.gz",
        "*.jsonl.xz",
        "*.jsonl.bz2",
    ),
    _entry(
        "csv",
        "csv_layout:load_csv",
        "a folder with odometry.csv, observations.csv",
        "our own layout, for any log: see docs/csv-layout.md",
        "observations.csv",
        "observations.csv.*",
        "odometry.csv",
        "odometry.csv.*",
        "scenario.toml",
    ),
)


BUILT_IN = {entry.name: entry for entry in CATALOGUE}


def entries() -> dict[str, Entry]:
    """All kinds by name: the built-in ones, then those of installed plug-ins (which may not replace a built-in one)."""
    found = dict(BUILT_IN)
    for point in entry_points(group=GROUP):
        found.setdefault(point.name, Entry(point.name, point.value, "", f"plug-in {point.value}"))
    return found


def load(spec: str, seed: int = 0, **params: Any) -> Scenario:
    """The scenario that `spec` means.

    A name from the catalogue; ``kind:path?key=value&...``; a folder or file, recognised by what it holds; a simulator
    or loader of your own as ``package.module:function`` or ``./file.py:function``. `params` (text or values) join those
    of the spec and win over them; a key ending in ``_deg`` is turned to radians. `seed` feeds simulators. Any scenario
    takes ``kidnap="AT:TO"``: after step AT the robot is carried to step TO (`scenarios.kidnap`).

    Raises UnknownName for names, TomThumbError for parameters and paths that do not fit, BrokenFile for broken files.
    """
    plain, query = _split(spec)
    given = {**query, **params}
    kidnap = given.pop("kidnap", None)
    made = _found(plain, given, seed)
    if kidnap is None:
        return made
    from tomthumb.scenarios.kidnap import carried_away

    return carried_away(made, str(kidnap))


def _found(plain: str, given: Mapping[str, Any], seed: int) -> Scenario:
    kind, _, path = plain.partition(":")
    known = BUILT_IN if kind in BUILT_IN else entries()  # looking for plug-ins takes longer than loading a small log
    if plain in known:
        entry = known[plain]
        if entry.needs:
            raise TomThumbError(f"{plain} needs {entry.needs}: give it as {plain}:PATH")
        return call(_function(entry.function), plain, None, seed, given)
    if kind in known and path:
        return call(_function(known[kind].function), kind, Path(path), seed, given)
    if _is_code(plain):
        return call(_function(plain), plain, None, seed, given)
    if _there(Path(plain)):
        entry = recognise(Path(plain))
        return call(_function(entry.function), entry.name, Path(plain), seed, given)
    if "/" in plain or Path(plain).suffix:
        raise TomThumbError(f"{plain}: no such file or folder")
    raise UnknownName("scenario", kind, known)


def _there(path: Path) -> bool:
    """Whether there is such a path; False too for one that cannot be, being too long or not ours to look at."""
    try:
        return path.exists()
    except OSError:
        return False


def call(function: Callable[..., Any], name: str, path: Path | None, seed: int, given: Mapping[str, Any]) -> Scenario:
    """A loader or simulator called with what its signature asks for: `path`, `rng`, and the parameters `given`."""
    wants = accepted(function)
    arguments = convert(function, given, name, skip=("path", "folder", "rng"))
    if "rng" in wants:
        arguments["rng"] = np.random.default_rng(seed)
    first = next((key for key in ("path", "folder") if key in wants), None)
    if path is not None and first is None:
        raise TomThumbError(f"{name} takes no path, but {path} is given")
    if path is None and first is not None:
        raise TomThumbError(f"{name} needs a path")
    if first is not None:
        arguments[first] = path
    missing = [k for k, p in wants.items() if p.default is inspect.Parameter.empty and k not in arguments]
    if missing:
        raise TomThumbError(f"{name}: {', '.join(missing)} must be given")
    try:
        made = function(**arguments)
    except OSError as error:
        if path is None:
            raise  # no file of ours to blame: the function's own fault to show
        raise TomThumbError(f"{name}: {error.filename or path}: {error.strerror or error}"[:WORDS]) from None
    if not isinstance(made, Scenario):
        raise TomThumbError(f"{name} gave a {type(made).__name__}, not a Scenario")
    return made


def parameters(name: str) -> dict[str, Any]:
    """The parameters of a kind of scenario with their defaults. Raises UnknownName."""
    known = entries()
    if name not in known:
        raise UnknownName("scenario", name, known)
    found = accepted(_function(known[name].function), skip=("path", "folder", "rng"))
    return {key: p.default for key, p in found.items()}


def recognise(path: Path) -> Entry:
    """The kind of log that a file is, or that a folder holds. Raises TomThumbError where none fits."""
    for entry in CATALOGUE:
        for mark in entry.marks:
            if path.match(mark) if path.is_file() else any(path.glob(mark)):
                return entry
    hint = "a file" if path.is_file() else "a folder"
    kinds = ", ".join(entry.name for entry in CATALOGUE if entry.needs)
    raise TomThumbError(f"{path}: {hint} of no known kind; give it as KIND:PATH with one of {kinds}")


def _split(spec: str) -> tuple[str, dict[str, str]]:
    plain, mark, query = spec.partition("?")
    out: dict[str, str] = {}
    for part in query.split("&") if mark else ():
        key, equals, value = part.partition("=")
        if not equals or not key:
            raise TomThumbError(f"{spec}: {part!r} is not key=value")
        out[unquote(key)] = unquote(value)
    return plain, out


def _is_code(spec: str) -> bool:
    """True for ``file.py:name`` and for ``package.module:name`` of identifiers."""
    where, colon, name = spec.rpartition(":")
    if not colon or not name.isidentifier():
        return False
    return where.endswith(".py") or all(part.isidentifier() for part in where.split("."))


def _function(where: str) -> Callable[..., Any]:
    """The function at ``module:name`` or ``file.py:name``. Raises TomThumbError where there is none."""
    module_name, _, name = where.rpartition(":")
    module = module_at(module_name, where)
    function = getattr(module, name, None)
    if not callable(function):
        raise UnknownName(f"function in {module_name}", name, [k for k, v in vars(module).items() if callable(v)])
    return function  # type: ignore[no-any-return]
