"""A run as a recording for the rerun viewer (extra: rerun)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from tomthumb.types import Array, Scenario, Trace

ROBOT, TRUTH, STONE, CRUMB, PAIR = (38, 84, 124), (60, 60, 60), (200, 60, 40), (220, 180, 160), (120, 180, 120)


def save_rrd(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """Poses, observations with the landmarks they were given to, the map and, if known, the truth, along the time.

    Points are three-dimensional with z = 0, so that left stays left (the viewer's flat view has y pointing down).
    """
    recording = rr.RecordingStream("tomthumb")
    recording.save(str(path))
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _map(recording, trace, scenario)
    steps = iter(scenario.steps) if scenario is not None else iter(())
    for k in range(len(trace.t)):
        recording.set_time("time", duration=float(trace.t[k] - trace.t[0]))
        recording.set_time("step", sequence=k)
        _pose(recording, trace.pose[: k + 1])
        step = next(steps, None)
        if step is not None and step.observations is not None and scenario is not None:
            seen = _flat(scenario.sensor.locate(trace.pose[k], step.observations.z)[0])
            recording.log("world/observations", rr.Points3D(seen, colors=PAIR, radii=0.04))
        if step is not None and step.truth is not None and step.truth.pose is not None:
            recording.log("world/true_robot", rr.Points3D(_flat(step.truth.pose[None, :2]), colors=TRUTH, radii=0.1))
    recording.flush()


def _map(recording: rr.RecordingStream, trace: Trace, scenario: Scenario | None) -> None:
    colours = [STONE if stone else CRUMB for stone in trace.final.stone]
    points = rr.Points3D(_flat(trace.final.landmarks), colors=colours, radii=0.06)
    recording.log("world/map", points, static=True)
    if scenario is not None and scenario.landmarks is not None:
        real = scenario.landmarks[np.isfinite(scenario.landmarks).all(1)]
        recording.log("world/true_landmarks", rr.Points3D(_flat(real), colors=TRUTH, radii=0.03), static=True)


def _pose(recording: rr.RecordingStream, way: Array) -> None:
    """The robot as an arrow, and the last bit of its way (the viewer keeps what came before)."""
    x, y, heading = way[-1]
    arrow = rr.Arrows3D(origins=[[x, y, 0.0]], vectors=[[np.cos(heading), np.sin(heading), 0.0]], colors=ROBOT)
    recording.log("world/robot", arrow)
    recording.log(f"world/trajectory/{len(way)}", rr.LineStrips3D([_flat(way[-2:, :2])], colors=ROBOT))


def _flat(points: Array) -> Array:
    return np.column_stack([points, np.zeros(len(points))])
