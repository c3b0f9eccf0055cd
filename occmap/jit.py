"""How kernels are compiled: once, kept on disk where possible, and run without the GIL."""

import hashlib
import inspect
import logging
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from occmap import types

F = TypeVar("F", bound=Callable[..., Any])
DIGEST_BYTES = hashlib.sha256().digest_size

log = logging.getLogger(__name__)


def kernel(function: F) -> F:
    """Compile a function at its first call and keep the machine code for the next process.

    Where no folder can be written it still works, and compiles anew in every process.
    """
    return compile_kept(function, forceinline=False)


def step(function: F) -> F:
    """Compile a function that is a step of kernels' innermost loops, and put it inline there.

    It counts no references to arrays, which would cost more than all that it does. So it makes,
    slices and returns none.
    """
    return compile_kept(function, forceinline=True)


def compile_kept(function: F, forceinline: bool) -> F:
    """Compile a function at its first call, as `kernel` and `step` say."""
    options: dict[str, Any] = {"forceinline": forceinline, "_nrt": not forceinline}
    options["no_cfunc_wrapper"] = True  # nobody calls from C, and it takes a tenth of the time
    compiled: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    compiled._cache = KeptCode(function)
    return compiled  # type: ignore[no-any-return]  # called like the function it was made of


class KeptCode(NullCache):
    """The machine code of one kernel on disk, in numba's own interface of a cache.

    A file holds the code after its SHA-256, since damaged machine code kills the process.
    Whatever goes wrong while code is loaded is a miss: numba compiles, and the file is replaced.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._source = Path(inspect.getfile(sys.modules[function.__module__])).parent

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for these types, or None.

        numba's own cache first imports and registers all that a function might call while it is
        compiled, which takes a tenth of a second. Kept code needs only the runtime that allocates
        arrays, and numba prepares once more where it has to compile.
        """
        for path in self._list_files(sig, target_context.codegen()):
            with suppress(Exception):
                content = path.read_bytes()
                digest, code = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
                if hashlib.sha256(code).digest() == digest:
                    rtsys.initialize(target_context)
                    rebuild: Callable[..., Any] = CompileResult._rebuild
                    return rebuild(target_context, *pickle.loads(code))
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for these types in the first folder that takes it."""
        if data.library.has_dynamic_globals:  # addresses that mean nothing to another process
            return
        for path in self._list_files(sig, data.codegen):
            with suppress(Exception):
                code: bytes = dumps(data._reduce())  # type: ignore[no-untyped-call]
                path.parent.mkdir(parents=True, exist_ok=True)
                # No temporary file is needed: a process that reads half of this one compiles anew.
                path.write_bytes(hashlib.sha256(code).digest() + code)
                return
        warn_not_kept()

    def _list_files(self, sig: Any, codegen: Any) -> Iterator[Path]:
        """Where the code for these types and this processor may be."""
        kind = hashlib.sha256(repr((sig, codegen.magic_tuple())).encode()).hexdigest()
        return (folder / f"{self._name}-{kind[:16]}.code" for folder in list_folders(self._source))


@cache
def warn_not_kept() -> None:
    """Say once that no folder takes machine code."""
    log.warning(
        "compiled kernels cannot be kept: each run compiles anew, which takes some seconds; "
        "set NUMBA_CACHE_DIR to a folder that can be written"
    )


@cache
def list_folders(source: Path) -> tuple[Path, ...]:
    """Name the folders for the machine code of the kernels in a folder, the preferred one first.

    A kernel's code contains that of the kernels that it calls, and knows the fields of `Rays` by
    their places. So the name is a digest of all of these, as .py or, in an install without sources,
    as .pyc, and of what turned them into code.
    """
    sources = sorted([Path(__file__), Path(types.__file__), *source.glob("*.py*")])
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources))
    settings = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))
    settings = [item for item in settings if item[0] != "NUMBA_CACHE_DIR"]  # says where, not how
    digest.update(repr((sys.version, numba.__version__, settings)).encode())
    return tuple(base / f"occmap-{digest.hexdigest()[:16]}" for base in list_bases(source))


def list_bases(source: Path) -> Iterator[Path]:
    """Where machine code may be kept: where the user says, or else beside the source or at home."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
        return
    yield source / "__pycache__"
    if home := os.environ.get("XDG_CACHE_HOME"):
        yield Path(home) / "occmap"
    elif home := os.environ.get("HOME"):
        yield Path(home) / ".cache" / "occmap"
