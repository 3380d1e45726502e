"""The problem classes of the single-scan benchmark are what their page says they are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.special import chdtri

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

from scan_problems import CLASSES, CLOUD_CLASSES, SECTOR_CLASSES, crowd, scans  # noqa: E402


@pytest.mark.parametrize("kind", CLASSES)
def test_shapes_and_truth(kind):
    for scan in scans(kind, 8, 3, 1):
        m, n = scan.problem().shape
        assert scan.truth.shape == (m,)
        paired = scan.truth[scan.truth >= 0]
        assert len(np.unique(paired)) == len(paired)
        assert ((scan.truth >= -1) & (scan.truth < n)).all()


@pytest.mark.parametrize("kind", CLASSES)
def test_the_same_seed_gives_the_same_problems(kind):
    one, two = scans(kind, 6, 2, 3), scans(kind, 6, 2, 3)
    assert all(np.array_equal(a.z, b.z) and np.array_equal(a.truth, b.truth) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[0].z, one[1].z)


@pytest.mark.parametrize("kind", ["mid", "dense+sp"])
def test_the_crowding_is_the_one_that_was_asked_for(kind):
    mean = np.mean([crowd(scan) for scan in scans(kind, 20, 40, 5)])
    assert mean == pytest.approx(SECTOR_CLASSES[kind][0], rel=0.15)


@pytest.mark.parametrize("kind", ["mid+sp", "dense+sp"])
def test_a_fifth_is_false(kind):
    assert all((scan.truth < 0).sum() == 2 for scan in scans(kind, 10, 5, 1))


@pytest.mark.parametrize("kind", ["sep", "mid", *CLOUD_CLASSES])
def test_the_truth_is_consistent_with_the_covariance(kind):
    """D2 of the true pairs is chi-square: its mean over 40 scans within 4 standard errors (linear classes);
    the clouds turn too far to linearise, so there it may be larger, never smaller."""
    values, dof = [], []
    for scan in scans(kind, 6, 40, 2):
        problem = scan.problem()
        who = np.flatnonzero(scan.truth >= 0)
        at = (2 * scan.truth[who][:, None] + np.arange(2)).ravel()
        S = problem.predictions.cov[np.ix_(at, at)] + np.kron(np.eye(len(who)), scan.R)
        v = problem.innovation[who, scan.truth[who]].ravel()
        values.append(float(v @ np.linalg.solve(S, v)))
        dof.append(2 * len(who))
    excess, error = np.sum(values) - np.sum(dof), np.sqrt(2.0 * np.sum(dof))
    assert excess > -4 * error
    if kind in SECTOR_CLASSES:
        assert excess < 4 * error + 0.1 * np.sum(dof)  # range and bearing bend a little


def test_most_true_pairs_are_within_a_wide_gate():
    for scan in scans("mid", 20, 10, 4):
        d2 = scan.problem().d2[np.arange(20), scan.truth]
        assert (d2 < chdtri(2, 1e-6)).all()


@pytest.mark.slow
def test_the_runner_writes_its_tables_between_the_markers(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "before\n<!-- single_scan: written by benchmarks/single_scan.py -->\nold\n<!-- end of single_scan -->\nafter\n"
    )
    settings = "--count 3 --small 3 --classes sep,mid --sizes 4 --methods nn,jcbb,map,stt"
    ran = subprocess.run(
        [sys.executable, "single_scan.py", *settings.split(), "--write", str(page)],
        cwd=BENCHMARKS,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert f"{settings}`" in text
    for heading in ("Right decisions", "JCBB at its best gate", "Time of one scan", "The optimum", "confidence"):
        assert heading in text
