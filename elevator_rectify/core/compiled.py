"""Compiles the inner loops with numba where it is installed; without, NumPy does the same work, slower.

Numba takes some 130 MB of memory; the environment variable ELEVATOR_RECTIFY_NUMBA=0 leaves it out.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from elevator_rectify.core.types import Array

_Function = TypeVar("_Function", bound=Callable[..., Any])
_SWITCH = "ELEVATOR_RECTIFY_NUMBA"


def _numba() -> Any:
    if os.environ.get(_SWITCH, "1") == "0":
        return None
    try:
        return importlib.import_module("numba")
    except ImportError:
        return None


_NUMBA = _numba()
# Whether the kernels are compiled: only then are they faster than NumPy.
COMPILED = _NUMBA is not None


def compiled(function: _Function) -> _Function:
    """Return the function compiled at its first call and kept on disk; as it is where numba is not installed."""
    return _compiled(function)


def reordered(function: _Function) -> _Function:
    """Compile a function of long sums, whose terms may be added in any order: several at once."""
    return _compiled(function, fastmath={"reassoc", "contract"})


def plain(array: Any) -> Array:
    """Return the array as kernels take it: contiguous, of double precision, not read-only. Of another type of argument
    numba would compile the kernel again, for seconds."""
    given = np.ascontiguousarray(array, dtype=np.float64)
    return given if given.flags.writeable else given.copy()


def _compiled(function: _Function, **options: Any) -> _Function:
    if _NUMBA is None:
        return function
    kernel: _Function = _NUMBA.njit(cache=True, error_model="numpy", **options)(function)
    return kernel
