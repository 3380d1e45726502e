"""Our trunk detector against the detections published with Victoria Park."""

import numpy as np
import pytest

from tomthumb.scenarios import load

pytestmark = pytest.mark.data


def points(z):
    return np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])


def test_our_trunks_are_the_published_ones(data_dir):
    published, ours = (load(f"{data_dir}/victoria_park", detections=d) for d in ("published", "raw"))
    mine = {round(s.t, 2): s.observations for s in ours.steps if s.observations is not None}
    found = labelled = labelled_found = total = 0
    for step in published.steps:
        if step.observations is None or round(step.t, 2) not in mine:
            continue
        theirs = points(step.observations.z)
        own = points(mine[round(step.t, 2)].z)
        near = np.linalg.norm(theirs[:, None] - own[None], axis=2).min(axis=1, initial=np.inf) < 0.2
        named = step.truth.ids >= 0
        total, found = total + len(near), found + near.sum()
        labelled, labelled_found = labelled + named.sum(), labelled_found + (near & named).sum()
    assert total > 52_700
    assert found / total > 0.998
    assert labelled_found / labelled > 0.999
    assert len(ours.true_ids()) < 1.25 * total
