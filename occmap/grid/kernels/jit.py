"""How kernels are compiled: once, kept on disk where possible, and run without the GIL."""

import hashlib
import logging
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.runtime.nrt import rtsys

F = TypeVar("F", bound=Callable[..., Any])

log = logging.getLogger(__name__)


def kernel(function: F) -> F:
    """Compile a function at its first call and keep the machine code for the next process.

    Where no folder can be written it still works, and compiles anew in every process.
    """
    folder = find_cache_folder()
    if folder is None:
        return numba.njit(nogil=True, error_model="numpy")(function)  # type: ignore[return-value]  # as below
    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
    try:
        compiled = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    finally:
        config.CACHE_DIR = before
    load_kept_alone(compiled)
    return compiled  # type: ignore[return-value]  # it is called like the function it was made of


def load_kept_alone(compiled: Any) -> None:
    """Load kept machine code without preparing to compile: a tenth of a second less at a start.

    Before it looks for kept code, numba imports and registers all that a function might call while
    it is compiled. Of that, kept code needs the runtime that allocates arrays; and where there is
    none to load, numba prepares once more before it compiles. A numba that is made otherwise is
    left as it is.
    """
    kept: Any = getattr(compiled, "_cache", None)
    inner = "load_overload", "_load_overload", "_guard_against_spurious_io_errors"
    if not all(hasattr(kept, name) for name in inner):
        return

    def load_overload(signature: Any, context: Any) -> Any:
        rtsys.initialize(context)
        with kept._guard_against_spurious_io_errors():
            return kept._load_overload(signature, context)

    kept.load_overload = load_overload


@cache
def find_cache_folder() -> Path | None:
    """Find a folder for the machine code of just these sources; None, and a warning, if none is.

    numba compares only the file that a kernel stands in, not those of the kernels that it calls:
    after an upgrade it would go on with the old ones. So the folder's name says what it is for.
    """
    sources = sorted(Path(__file__).parent.glob("*.py"))
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    for base in list_bases():
        folder = base / f"occmap-{digest[:16]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    log.warning(
        "compiled kernels cannot be kept: each run compiles anew, which takes some seconds; "
        "set NUMBA_CACHE_DIR to a folder that can be written"
    )
    return None


def list_bases() -> Iterator[Path]:
    """Where machine code may be kept: where the user says, beside the source, or at home."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
    yield Path(__file__).parent / "__pycache__"
    if home := os.environ.get("XDG_CACHE_HOME"):
        yield Path(home) / "occmap"
    elif home := os.environ.get("HOME"):
        yield Path(home) / ".cache" / "occmap"
