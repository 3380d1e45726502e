"""Association on plain arrays, for people who bring their own filter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.kernels.gates import innovations
from tomthumb.types import Array, Association, AssociationProblem, Ids, Predictions

UNKNOWN_DENSITY = 0.3  # false and new observations per m2, where the caller does not say


def associate(
    z: Array,
    z_hat: Array,
    cov: Array,
    R: Array,
    *,
    method: str = "stt",
    pose_cov: Array | None = None,
    cross: Array | None = None,
    points: Array | None = None,
    detect: Array | float | None = None,
    clutter: Array | float | None = None,
    angles: tuple[int, ...] = (1,),
    labels: tuple[Ids, Ids] | None = None,
    evidence: Array | None = None,
    rng: np.random.Generator | None = None,
    check: bool = False,
    **parameters: Any,
) -> Association:
    """Which prediction each observation is: `match (m,)` holds an index into `z_hat`, or -1.

    z (m, 2) observations; z_hat (n, 2) predicted observations; cov (2n, 2n) = H P H' with all cross terms, without R;
    R (2, 2) shared or (m, 2, 2). pose_cov (3, 3) and cross (2n, 3), the covariance of the predictions with the pose, and
    points (n, 2) m in the robot's frame help methods that use them; detect: probability of detection, scalar or (n,);
    clutter: density of false and new observations in the units of z, scalar or (m,); angles: components that wrap;
    labels: classes of observations (m,) and of predictions (n,), -1 unknown; evidence (m, n): log likelihood ratio of
    what each observation looks like, that landmark against any, for methods that weigh gains. Arguments that a method does
    not use are ignored; further keywords are the method's own (``gate=0.9999``). `check` also tests that the whole `cov`
    is positive semi-definite, which costs the cube of its width.

    Raises `TomThumbError` for shapes that do not fit, values that are not finite, covariances that are not positive
    definite, and unknown methods or keywords.
    """
    from tomthumb import registry

    if method == "oracle":
        raise TomThumbError(
            "method 'oracle' needs the truth, which plain arrays do not hold; valid: any other associator"
        )
    asked = problem(
        z, z_hat, cov, R, pose_cov=pose_cov, cross=cross, points=points, detect=detect, clutter=clutter, angles=angles,
        labels=labels, evidence=evidence, check=check,
    )  # fmt: skip
    built = registry.build("associator", method, parameters)
    best: Association = built.associate(asked, rng if rng is not None else np.random.default_rng(0))[0]
    return best


def problem(
    z: Array,
    z_hat: Array,
    cov: Array,
    R: Array,
    *,
    pose_cov: Array | None = None,
    cross: Array | None = None,
    points: Array | None = None,
    detect: Array | float | None = None,
    clutter: Array | float | None = None,
    angles: tuple[int, ...] = (1,),
    labels: tuple[Ids, Ids] | None = None,
    evidence: Array | None = None,
    check: bool = False,
) -> AssociationProblem:
    """The arrays as associators and `tomthumb.explain` are given them; arguments and errors as for `associate`."""
    seen, noise = _observed(z, R)
    predictions = _predicted(z_hat, cov, pose_cov, cross, points, detect, check)
    m, n = len(seen), len(predictions)
    wrapped = np.zeros(2, bool)
    if any(k not in (0, 1) for k in angles):
        raise TomThumbError(f"angles {tuple(angles)} must name components of z: 0 or 1")
    wrapped[list(angles)] = True
    density = _each("clutter", UNKNOWN_DENSITY if clutter is None else clutter, m)
    if clutter is None and tuple(angles) == (1,):
        density = density * np.maximum(np.abs(seen[:, 0]), 1e-3)  # per m2 -> per m rad
    mine, theirs = _labels(labels, m, n)
    nu = innovations(seen, predictions.z_hat, wrapped)
    return AssociationProblem(
        seen, noise, nu, replace(predictions, labels=theirs), np.maximum(density, 1e-12), np.arange(m), tuple(angles),
        mine, evidence=None if evidence is None else _array("evidence", evidence, (m, n)),
    )  # fmt: skip


def _array(name: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """float64, finite, of the given shape (None: any length)."""
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TomThumbError(f"{name} is not an array of numbers") from None
    if array.size == 0 and 0 in array.shape and len(shape) > 0:
        array = array.reshape(tuple(0 if s is None else s for s in shape)) if None in shape else array
    fits = array.ndim == len(shape) and all(
        want is None or got == want for got, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if s is None else str(s) for s in shape)
        raise TomThumbError(f"{name} has shape {array.shape}; it must be ({wanted})")
    if not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise TomThumbError(f"{name}{list(where)} is not finite")
    return array


def _observed(z: Any, R: Any) -> tuple[Array, Array]:
    seen = _array("z", z, (None, 2))
    if np.ndim(R) == 2:
        noise: Array = np.tile(_array("R", R, (2, 2)), (len(seen), 1, 1))
    else:
        noise = _array("R", R, (len(seen), 2, 2))
    _definite("R", noise)
    return seen, noise


def _predicted(z_hat: Any, cov: Any, pose_cov: Any, cross: Any, points: Any, detect: Any, check: bool) -> Predictions:
    expected = _array("z_hat", z_hat, (None, 2))
    n = len(expected)
    C = _array("cov", cov, (2 * n, 2 * n))
    k = np.arange(n)
    _definite("diagonal block of cov", C.reshape(n, 2, n, 2)[k, :, k, :] if n else np.empty((0, 2, 2)), semi=True)
    if check and n:
        _whole(C)
    pose = None if pose_cov is None else _array("pose_cov", pose_cov, (3, 3))
    if pose is not None and not (np.allclose(pose, pose.T) and np.linalg.eigvalsh(pose)[0] >= -1e-12 * np.trace(pose)):
        raise TomThumbError("pose_cov is not positive semi-definite")
    return Predictions(
        ids=np.arange(n),
        z_hat=expected,
        cov=C,
        pose_cov=pose,
        cross=None if cross is None else _array("cross", cross, (2 * n, 3)),
        points=None if points is None else _array("points", points, (n, 2)),
        visible=None if detect is None else _chance(_each("detect", detect, n)),
    )


def _definite(name: str, blocks: Array, semi: bool = False) -> None:
    a, b, c, d = blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 1, 0], blocks[:, 1, 1]
    even = np.abs(b - c) <= 1e-6 * (np.abs(a) + np.abs(d)) + 1e-300
    det = a * d - b * c
    good = even & ((a >= 0) & (d >= 0) & (det >= -1e-9 * np.abs(a * d)) if semi else (a > 0) & (det > 0))
    if not good.all():
        kind = "positive semi-definite" if semi else "positive definite"
        raise TomThumbError(f"{name} {int(np.argmin(good))} is not {kind} and symmetric")


def _whole(C: Array) -> None:
    low = float(np.linalg.eigvalsh(0.5 * (C + C.T))[0])
    if not np.allclose(C, C.T) or low < -1e-9 * float(np.trace(C)):
        raise TomThumbError(f"cov is not symmetric positive semi-definite (least eigenvalue {low:.3g})")


def _each(name: str, value: Any, size: int) -> Array:
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        array = np.full(size, float(array))
    array = _array(name, array, (size,))
    if (array < 0).any():
        raise TomThumbError(f"{name}[{int(np.argmin(array >= 0))}] is negative")
    return array


def _chance(p: Array) -> Array:
    if (p > 1).any():
        raise TomThumbError(f"detect[{int(np.argmax(p > 1))}] is above 1: it is a probability")
    return p


def _labels(labels: Any, m: int, n: int) -> tuple[Ids | None, Ids | None]:
    if labels is None:
        return None, None
    mine, theirs = (np.asarray(part, dtype=np.int64) for part in labels)
    if mine.shape != (m,) or theirs.shape != (n,):
        raise TomThumbError(f"labels have shapes {mine.shape} and {theirs.shape}; they must be ({m},) and ({n},)")
    return mine, theirs
