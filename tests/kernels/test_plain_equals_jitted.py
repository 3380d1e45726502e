"""The kernels of association do the same as plain Python: the whole of a few runs with numba switched off."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np

PROGRAM = """
import json, sys
import numpy as np
sys.path.insert(0, {tests!r})
from associators.brute import random_problem
from tomthumb import registry
rng = np.random.default_rng(3)
out = []
for k in range(12):
    problem = random_problem(rng, 2 + k % 4, 3 + k % 3, spread=0.8 + 0.3 * (k % 4), angles=(1,) if k % 2 else ())
    for name in ("jcbb", "stt"):
        for found in registry.build("associator", name).associate(problem, np.random.default_rng(1)):
            numbers = [v for v in found.info.values() if isinstance(v, float)]
            more = [] if found.confidence is None else found.confidence.tolist()
            out.append([found.match.tolist(), numbers, more, found.info.get("nodes"), found.info.get("poses")])
print(json.dumps(out))
"""


def outcome(tests, disabled):
    environment = {**os.environ, "NUMBA_DISABLE_JIT": disabled}
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(tests=tests)], env=environment, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def test_jcbb_and_stt_are_the_same_with_and_without_numba(request):
    tests = str(request.config.rootpath / "tests")
    jitted, plain = outcome(tests, "0"), outcome(tests, "1")
    assert len(jitted) == len(plain) >= 24
    for one, two in zip(jitted, plain, strict=True):
        assert one[0] == two[0]
        assert one[3:] == two[3:]  # nodes and poses tried: the same search, not only the same end
        assert np.allclose(one[1], two[1], rtol=1e-9, atol=1e-9)
        assert np.allclose(one[2], two[2], rtol=1e-6, atol=1e-9)


def test_gates_are_the_same_with_and_without_numba():
    from tomthumb.kernels import gates

    rng = np.random.default_rng(4)
    z, z_hat, wrapped = rng.uniform(-4, 4, (5, 2)), rng.uniform(-4, 4, (6, 2)), np.array([False, True])
    nu = gates.innovations(z, z_hat, wrapped)
    assert np.array_equal(nu, gates.innovations.py_func(z, z_hat, wrapped))
    A = rng.standard_normal((11, 2, 2))
    covs = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(2)
    d2 = gates.mahalanobis(nu, covs[:6], covs[6:])
    assert np.allclose(d2, gates.mahalanobis.py_func(nu, covs[:6], covs[6:]), rtol=1e-12)
    pose, mount = np.array([1.0, 2.0, 0.7]), np.array([0.3, -0.1, 0.2])
    for kernel in (
        gates.expect_cartesian,
        gates.expect_range_bearing,
        gates.locate_cartesian,
        gates.locate_range_bearing,
    ):
        for jitted, plain in zip(kernel(pose, mount, z_hat), kernel.py_func(pose, mount, z_hat), strict=True):
            assert np.allclose(jitted, plain, rtol=1e-12, atol=1e-12)
