"""One run: a scenario, an associator and an estimator in, a `Trace` out. Nothing computed is lost when a filter diverges."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from tomthumb.branches import Branch, merged_into, renamed, told
from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.king import King
from tomthumb.lifecycle import LifeCycle
from tomthumb.protocols import Learner
from tomthumb.scout import Scouting
from tomthumb.slam import Slam
from tomthumb.types import Array, Estimate, Ids, Lessons, Scenario, StepRecord, Trace

Settings = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Loop:
    """Settings of the loop (``slam.KEY``) beside those of the life cycle.

    width: branches side by side. faithful: the reference program's life cycle. frozen: a map to start in stays as it is.
    king, loops, lost, and the `revision` window in scans (0: none): docs/lost.md.
    """

    width: int = 1
    faithful: bool = False
    frozen: bool = False
    king: bool = False
    loops: bool = False
    lost: bool = False
    revision: int = 0

    def __post_init__(self) -> None:
        if self.width < 1 or self.revision < 0:
            raise TomThumbError(
                f"slam.width={self.width}, slam.revision={self.revision}: at least 1 branch, and a window of 0 or more"
            )


def run(
    scenario: Scenario,
    *,
    associator: Any = "stt",
    estimator: Any = "iekf",
    seed: int = 0,
    settings: Settings | None = None,
    start_map: Estimate | None = None,
    lessons: Lessons | None = None,
    progress: Callable[[StepRecord], None] | None = None,
) -> Trace:
    """Run a scenario to its end, or until the filter diverges (then `failure` says why, and the trace ends there).

    `associator` and `estimator` are names, or objects that follow the protocols. `settings` may hold "associator",
    "estimator" and "slam": keyword arguments of each. `start_map` is a saved map to start in (`storage.load_map`); it
    goes on growing unless ``slam.frozen``; `lessons` are what an associator with a memory had learned about its landmarks
    (`storage.load_lessons`). Raises `TomThumbError`.
    """
    slam = prepare(
        scenario, associator=associator, estimator=estimator, seed=seed, settings=settings, start_map=start_map,
        lessons=lessons,
    )  # fmt: skip
    records = []
    for record in slam.stream(scenario.steps):
        records.append(record)
        if progress is not None:
            progress(record)
    return collect(scenario.name, slam, records)


def prepare(
    scenario: Scenario,
    *,
    associator: Any = "stt",
    estimator: Any = "iekf",
    seed: int = 0,
    settings: Settings | None = None,
    start_map: Estimate | None = None,
    lessons: Lessons | None = None,
) -> Slam:
    """A `Slam` ready for the scenario's steps: parts built by name, teacher hired, map loaded, random streams apart."""
    chosen: dict[str, dict[str, Any]] = {"associator": {}, "estimator": {}, "slam": {}}
    for part, values in (settings or {}).items():
        if part not in chosen:
            raise UnknownName("group of settings", part, chosen)
        chosen[part].update(values)
    policy, loop = _policy(chosen["slam"])
    truth = scenario.true_ids() if associator == "oracle" or scenario.teach_steps else None
    teacher = _oracle(truth) if scenario.teach_steps and truth is not None else None
    built = _oracle(truth) if associator == "oracle" and truth is not None else _build("associator", associator, chosen)
    seeds = np.random.SeedSequence([seed, 7]).spawn(2)
    slam = Slam(
        scenario.motion, scenario.sensor, scenario.prior, built,
        _build("estimator", estimator, chosen, motion=scenario.motion, sensor=scenario.sensor),
        policy=policy, width=loop.width, teacher=teacher, teach_steps=scenario.teach_steps,
        rng=(np.random.default_rng(seeds[0]), np.random.default_rng(seeds[1])),
        king=_king(loop, associator == "oracle"),
    )  # fmt: skip
    slam.court.scouting = Scouting() if loop.loops and associator != "oracle" else None
    slam.revision.window = loop.revision
    if start_map is not None:
        names = _start_in(slam, scenario, start_map, associator == "oracle", loop.frozen)
        if lessons is not None and isinstance(slam.associator, Learner):
            slam.associator.remind(lessons.renamed(names))
    if loop.lost:
        _lost(slam, start_map)
    return slam


def _king(loop: Loop, oracle: bool) -> King | None:
    """The oracle needs no king: it is never lost. Who starts lost needs one."""
    return King() if (loop.king or loop.lost) and not oracle else None


