"""The scout: a brother who remembers the last scans only, and so finds out where the family has been before.

Scan by scan a long loop does not close: the filter is sure of a pose that is metres off, and displaced observations find
wrong partners. The scout maps the last scans afresh, without the old map. What he has seen lately is right among itself
and is laid on the old map as a constellation, within the drift that odometry may have gathered.

    missed loop          one place explains the scout's map, and the family has named what is there otherwise
    the same place twice two places near each other explain it, and what stands on them was never seen together

Either way the trail is gone over again (`retrace`) with the scout's names, and they are believed if it does not tear.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from tomthumb.branches import CERTAIN, Branch, Scan
from tomthumb.constellation import Fit, Within, fits
from tomthumb.errors import Diverged, TomThumbError
from tomthumb.geometry import compose, inverse, wrap_angle
from tomthumb.king import Exile
from tomthumb.places import explained, stones, thinned
from tomthumb.retrace import Diary, Entry, begun
from tomthumb.revision import Moment, twin_of
from tomthumb.types import Array, Estimate, Ids

if TYPE_CHECKING:
    from tomthumb.slam import Slam

SLACK = 1.5  # how much less exact the scout's map is in itself than its sightings say
PARTS = 3  # places at most on which parts of the scout's map lie
RIVAL = 2.0  # as far beyond the allowed drift a place is a rival still, though none to go to
STRANGERS = 0.2  # share of twins that may have been seen together, by wrong names


@dataclass(frozen=True, slots=True)
class Scouting:
    """window: scans that the scout remembers; he looks at what he saw in them, in the newer half, quarter, ...: `sizes` in
    all. every: scans between two looks, no more than he looks back at least. drift: m per m of path, rad per m: what
    odometry may have gathered. sure: nats that a place must explain: a thousand places within the drift, a thousand looks,
    a risk of one in a hundred. lead: nats before any other place. votes: landmarks at least; `sure` decides what they are
    worth, but none is worth more than five nats, and one more than twenty nats need is over what fixes a place. poses: of
    the trail, from which old landmarks would have been seen. tear: what was found is not believed if the filter, gone over
    the trail with it, is surprised in any ten scans by so many standard deviations of NIS.
    """

    window: int = 200
    sizes: int = 4
    every: int = 20
    drift: tuple[float, float] = (0.05, 0.005)
    sure: float = 20.0
    lead: float = 10.0
    votes: int = 5
    poses: int = 12
    tear: float = 40.0

    def __post_init__(self) -> None:
        if not (self.window >= 2 ** (self.sizes - 1) >= 1 and min(self.every, self.votes, self.poses) >= 1):
            raise TomThumbError(f"{self}: window at least 2^(sizes - 1), sizes, every, votes and poses at least 1")
        if not (min(self.drift) > 0.0 and self.tear > 0.0):
            raise TomThumbError(f"scout's drift={self.drift}, tear={self.tear}: above 0")

    @property
    def windows(self) -> tuple[int, ...]:
        """All that the scout remembers, and the newer part of it: a drift that has just begun shows there first."""
        return tuple(self.window // 2**k for k in range(self.sizes))


@dataclass(slots=True)
class Scout:
    """The scout's own loop, the diary since he was sent out at scan `sent`, and by scans: the path (m) and the noise (m) of
    a sighting. step: m of path since the last scan. refused: looks in a row whose finds tore the trail; he rests until
    scan `rest`.
    """

    rules: Scouting
    loop: Slam
    diary: Diary
    sent: int
    path: list[float] = field(default_factory=list)
    noise: list[float] = field(default_factory=list)
    step: float = 0.0
    refused: int = 0
    rest: int = 0

    @property
    def branch(self) -> Branch:
        """The scout's map and what he calls its landmarks."""
        return self.loop.branches[0]

    def since(self, window: int) -> int:
        """The scan before the last `window` scans of his: what the family founded until then is old beside them."""
        return max(self.loop.scan - 1 - window, self.sent - 1)

    def walked(self, scan: int) -> float:
        """m of path since that scan."""
        return self.path[-1] - self.path[max(0, min(scan - self.loop.scan + len(self.path), len(self.path) - 1))]


