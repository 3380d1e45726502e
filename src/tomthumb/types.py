"""The plain data that passes between the parts: frozen dataclasses of float64 arrays, SI units and radians.

Nobody writes into an array that came in one of these. Frames: `pose` is the robot in the world; observations are in the
frame of the sensor. A landmark's id is the serial number of the observation that gave it birth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from tomthumb.protocols import Motion, Sensor

Array = npt.NDArray[np.float64]
Ids = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

NONE = -1  # "no landmark", "no label", "clutter"


@dataclass(frozen=True, slots=True)
class Control:
    """What moved the robot: `u (k,)` in the motion model's units over the `dt` s that end at the step's time.

    `cov` is the covariance of `u (k, k)`, where the log gives one; otherwise the motion model's own applies.
    """

    u: Array
    dt: float
    cov: Array | None = None


@dataclass(frozen=True, slots=True)
class Observations:
    """One scan: `z (m, 2)` with covariances `R (m, 2, 2)`, in the sensor's units (m, rad).

    `labels (m,)` is a class of each (-1 unknown), `signature (m,)` a measured property (a diameter in m, say; NaN
    unknown).
    """

    z: Array
    R: Array
    labels: Ids | None = None
    signature: Array | None = None

    def __len__(self) -> int:
        return len(self.z)

    def take(self, rows: npt.NDArray[Any]) -> Observations:
        """The scan cut down to `rows`."""
        labels = None if self.labels is None else self.labels[rows]
        signature = None if self.signature is None else self.signature[rows]
        return Observations(self.z[rows], self.R[rows], labels, signature)


@dataclass(frozen=True, slots=True)
class Truth:
    """What really was: `pose (3,)` or None where unknown; `ids (m,)` of the landmarks observed.

    ids: >= 0 a landmark, -1 clutter, -2 not known (such rows are not scored). None where there are no labels at all.
    """

    pose: Array | None
    ids: Ids | None


@dataclass(frozen=True, slots=True)
class Step:
    """One moment of a scenario: the control that led to `t` s, then the scan taken at `t`. Either may be missing."""

    t: float
    control: Control | None
    observations: Observations | None
    truth: Truth | None = None


@dataclass(frozen=True, slots=True)
class Prior:
    """Where the robot starts: `pose (3,)` and its covariance `cov (3, 3)`."""

    pose: Array
    cov: Array


@dataclass(frozen=True)
class Scenario:
    """A world or a log, ready to run: models, prior and steps. A loader is one function ``path -> Scenario``.

    `steps` is any sequence or re-iterable (lazy for long logs). `landmarks (k, 2)` is the true map, m, row = true id;
    NaN rows are unknown. Steps before `score_from` are not scored; during the first `teach_steps` the oracle names.
    """

    name: str
    motion: Motion
    sensor: Sensor
    prior: Prior
    steps: Sequence[Step]
    landmarks: Array | None = None
    score_from: int = 1
    teach_steps: int = 0
    info: Mapping[str, Any] = field(default_factory=dict)

    def true_ids(self) -> Ids:
        """The true landmark of every observation of the run, by serial number (-2 where not known)."""
        parts = [_true_ids(step) for step in self.steps if step.observations is not None]
        return np.concatenate(parts) if parts else np.empty(0, np.int64)


def _true_ids(step: Step) -> Ids:
    assert step.observations is not None
    if step.truth is None or step.truth.ids is None:
        return np.full(len(step.observations), -2, np.int64)
    return step.truth.ids


@dataclass(frozen=True, slots=True)
class Predictions:
    """What one belief expects to see, in the sensor's units.

    ids (n,); z_hat (n, 2); cov (2n, 2n) = H P H' with all cross terms and without R; pose_cov (3, 3);
    cross (2n, 3) covariance of the predictions with the pose; points (n, 2) m in the sensor's frame at the prior pose
    (exact under a rigid motion, where linearisation is poor); exist (n,) probability of existence; visible (n,)
    probability of detection if it exists; stone (n,) True for confirmed landmarks; labels (n,) or None; age as wanted.
    """

    ids: Ids
    z_hat: Array
    cov: Array
    pose_cov: Array | None = None
    cross: Array | None = None
    points: Array | None = None
    exist: Array | None = None
    visible: Array | None = None
    stone: Mask | None = None
    labels: Ids | None = None
    signature: Array | None = None
    signature_var: Array | None = None

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class AssociationProblem:
    """One scan against one set of predictions: all that an associator is told.

    innovation (m, n, 2), angles wrapped; R (m, 2, 2); z (m, 2); clutter (m,) density of false and new observations at
    each observation, per unit of z; serials (m,) running numbers of the observations; angles: components that wrap.

    What observations look like: `labels` that contradict each other exclude a pairing for everybody. `barred (m, n)` are
    the pairings outside the gates of signatures. `evidence (m, n)` weighs looks instead: the log ratio of how likely those
    of i are for landmark j, over how likely they are for anything; whoever adds it to gains takes `weighed_d2`, which keeps
    the gates where the evidence is of classes alone (`gated`).
    """

    z: Array
    R: Array
    innovation: Array
    predictions: Predictions
    clutter: Array
    serials: Ids
    angles: tuple[int, ...] = ()
    labels: Ids | None = None
    signature: Array | None = None
    t: float = 0.0
    evidence: Array | None = None
    barred: Mask | None = None
    gated: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Number of observations, number of predictions."""
        return len(self.z), len(self.predictions)

    @cached_property
    def blocks(self) -> Array:
        """The diagonal 2 x 2 blocks of H P H', (n, 2, 2)."""
        n = len(self.predictions)
        k = np.arange(n)
        return np.ascontiguousarray(self.predictions.cov.reshape(n, 2, n, 2)[k, :, k, :])

    @cached_property
    def S(self) -> Array:
        """Innovation covariances (m, n, 2, 2)."""
        total: Array = self.blocks[None] + self.R[:, None]
        return total

    @cached_property
    def d2(self) -> Array:
        """Squared Mahalanobis distances (m, n); infinite where labels or signatures exclude the pairing."""
        if self.barred is None:
            return self._distances
        d2: Array = np.where(self.barred, np.inf, self._distances)
        return d2

    @cached_property
    def weighed_d2(self) -> Array:
        """As `d2`, but nothing that `evidence` weighs is excluded: for those who add it to their gains."""
        return self.d2 if self.evidence is None or self.gated else self._distances

    @cached_property
    def _distances(self) -> Array:
        from tomthumb.kernels.gates import mahalanobis

        d2: Array = mahalanobis(self.innovation, self.blocks, self.R)
        if self.allowed is not None:
            d2[~self.allowed] = np.inf
        return d2

    @cached_property
    def allowed(self) -> Mask | None:
        """Pairings (m, n) whose labels do not contradict each other, or None when there are no labels."""
        if self.labels is None or self.predictions.labels is None:
            return None
        mine, theirs = self.labels[:, None], self.predictions.labels[None]
        same: Mask = (mine == theirs) | (mine < 0) | (theirs < 0)
        return same


