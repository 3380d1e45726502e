"""P -= A B' on the lower triangle, in place, by BLAS: one pass over the memory of P.

scipy's own wrappers copy a matrix that is part of a larger buffer; so dgemm is called by its address, panel by panel.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

PANEL = 256  # columns: a panel of P with W stays in the second-level cache

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

    A B' must be symmetric. Elements above the diagonal within a panel's own square are written too: they hold nothing.
    """
    for M in (P, A, B):
        if M.strides[0] != _DOUBLE or M.dtype != np.float64 or len(M) < dim:
            raise ValueError("column-major float64 matrices with at least `dim` rows are wanted")
    if A.shape[1] == 0:
        return
    ld = [ctypes.c_int(max(M.strides[1] // _DOUBLE, 1)) for M in (A, B, P)]
    at = [M.ctypes.data for M in (A, B, P)]
    inner, ref, call = ctypes.c_int(A.shape[1]), ctypes.byref, _dgemm()
    for j in range(0, dim, PANEL):
        rows, columns = ctypes.c_int(dim - j), ctypes.c_int(min(PANEL, dim - j))
        here = [at[0] + _DOUBLE * j, at[1] + _DOUBLE * j, at[2] + _DOUBLE * (j + j * ld[2].value)]
        call(b"N", b"T", ref(rows), ref(columns), ref(inner), ref(_MINUS), here[0], ref(ld[0]), here[1], ref(ld[1]),
             ref(_ONE), here[2], ref(ld[2]))  # fmt: skip