@dataclass(frozen=True, slots=True)
class Found:
    """What the scout says: `named` is which of his landmarks is which old one, `same` which old one is another old one; old
    is what was founded until the scan `since`.
    """

    votes: int
    named: dict[int, int]
    same: dict[int, int]
    since: int


@dataclass(frozen=True, slots=True)
class Place:
    """Where the scout's map may lie in the old one: `pose` is the robot's there, `says` which of his landmarks is which old
    one, with how many nats, and at what share of the drift that odometry may have gathered.
    """

    pose: Array
    says: dict[int, int]
    score: float
    drift: float


def sent_out(slam: Slam, rules: Scouting) -> Scout:
    """A scout without a map who begins where the family believes to be; the diary begins here too."""
    loop = twin_of(slam)
    pose, _ = slam.estimator.pose(slam.branches[0].belief)
    loop.branches = [Branch(slam.estimator.init(pose, CERTAIN, loop.rng_estimator), {})]
    loop.teacher, loop.teach_steps, loop.width = None, 0, 1
    return Scout(rules, loop, begun(slam), slam.scan)


def go_along(scout: Scout, moment: Moment) -> bool:
    """The scout's own step; False when his filter is lost."""
    before = scout.loop.estimator.pose(scout.branch.belief)[0]
    scout.diary.entries.append(Entry(moment.t, moment.control))
    try:
        record = scout.loop.step(moment.t, moment.control, moment.observations)
    except Diverged:
        return False
    scout.step += float(np.hypot(*(record.pose - before)[:2]))
    return True


def take_notes(scout: Scout, scan: Scan) -> None:
    """After a scan: how the filter took it, how far the way was, and what is too long ago to be remembered."""
    scout.diary.entries[-1].scan = scan
    scout.path.append((scout.path[-1] if scout.path else 0.0) + scout.step)
    scout.step = 0.0
    if len(scan):
        G = scout.loop.sensor.locate(scout.loop.estimator.pose(scout.branch.belief)[0], scan.honest.z)[2]
        var = 0.5 * np.trace(G @ scan.honest.R @ G.transpose(0, 2, 1), axis1=1, axis2=2)
        scout.noise.append(float(np.sqrt(var.mean())))
        del scout.noise[: -scout.rules.window]
    _forget(scout)


def _forget(scout: Scout) -> None:
    branch = scout.branch
    gone = [i for i, life in branch.ledger.items() if scout.loop.scan - life.seen > scout.rules.window]
    if gone:
        branch.belief = scout.loop.estimator.forget(branch.belief, np.array(gone, np.int64))
        branch.crumbs.difference_update(gone)
        for i in gone:
            del branch.ledger[i]


def refuse(scout: Scout) -> None:
    """What he found tore the trail: he rests for a look, for two after the next time, ...: each costs as much as the run."""
    scout.refused += 1
    scout.rest = scout.loop.scan + scout.rules.every * scout.refused


# --- looking ------------------------------------------------------------------------------------------------------------


def look(scout: Scout, slam: Slam) -> Iterator[Found]:
    """What the scout has to say about the family's names, if he is sure: by all that is not old, or the newest of it."""
    here, whole = (loop.estimator.estimate(loop.branches[0].belief) for loop in (scout.loop, slam))
    seen = np.array([scout.branch.ledger[i].seen for i in here.ids.tolist()], np.int64)
    beside = _beside(scout, slam, whole)
    if beside is None:
        return
    windows, since, away = beside
    for window in windows:
        last = scout.since(window)
        away.trail = thinned([pose for _, pose in lately(scout, last)][::-1], scout.rules.poses)
        found = _wrong(scout, slam, here.only(here.stone & (seen > last)), away, since)
        if found is not None:
            yield found


