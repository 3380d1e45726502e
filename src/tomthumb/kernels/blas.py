"""P -= A B' on the lower triangle, in place, by BLAS: one pass over the memory of P.

scipy's own wrappers copy a matrix that is part of a larger buffer; so dgemm is called by its address, block by block.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

LEAF = 256  # rows of the squares on the diagonal, of which half is computed for nothing

_DOUBLE, _ONE, _MINUS = 8, ctypes.c_double(1.0), ctypes.c_double(-1.0)


@cache
def _dgemm() -> Callable[..., None]:
    """The dgemm that scipy was built with, as a C function."""
    from scipy.linalg import cython_blas

    capsule = cython_blas.__pyx_capi__["dgemm"]
    name_of, address_of = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    address_of.restype, address_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    address = address_of(capsule, name_of(capsule))
    assert address is not None
    return ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_char_p, *[ctypes.c_void_p] * 11)(address)


def subtract_lower(P: Any, dim: int, A: Any, B: Any) -> None:
    """P[i, j] -= (A B')[i, j] for j <= i < dim, in place. P, A (>= dim, k) and B (>= dim, k) are column-major.

    A B' must be symmetric. The square below the diagonal of each half first: few large blocks are quicker than many
    panels. Elements above the diagonal within a leaf's own square are written too: they hold nothing.
    """
    _subtract_square(P, A, B, 0, dim)


def _subtract_square(P: Any, A: Any, B: Any, i: int, size: int) -> None:
    """The lower triangle of the square of `size` rows whose first element is (i, i)."""
    if size <= LEAF:
        _subtract(P, A, B, i, i, size, size)
        return
    half = (size // 2 + 7) // 8 * 8
    _subtract_square(P, A, B, i, half)
    _subtract(P, A, B, i + half, i, size - half, half)
    _subtract_square(P, A, B, i + half, size - half)


def subtract(C: Any, rows: int, A: Any, B: Any) -> None:
    """C[:rows] -= A[:rows] B' in place, all of them column-major."""
    _subtract(C, A, B, 0, 0, rows, C.shape[1])


def _subtract(C: Any, A: Any, B: Any, i: int, j: int, rows: int, columns: int) -> None:
    """The block of `rows` by `columns` at (i, j) of C, less that of A B'."""
    if A.shape[1] == 0:
        return
    for M, need in ((C, i + rows), (A, i + rows), (B, j + columns)):
        if M.strides[0] != _DOUBLE or M.dtype != np.float64 or len(M) < need:
            raise ValueError("column-major float64 matrices with enough rows are wanted")
    ref, c_int = ctypes.byref, ctypes.c_int
    lda, ldb, ldc = (max(M.strides[1] // _DOUBLE, 1) for M in (A, B, C))
    a, b, c = A.ctypes.data + _DOUBLE * i, B.ctypes.data + _DOUBLE * j, C.ctypes.data + _DOUBLE * (i + j * ldc)
    _dgemm()(b"N", b"T", ref(c_int(rows)), ref(c_int(columns)), ref(c_int(A.shape[1])), ref(_MINUS), a, ref(c_int(lda)),
             b, ref(c_int(ldb)), ref(_ONE), c, ref(c_int(ldc)))  # fmt: skip
