"""The scout: a brother who remembers the last scans only, and so finds out when the family walks where it has been before.

Scan by scan a long loop does not close: the filter is sure of a pose that is metres off, and displaced observations find
wrong partners. The scout maps the last scans afresh, without the old map. What he has seen lately is right among itself,
and fits into the old map at one place only, within the drift that odometry may have gathered. If the family has named
those landmarks otherwise, a loop was missed: the trail is gone over again with the scout's names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import Fit, fits
from tomthumb.geometry import compose, wrap_angle
from tomthumb.king import Exile, King, Return, clear, judged
from tomthumb.retrace import Diary, Entry, retrace
from tomthumb.revision import twin_of
from tomthumb.types import Array, Estimate, Ids

if TYPE_CHECKING:
    from tomthumb.slam import Slam

CERTAIN = 1e-12 * np.eye(3)
import os
SLACK = float(os.environ.get('SLACK','1.5'))


@dataclass(frozen=True, slots=True)
class Scouting:
    """every: scans between two looks. window: scans that the scout remembers. drift: m per m of path, rad per m: what
    odometry may have gathered. poses: of the trail, from which old landmarks would have been seen.
    """

    every: int = 5
    window: int = 100
    drift: tuple[float, float] = (0.05, 0.005)
    poses: int = 12


@dataclass(slots=True)
class Scout:
    """The scout's own loop, and the diary of the whole run."""

    rules: Scouting
    loop: Slam | None = None
    diary: Diary = None  # type: ignore[assignment]
    noise: list = field(default_factory=list)
    path: list = field(default_factory=list)
    where: Any = None

    def step(self, slam: Slam, t: float, control: Any, observations: Any) -> None:
        if self.loop is None:
            self.diary = Diary(slam.estimator.fork(slam.branches[0].belief))
            self.loop = send(slam)
        self.diary.entries.append(Entry(t, control))
        self.loop.step(t, control, observations)
        pose = slam.estimator.pose(self.loop.branches[0].belief)[0]
        gone = 0.0 if self.where is None else float(np.hypot(*(pose - self.where)[:2]))
        self.where = pose
        if observations is not None:
            self.path.append((self.path[-1] if self.path else 0.0) + gone)
        if observations is not None and self.loop.scan % 10 == 0:
            forget(self.loop, self.rules.window)


def send(slam: Slam) -> Slam:
    """A loop without a map that begins where the family believes to be."""
    scout = twin_of(slam)
    pose, _ = slam.estimator.pose(slam.branches[0].belief)
    scout.branches = [Branch(slam.estimator.init(pose, CERTAIN, slam.rng_estimator), {})]
    scout.teacher, scout.teach_steps, scout.width = None, 0, 1
    return scout


def forget(scout: Slam, window: int) -> None:
    """What was not seen within the window is forgotten."""
    branch = scout.branches[0]
    gone = np.array([i for i, life in branch.ledger.items() if scout.scan - life.seen > window], np.int64)
    if len(gone):
        branch.belief = scout.estimator.forget(branch.belief, gone)
        branch.crumbs.difference_update(gone.tolist())
        for i in gone.tolist():
            del branch.ledger[i]


@dataclass(frozen=True, slots=True)
class Missed:
    """A loop that was missed: which of the scout's landmarks is which old one, and the scan it is known since."""

    way: Return
    since: int


def missed_loop(king: King, scout: Scout, slam: Slam) -> Missed | None:
    rules, loop = scout.rules, scout.loop
    since = slam.scan - rules.window
    mine = loop.branches[0]
    seen = loop.estimator.estimate(mine.belief)
    q, ids = seen.landmarks[seen.stone], seen.ids[seen.stone]
    if len(q) < king.votes or since <= 0:
        return None
    home = slam.branches[0]
    whole = slam.estimator.estimate(home.belief)
    old = _old(home, whole, since, slam, scout)
    if old.sum() < king.votes:
        return None
    away = _away(home, whole, old, mine, rules)
    noise = float(np.median(scout.noise[-rules.window:]))
    hits = np.array([mine.ledger[i].hits for i in ids.tolist()])
    found = fits(q, ((SLACK * noise) ** 2 / hits)[:, None, None] * np.eye(2), away.old.landmarks)
    pose = whole.pose
    found = [f for f in found if _drifted(f, away, home, pose, scout, whole.pose_cov)]
    king = replace(king, rival=1.0)
    verdicts = [judged(king, f, q, away, slam.sensor) for f in found]
    order = sorted(range(len(found)), key=lambda k: -verdicts[k].score)
    chosen = None
    if order and verdicts[order[0]].score >= 20.0 and found[order[0]].votes >= king.votes:
        if len(order) < 2 or verdicts[order[1]].score < verdicts[order[0]].score - king.lead:
            chosen = order[0]
    if DEBUG:
        best = max(verdicts, key=lambda v: v.score, default=None)
        if best is not None:
            k = verdicts.index(best); f = found[k]
            print(slam.index, "noise %.3f"%noise, "stones", len(q), "old", int(old.sum()), "votes", f.votes, "score %.1f" % best.score, best.holds, sorted([round(v.score) for v in verdicts])[-3:], "agree %.2f" % _agreement(ids, f, away, slam, loop, rules))
    if chosen is None:
        return None
    fit = found[chosen]
    named = np.where(fit.match >= 0, away.old.ids[fit.match], -1)
    if _agreement(ids, fit, away, slam, loop, rules) >= 0.5:
        return None
    return Missed(Return(fit, ids, named), since)

DEBUG = False