@dataclass(frozen=True, slots=True)
class Association:
    """One hypothesis: `match (m,)` column of the predictions or -1; `log_weight`, nats beyond nothing being paired, by which
    the branches of a history are weighed.

    `info` says what was spent and proven: nodes, flights, "optimal" or "truncated"; `confidence (m,)` is the
    probability that each decision is right, where the associator knows it.
    """

    match: Ids
    log_weight: float = 0.0
    info: Mapping[str, Any] = field(default_factory=dict)
    confidence: Array | None = None


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a belief says: pose (3,) and covariance; landmarks (n, 2) with ids, covariances (n, 2, 2) and stones."""

    pose: Array
    pose_cov: Array
    ids: Ids
    landmarks: Array
    covs: Array
    stone: Mask

    def only(self, rows: Mask | Ids) -> Estimate:
        """With these landmarks only, by mask (n,) or rows (k,)."""
        return replace(
            self, ids=self.ids[rows], landmarks=self.landmarks[rows], covs=self.covs[rows], stone=self.stone[rows]
        )


@dataclass(frozen=True, slots=True)
class Lessons:
    """What an associator has learned about landmarks `ids (k,)`: how often each was seen, `sightings (k,)` of `total`;
    `together (k, k)`, the share of sightings of i before which j was seen lately; `lately (k,)`, that share of them all.
    """

    ids: Ids
    sightings: Ids
    together: Array
    lately: Array
    total: int

    def renamed(self, names: Mapping[int, int]) -> Lessons:
        """About the landmarks that `names` knows, by the ids it gives them."""
        rows = np.array([k for k, i in enumerate(self.ids.tolist()) if i in names], np.int64)
        ids = np.array([names[int(i)] for i in self.ids[rows]], np.int64)
        return Lessons(ids, self.sightings[rows], self.together[np.ix_(rows, rows)], self.lately[rows], self.total)


@dataclass(frozen=True, slots=True)
class StepRecord:
    """What one step gave out. `ids (m,)`: the landmark of each observation, its own serial if it founded one, else -1.

    `paired (m,)` is True where the landmark was known before. `nis` and its `dof` cover the pairings with stones. `info`
    is the association's, with "confidence" (m,) where the associator knows it.
    """

    index: int
    t: float
    pose: Array
    pose_cov: Array
    serials: Ids
    ids: Ids
    paired: Mask
    with_stone: Mask
    seconds: tuple[float, float, float, float]  # predict, associate, update, life cycle
    nis: float
    dof: int
    landmarks: int
    info: Mapping[str, Any]


@dataclass(frozen=True)
class Trace:
    """A whole run, stacked: K steps, M observations; `offsets (K + 1,)` cuts the observations into steps.

    died (D, 2) and merged (G, 3) list [id, step] and [dropped, kept, step]; `failure` is None or the named reason.
    """

    scenario: str
    t: Array
    pose: Array
    pose_cov: Array
    offsets: Ids
    ids: Ids
    paired: Mask
    with_stone: Mask
    seconds: Array
    nis: Array
    dof: Ids
    died: Ids
    merged: Ids
    final: Estimate
    failure: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    final_ids: Ids | None = None
    final_pose: Array | None = None
    stats: Mapping[str, float] = field(default_factory=dict)
    lessons: Lessons | None = None
