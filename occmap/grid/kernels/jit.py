"""How kernels are compiled: once, kept on disk where possible, without the interpreter's lock."""

import logging
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

log = logging.getLogger(__name__)


def kernel(function: F) -> F:
    """Compile a function at its first call and keep the machine code for the next process.

    Where neither the source's folder nor the user's cache can be written, it still works and
    compiles anew in every process.
    """
    try:
        compiled = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # numba found no folder that it may write to
        _report_no_cache()
        compiled = numba.njit(nogil=True, error_model="numpy")(function)
    return compiled  # type: ignore[return-value]  # it is called like the function it was made of


@cache
def _report_no_cache() -> None:
    log.warning(
        "compiled kernels cannot be kept: each run compiles anew, which takes some seconds; "
        "set NUMBA_CACHE_DIR to a folder that can be written"
    )