def _beside(scout: Scout, slam: Slam, whole: Estimate) -> tuple[tuple[int, ...], int, Exile] | None:
    """The old map, the scan until which it is old, and the scout's windows from the longest that leaves enough of it."""
    windows = scout.rules.windows
    for k, window in enumerate(windows):
        since = scout.since(window)
        away = _old_map(scout, slam, whole, since)
        if len(away.old.ids) >= scout.rules.votes:
            return windows[k:], since, away
    return None


def _wrong(scout: Scout, slam: Slam, mine: Estimate, away: Exile, since: int) -> Found | None:
    """The places of what the scout has mapped, if the family is wrong about one of them."""
    found, wrong = Found(0, {}, {}, since), False
    for _ in range(PARTS):
        place = _place(scout, slam, mine, away, since)
        if place is None:
            break
        wrong |= bool(place.same) or _agreement(scout, slam, place.named, since) < 0.5
        mine = mine.only(~np.isin(mine.ids, list(place.named)))
        found = Found(found.votes + place.votes, found.named | place.named, found.same | place.same, since)
    return found if wrong else None


def _place(scout: Scout, slam: Slam, mine: Estimate, away: Exile, since: int) -> Found | None:
    """The place in the old map of what the scout has mapped, if there is one and no rival."""
    places = _places(scout, slam, mine, away)

    def rivalled(place: Place) -> bool:
        near = [p for p in places if p is not place and p.score > place.score - scout.rules.lead]
        return any(_contradict(place.says, p.says) and not _twins(slam, place, p) for p in near)

    good = [p for p in places if p.score >= scout.rules.sure and p.drift < 1.0 and len(p.says) >= scout.rules.votes]
    if not good or rivalled(good[0]):
        return None
    same: dict[int, int] = {}
    for place in good[1:]:
        same |= {} if rivalled(place) else _twins(slam, good[0], place)
    return Found(len(good[0].says), good[0].says, same, since)


def _places(scout: Scout, slam: Slam, mine: Estimate, away: Exile) -> list[Place]:
    """All places where what the scout has mapped may lie in the old map, best first."""
    q, ids, votes = mine.landmarks, mine.ids, scout.rules.votes
    if min(len(q), len(away.old.ids)) < votes or not scout.noise:
        return []
    hits = np.array([scout.branch.ledger[i].hits for i in ids.tolist()])
    spread = (SLACK * float(np.median(scout.noise))) ** 2 / hits
    found = []
    here, within = _believed(scout, away)
    old = stones(away.old.landmarks, away.exist)
    for fit in fits(q, spread[:, None, None] * np.eye(2), away.old.landmarks, here, within):
        drift = _drift(scout, fit, away) if fit.votes >= votes else np.inf
        if drift < RIVAL:
            named = away.old.ids[fit.match]
            says = {i: j for i, j, m in zip(ids.tolist(), named.tolist(), fit.match.tolist(), strict=True) if m >= 0}
            score = explained(fit, q, away.trail, slam.sensor, old)
            found.append(Place(compose(fit.motion, away.trail[-1]), says, score, drift))
    return sorted(found, key=lambda place: -place.score)


def _contradict(says: dict[int, int], also: dict[int, int]) -> bool:
    """Two places for the same landmarks, of the one map or of the other; else they are parts of a map that is torn."""
    return _differ(says, also) or _differ({j: i for i, j in says.items()}, {j: i for i, j in also.items()})


def _differ(says: dict[int, int], also: dict[int, int]) -> bool:
    other = sum(says[i] != also[i] for i in says.keys() & also.keys())
    return 2 * other > min(len(says), len(also))


def _old_map(scout: Scout, slam: Slam, whole: Estimate, since: int) -> Exile:
    """The family's stones founded until scan `since`, as far as drift may have brought them near."""
    home = slam.branches[0]
    lives = [home.ledger[i] for i in whole.ids.tolist()]
    walked = np.array([scout.walked(life.seen) for life in lives])
    drift = np.maximum(scout.rules.drift[0] * walked, 5.0 * np.sqrt(np.trace(whole.pose_cov[:2, :2])))
    reach = slam.sensor.max_range + scout.walked(since) + RIVAL * drift
    old = whole.stone & (np.array([life.born for life in lives]) <= since)
    old &= np.hypot(*(whole.landmarks - whole.pose[:2]).T) < reach
    part = whole.only(old)
    exist = np.array([home.ledger[i].exist for i in part.ids.tolist()])
    return Exile(home, part, exist)