def _agreement(ids: Ids, fit: Fit, away: Exile, slam: Slam, loop: Slam, rules: Scouting) -> float:
    """Share of the sightings of fitted landmarks that the family has named as the fit says."""
    says = {int(i): int(away.old.ids[m]) for i, m in zip(ids, fit.match, strict=True) if m >= 0}
    ours = [slam.branches[0].ids, *lately(slam.branches[0], rules.window - 1)]
    his = lately(loop.branches[0], rules.window)
    same = total = 0
    for a, b in zip(ours, his):
        for x, y in zip(a.tolist(), b.tolist(), strict=True):
            if y in says:
                total += 1
                same += x == says[y]
    return same / max(total, 1)


def lately(branch: Branch, steps: int) -> list[Ids]:
    """Names of the last steps, newest first."""
    out, node = [], branch.history
    while node is not None and len(out) < steps:
        node, ids, _ = node
        out.append(ids)
    return out


def _old(home: Branch, whole: Estimate, since: int, slam: Slam, scout: Scout):
    born = np.array([home.ledger[i].born for i in whole.ids.tolist()])
    old = whole.stone & (born <= since)
    seen = np.array([home.ledger[i].seen for i in whole.ids.tolist()])
    path = scout.path[-1] - np.array(scout.path)[np.minimum(seen, len(scout.path) - 1)]
    reach = slam.sensor.max_range + (scout.path[-1] - scout.path[max(since, 0)]) + np.maximum(scout.rules.drift[0] * path, 5.0 * np.sqrt(np.diag(whole.pose_cov)[:2].sum()))
    old &= np.hypot(*(whole.landmarks - whole.pose[:2]).T) < reach
    return old


def _away(home: Branch, whole: Estimate, old, mine: Branch, rules: Scouting) -> Exile:
    part = Estimate(whole.pose, whole.pose_cov, whole.ids[old], whole.landmarks[old], whole.covs[old], whole.stone[old])
    exist = np.array([home.ledger[i].exist for i in part.ids.tolist()])
    poses, node = [], mine.history
    while node is not None and len(poses) < rules.window:
        node, _, pose = node
        poses.append(pose)
    return Exile(home, part, exist, believed=False, trail=poses[:: max(1, len(poses) // rules.poses)][::-1])


def _drifted(fit: Fit, away: Exile, home: Branch, pose: Array, scout: Scout, cov) -> bool:
    matched = away.old.ids[fit.match[fit.match >= 0]]
    if not len(matched):
        return False
    rules = scout.rules
    last = int(np.median([home.ledger[i].seen for i in matched.tolist()]))
    newest = max(life.seen for life in home.ledger.values())
    poses, node = [], home.history
    while node is not None and len(poses) < newest - last:
        node, _, p = node
        poses.append(p)
    path = float(np.hypot(*np.diff(np.array(poses)[:, :2], axis=0).T).sum()) if len(poses) > 1 else 0.0
    gap = compose(fit.motion, away.trail[-1]) - pose
    std = 5.0 * np.sqrt(np.diag(cov))
    path = max(path, 0.0)
    near = np.hypot(*gap[:2]) < max(rules.drift[0] * path, float(np.hypot(*std[:2])))
    return bool(near and abs(wrap_angle(gap[2])) < max(rules.drift[1] * path, std[2]))


def close(slam: Slam, scout: Scout, missed: Missed) -> None:
    home, mine = slam.branches[0], scout.loop.branches[0]
    named = {i: j for i, j in zip(missed.way.ids.tolist(), missed.way.named.tolist(), strict=True) if j >= 0}
    n = len(scout.diary.entries)
    window = scout.rules.window
    ours = [home.ids, *lately(home, n - 1)][::-1]
    his = lately(mine, min(window, n))
    names = _survivors(ours, home)
    for k, ids in enumerate(his):
        names[n - 1 - k] = np.array([named.get(i, i) for i in ids.tolist()], np.int64)
    keep = {i for i, life in home.ledger.items() if life.born <= missed.since and i not in home.crumbs}
    fresh = {i: mine.ledger[i] for i in mine.ledger if i not in mine.crumbs and i not in named}
    fresh = {i: life for i, life in fresh.items() if i not in keep}
    belief, poses = retrace(slam, scout.diary, names, keep | set(fresh))
    have = set(slam.estimator.estimate(belief).ids.tolist())
    for i in [i for i in home.ledger if i not in keep]:
        home.events = (home.events, "died", i, -1, slam.index)
    ledger = {i: home.ledger[i] for i in keep if i in have} | {i: replace(l, born=l.born) for i, l in fresh.items() if i in have}
    for i, j in named.items():
        if j in ledger:
            life, lost = ledger[j], mine.ledger[i]
            life.hits += lost.hits; life.chances += lost.hits; life.static += lost.static; life.seen = max(life.seen, lost.seen)
    home.belief, home.ledger, home.crumbs = belief, ledger, set()
    node = None
    for ids, pose in zip(names[:-1], poses[:-1], strict=True):
        node = (node, ids, pose)
    home.history = node
    home.ids = names[-1]
    home.paired = np.where(np.isin(names[-1], list(ledger)), names[-1], -1)


def _survivors(names: Sequence[Ids], home: Branch) -> list[Ids]:
    into, node = {}, home.events
    while node is not None:
        node, kind, one, other, _ = node
        if kind == "merged":
            into[one] = other
    def last(i):
        while i in into:
            i = into[i]
        return i
    return [np.array([last(i) for i in ids.tolist()], np.int64) for ids in names]
