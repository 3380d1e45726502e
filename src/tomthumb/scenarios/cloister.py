"""The reference cloister: a robot walks round a square between two double walls of landmarks.

The world of the EKF-SLAM exercise of J. Neira and J. D. Tardos, re-implemented from its numbers. References: J. Neira,
J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE T-RA 17(6), 2001.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from tomthumb.geometry import rotation
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import Cartesian
from tomthumb.scenarios.looks import Dress, dressed
from tomthumb.scenarios.simulate import DETECT_CAP, EDGE, Eye, Streams, path, require, scans
from tomthumb.types import Array, Control, Prior, Scenario, Step, Truth

SIDE = 10.0  # m
MOVES, TURNS = 32, 10  # per side
LAP = 4 * (MOVES + TURNS)  # 168 motions
LAST_SIDE = 3 * (MOVES + TURNS)  # the motion that begins it
OUTER, INNER = (-0.60, -0.35), (0.35, 0.60)  # m, the rows right and left of the path

# The reference scales the translation noise by the square root of the step's length, applied to the variance.
MOVE_STD = math.sqrt(math.sqrt(SIDE / MOVES)) * np.array([0.01, 0.01, math.radians(2.0)])
TURN_STD = np.array([0.03, 0.03, math.radians(0.25)])
BLIND_STD = np.array([0.25, 0.1, math.radians(5.0)])
EYE = Eye(3.5, math.pi, range_share=0.01, bearing_std=math.radians(0.125), cartesian=True)

WALK_STD, WALK_ACCELERATION, WALK_MAX = 0.05, 0.01, 0.15  # m a step


def cloister(
    rng: np.random.Generator,
    *,
    laps: int = 1,
    teach: int = 0,
    people: int = 0,
    odometry_noise: float = 1.0,
    odometry: Literal["wheels", "none"] = "wheels",
    sensor_noise: float = 1.0,
    clutter: float = 0.0,
    detect: float = 1.0,
    spacing: float = 2.0,
    jitter: float = 0.0,
    occlusion: bool = False,
    classes: int = 0,
    confusion: float = 0.0,
    diameter_std: float = 0.0,
    route: Literal["round", "reversed", "shuttle"] = "round",
    faithful: bool = False,
) -> Scenario:
    """The cloister, with everything that makes it harder as an option; the defaults are the reference's.

    Step 0 is the first scan, at the exact start; each of the others is a motion and the scan after it. `laps` rounds of
    168 motions are generated and the last motion of the last round is left out, as in the reference: so there are
    ``168 * laps`` scans, a whole number to each lap, and the last true pose is (0, 0, -9 deg). The first `teach` laps
    are taught by the oracle and not scored. The truth is free of noise, which is in the odometry reading; the filter is
    told twice its variance. `odometry_noise` and `sensor_noise` multiply standard deviations; `odometry="none"` reads
    (0, 0, 0). `people` walk through the square, at most 0.15 m a step, and are observed like landmarks; `clutter` is a
    mean per scan; `detect` a probability; `spacing` m along a row; `jitter` m a Gaussian shift of every landmark; with
    `occlusion` posts 0.1 m wide hide what is behind them. `classes`, `confusion` and `diameter_std` say what the posts
    look like (`looks.Dress`). After the taught laps the robot goes on as before ("round"), turns about and walks the
    laps the other way ("reversed"), or walks there and back along the first two sides ("shuttle"). `faithful` changes
    nothing here: the filter's reference mode reads it from `info`.

    Raises TomThumbError for values out of range.
    """
    _check(laps, teach, people, odometry_noise, odometry, sensor_noise, clutter, detect, spacing, jitter, route)
    streams = Streams.of(rng)
    dress = Dress(classes, confusion, diameter_std)
    dress.check("cloister")
    eye = replace(_noisier(sensor_noise), detect=detect, clutter=clutter, occlusion=occlusion)
    motions, stds = _motions(laps, teach, route)
    poses = path(np.zeros(3), list(motions))
    landmarks = _shaken(posts(spacing), jitter, streams.jitter)
    crowd = walk(people, len(poses), streams.people)
    seen = scans(eye, poses, landmarks, streams, crowd, _edges(len(poses)))
    seen = dressed(seen, len(landmarks), dress, streams.layout)
    controls = _controls(motions, stds, odometry, odometry_noise, streams.odometry)
    moments = enumerate(zip(controls, poses, seen, strict=True))
    return Scenario(
        name="cloister",
        motion=OdometryIncrement(std=_triple(MOVE_STD)),
        sensor=_sensor(eye),
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        steps=[Step(float(k), control, z, Truth(pose, ids)) for k, (control, pose, (z, ids)) in moments],
        landmarks=landmarks,
        score_from=max(1, teach * LAP),
        teach_steps=teach * LAP,
        info={"faithful": faithful, "lap_steps": LAP, "people": people},
    )


def _noisier(times: float) -> Eye:
    """The reference's sensor with its standard deviations multiplied."""
    return replace(EYE, range_share=EYE.range_share * times, bearing_std=EYE.bearing_std * times)


def _shaken(points: Array, std: float, rng: np.random.Generator) -> Array:
    shaken: Array = points + std * rng.standard_normal(points.shape)
    return shaken


def _sensor(eye: Eye) -> Cartesian:
    """What the filter is told of the sensor: nothing of people."""
    detect = min(eye.detect, DETECT_CAP)
    return Cartesian(max_range=eye.max_range, fov=eye.fov, detect=detect, clutter=eye.clutter_density)


