"""Incremental posterior joint compatibility: JCBB's criterion with the residual at the posterior, not at the prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.associators.candidates import gated
from tomthumb.associators.jcbb import JointCompatibility
from tomthumb.associators.tom_thumb.scene import Rigid, rigid
from tomthumb.kernels import ipjc
from tomthumb.protocols import Rng
from tomthumb.types import Association, AssociationProblem, Ids

WIDE = 1.0 - 1e-6  # linear gate within which a pairing's own posterior is computed


@dataclass(slots=True)
class PosteriorCompatibility:
    """The most pairings whose every prefix keeps min over x of |x - x_hat|^2_P + sum |z - h(x)|^2_R below the gate.

    x is the rigid motion between predictions and scan, the landmarks' own errors are part of the noise. Where the
    covariance is not such a motion plus independent errors, it is the linear test: plain JCBB ("form" in `info`).

    References: E. Olson, Y. Li, IPJC: The incremental posterior joint compatibility test, IROS 2012.
    """

    gate: float = 0.99
    budget: int = 200_000

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        scene = rigid(problem, np.zeros(m), np.zeros(n)) if m and n else None
        if scene is None:
            plain = JointCompatibility(self.gate, self.budget).associate(problem, rng)[0]
            return [Association(plain.match, info={**plain.info, "form": "linear"})]
        return [self._posterior(problem, scene)]

    def _posterior(self, problem: AssociationProblem, s: Rigid) -> Association:
        m = len(problem.z)
        gates2 = chdtri(2.0 * np.arange(m + 1), 1.0 - self.gate)
        gates2[0] = np.inf
        prior, wide2 = np.linalg.inv(s.Xi), max(float(chdtri(2, 1.0 - WIDE)), gates2[1])
        scene = (np.ascontiguousarray(s.q), s.R, np.ascontiguousarray(s.p), s.D, prior)
        listed = gated(ipjc.single_d2(problem.d2, wide2, *scene), gates2[1])
        match, d2, nodes, finished = ipjc.search(
            *scene, listed.order, listed.start, listed.columns, gates2, self.budget
        )  # fmt: skip
        proof = "optimal" if finished else "truncated"
        return Association(match, info={"nodes": nodes, "proof": proof, "joint_d2": d2, "form": "posterior"})

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""