def _lost(slam: Slam, start_map: Estimate | None) -> None:
    """Somewhere in a map, nobody knows where."""
    if start_map is None or slam.court.king is None:
        raise TomThumbError("slam.lost=true needs a map to be lost in (--map), and an associator other than the oracle")
    slam.court.lose_the_way(slam, slam.branches[0], believed=False)


def _start_in(slam: Slam, scenario: Scenario, start_map: Estimate, oracle: bool, frozen: bool) -> dict[int, int]:
    from tomthumb.known_map import start_in

    if oracle or scenario.teach_steps:
        raise TomThumbError("the oracle knows landmarks by their first observation, not those of a saved map")
    return start_in(slam, start_map, frozen)


def _oracle(truth: Ids | None) -> Any:
    from tomthumb.associators.oracle import Oracle

    assert truth is not None
    return Oracle(truth)


def _build(kind: str, name: Any, chosen: Mapping[str, Mapping[str, Any]], **given: Any) -> Any:
    from tomthumb import registry

    return registry.build(kind, name, chosen[kind], **given) if isinstance(name, str) else name


def _policy(values: Mapping[str, Any]) -> tuple[LifeCycle, Loop]:
    """The life cycle and what else the loop is told, from ``slam.`` settings. Raises UnknownName, TomThumbError."""
    from tomthumb import registry

    takes = {**registry.parameters_of(LifeCycle), **registry.parameters_of(Loop)}
    for key in values:
        if key not in takes:
            raise UnknownName("setting of slam", key, takes)
    checked = {key: registry.checked(f"slam.{key}", value, takes[key]) for key, value in values.items()}
    loop = Loop(**{f.name: checked.pop(f.name) for f in fields(Loop) if f.name in checked})
    policy = LifeCycle(**checked)
    if loop.frozen:
        from tomthumb.known_map import frozen_policy

        policy = frozen_policy(policy)
    return (policy.faithful() if loop.faithful else policy), loop


def collect(name: str, slam: Slam, records: list[StepRecord]) -> Trace:
    """The records stacked, with what later merging and revision made of them."""
    best = slam.branches[0]
    died, merged = _events(best)
    final_ids, final_pose = _history(best, len(records))
    final, who = slam.estimate(), slam.associator
    return Trace(
        scenario=name,
        t=np.array([r.t for r in records]),
        pose=np.array([r.pose for r in records]).reshape(-1, 3),
        pose_cov=np.array([r.pose_cov for r in records]).reshape(-1, 3, 3),
        offsets=np.concatenate([[0], np.cumsum([len(r.ids) for r in records])]).astype(np.int64),
        ids=_joined([r.ids for r in records], np.int64),
        paired=_joined([r.paired for r in records], bool),
        with_stone=_joined([r.with_stone for r in records], bool),
        seconds=np.array([r.seconds for r in records]).reshape(-1, 4),
        nis=np.array([r.nis for r in records]),
        dof=np.array([r.dof for r in records], np.int64),
        died=died,
        merged=merged,
        final=final,
        failure=slam.failure,
        final_ids=renamed(final_ids, merged_into(best)),
        final_pose=final_pose,
        lessons=who.recall(final.ids[final.stone]) if isinstance(who, Learner) else None,
    )


def _joined(parts: list[Any], dtype: Any) -> Any:
    return np.concatenate(parts).astype(dtype) if parts else np.empty(0, dtype)


def _events(branch: Branch) -> tuple[Ids, Ids]:
    died = [(one, step) for kind, one, _, step in told(branch) if kind == "died"]
    merged = [(one, other, step) for kind, one, other, step in told(branch) if kind == "merged"]
    return np.array(died, np.int64).reshape(-1, 2), np.array(merged, np.int64).reshape(-1, 3)


def _history(branch: Branch, steps: int) -> tuple[Ids, Array]:
    """Ids and poses of the best branch's own past, which may differ from what was given out at the time."""
    ids: list[Ids] = []
    poses: list[Array] = []
    node = branch.history
    while node is not None and len(poses) < steps:
        node, step_ids, pose, _ = node
        ids.append(step_ids)
        poses.append(pose)
    return _joined(ids[::-1], np.int64), np.array(poses[::-1]).reshape(-1, 3)