def _believed(scout: Scout, away: Exile) -> tuple[Array, Within]:
    """The motion (3,) that lays the scout's pose on the family's, and how far about it rivals are looked for."""
    walked = max(scout.walked(away.home.ledger[i].seen) for i in away.old.ids.tolist())
    metres, radians = _allowed(scout, walked, away)
    return compose(away.old.pose, inverse(away.trail[-1])), Within(away.trail[-1][:2], RIVAL * metres, RIVAL * radians)


def _drift(scout: Scout, fit: Fit, away: Exile) -> float:
    """How far the fit moves the robot, as a share of what odometry may have drifted since the old landmarks were seen."""
    matched = away.old.ids[fit.match[fit.match >= 0]]
    walked = scout.walked(int(np.median([away.home.ledger[i].seen for i in matched.tolist()])))
    gap = compose(fit.motion, away.trail[-1]) - away.old.pose
    metres, radians = _allowed(scout, walked, away)
    return float(max(np.hypot(*gap[:2]) / metres, abs(wrap_angle(gap[2])) / radians))


def _allowed(scout: Scout, walked: float, away: Exile) -> tuple[float, float]:
    """m and rad that odometry may have drifted over so many m, or five standard deviations of what the filter claims."""
    x, y, turn = 5.0 * np.sqrt(np.maximum(np.diag(away.old.pose_cov), 1e-12))
    metres, radians = scout.rules.drift
    return max(metres * walked, float(np.hypot(x, y))), max(radians * walked, float(turn))


def _twins(slam: Slam, best: Place, other: Place) -> dict[int, int]:
    """Old landmarks that are one, younger to older, if two places are one that was mapped twice; none if they are rivals.

    Nearer to each other than the sensor sees, both would have been in view at once: a periodic world shows them together.
    """
    ledger = slam.branches[0].ledger
    if np.hypot(*(best.pose - other.pose)[:2]) > slam.sensor.max_range:
        return {}
    shared = best.says.keys() & other.says.keys()
    pairs = [(best.says[i], other.says[i]) for i in shared if best.says[i] != other.says[i]]
    apart = [pair for pair in pairs if pair[1] not in ledger[pair[0]].companions]
    if not apart or len(pairs) - len(apart) > STRANGERS * len(pairs):
        return {}
    return {
        max(pair, key=lambda i: (ledger[i].born, i)): min(pair, key=lambda i: (ledger[i].born, i)) for pair in apart
    }


def _agreement(scout: Scout, slam: Slam, says: dict[int, int], since: int) -> float:
    """Share of the last sightings of the scout's landmarks `says` that the family has named as he does."""
    his = [ids for ids, _ in lately(scout, since)]
    named = [
        (x, says[y])
        for ours, ids in zip(names_of(slam.branches[0], len(his)), his, strict=True)
        for x, y in zip(ours.tolist(), ids.tolist(), strict=True)
        if y in says
    ]
    return float(sum(x == y for x, y in named) / max(len(named), 1))


def lately(scout: Scout, since: int) -> list[tuple[Ids, Array]]:
    """The scout's names and poses in the steps after scan `since`, newest first."""
    out: list[tuple[Ids, Array]] = []
    node = scout.branch.history
    while node is not None and node[3] > since:
        node, ids, pose, _ = node
        out.append((ids, pose))
    return out


def names_of(branch: Branch, steps: int) -> list[Ids]:
    """The family's names in this step and in those before it, newest first."""
    out, node = [branch.ids], branch.history
    while node is not None and len(out) < steps:
        node, ids, *_ = node
        out.append(ids)
    return out