def posts(spacing: float = 2.0) -> Array:
    """The landmarks (n, 2) m of the four sides, side by side, row by row; 88 of them at a spacing of 2 m."""
    outer = np.arange(0.0, SIDE + 1e-9, spacing)
    inner = np.arange(spacing / 2, SIDE + 1e-9, spacing)
    rows = [np.column_stack([x, np.full(len(x), y)]) for ys, x in ((OUTER, outer), (INNER, inner)) for y in ys]
    first = np.vstack(rows)
    second = first @ rotation(math.pi / 2).T + [SIDE, 0.0]
    return np.vstack([first, second, SIDE - first, SIDE - second])


def walk(people: int, steps: int, rng: np.random.Generator) -> Array:
    """Where `people` walkers are at each of `steps` moments (steps, people, 2) m, kept in the square of the path."""
    place = SIDE * rng.random((people, 2))
    velocity = WALK_STD * rng.standard_normal((people, 2))
    places = np.empty((steps, people, 2))
    for k in range(steps):
        places[k] = place
        velocity = velocity + WALK_ACCELERATION * rng.standard_normal((people, 2))
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        velocity = velocity * np.minimum(1.0, WALK_MAX / np.maximum(speed, 1e-12))[:, None]
        place = place + velocity
        outside = (place < 0.0) | (place > SIDE)
        place = np.where(place < 0.0, -place, np.where(place > SIDE, 2 * SIDE - place, place))
        velocity = np.where(outside, -velocity, velocity)
    return places


def _edges(steps: int) -> Array:
    """By how much the field of view is opened at each step, rad.

    Posts stand exactly abeam, at +-90 deg, three times a side. In the reference rounding lets them be seen on the first
    three sides and not on the last; its 1390 observations hang on that, and ours must not hang on anybody's rounding.
    """
    return np.where(np.arange(steps) % LAP < LAST_SIDE, EDGE, -EDGE)


Route = list[tuple[int, float]]  # motions and turns: (how many, rad each; 0 walks)


def _motions(laps: int, teach: int, route: str) -> tuple[Array, Array]:
    """The true motions (n, 3), 168 laps - 1 of them on the usual route, and the standard deviations of their readings."""
    left = math.pi / 2 / TURNS
    round_about: Route = [(MOVES, 0.0), (TURNS, left)] * 4
    after: Route = round_about * (laps - teach)
    if route == "reversed":
        after = [(TURNS, left), *([(MOVES, 0.0), (TURNS, -left)] * 4 * (laps - teach))]
    if route == "shuttle":
        there: Route = [(MOVES, 0.0), (TURNS, left), (MOVES, 0.0), (2 * TURNS, left)]
        back: Route = [(MOVES, 0.0), (TURNS, -left), (MOVES, 0.0), (2 * TURNS, left)]
        after = [*there, *back] * (laps - teach)
    parts = [(n, turn) for n, turn in [*(round_about * teach), *after] for _ in range(n)]
    turns = np.array([turn for _, turn in parts])
    walks = turns == 0.0
    motions = np.column_stack([np.where(walks, SIDE / MOVES, 0.0), np.zeros(len(turns)), turns])
    return motions[:-1], np.where(walks[:, None], MOVE_STD, TURN_STD)[:-1]


def _controls(
    motions: Array, stds: Array, odometry: str, multiplier: float, rng: np.random.Generator
) -> list[Control | None]:
    """What the odometry says of each motion; nothing before the first scan."""
    noise = rng.standard_normal(motions.shape)
    if odometry == "none":
        cov = np.diag((multiplier * BLIND_STD) ** 2)
        return [None, *(Control(np.zeros(3), 1.0, cov) for _ in motions)]
    stds = multiplier * stds
    readings = motions + stds * noise
    return [None, *(Control(u, 1.0, np.diag(2.0 * std**2)) for u, std in zip(readings, stds, strict=True))]


def _check(
    laps: int,
    teach: int,
    people: int,
    odometry_noise: float,
    odometry: str,
    sensor_noise: float,
    clutter: float,
    detect: float,
    spacing: float,
    jitter: float,
    route: str,
) -> None:
    require(laps >= 1, f"cloister: laps={laps}: at least 1")
    require(0 <= teach < laps, f"cloister: teach={teach} of laps={laps}: 0 to {laps - 1}, a lap must be left to score")
    require(people >= 0, f"cloister: people={people}: 0 or more")
    require(0.0 <= odometry_noise < math.inf, f"cloister: odometry_noise={odometry_noise}: 0 or more")
    require(odometry in ("wheels", "none"), f"cloister: odometry={odometry!r}: 'wheels' or 'none'")
    require(0.0 < sensor_noise < math.inf, f"cloister: sensor_noise={sensor_noise}: more than 0")
    require(0.0 <= clutter < 1e4, f"cloister: clutter={clutter}: a mean per scan, 0 to 10000")
    require(0.0 < detect <= 1.0, f"cloister: detect={detect}: a probability above 0, at most 1")
    require(0.02 <= spacing <= SIDE, f"cloister: spacing={spacing}: 0.02 to {SIDE:g} m")
    require(route in ("round", "reversed", "shuttle"), f"cloister: route={route!r}: 'round', 'reversed' or 'shuttle'")
    require(0.0 <= jitter < math.inf, f"cloister: jitter={jitter}: 0 or more, m")


def _triple(std: Array) -> tuple[float, float, float]:
    return float(std[0]), float(std[1]), float(std[2])
