"""How kernels are compiled: once, kept on disk where possible, and run without the GIL.

Importing numba takes longer than building a map of a short log, so only what has to compile does
it. Machine code is loaded by LLVM and called by ctypes, in the way in which numba's functions call
each other: `int name(result *, error **, arguments...)`, where a tuple is its items, one after the
other, and an array its fields.
"""

import ctypes
import hashlib
import inspect
import json
import logging
import os
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from ctypes import c_bool, c_double, c_int64, c_void_p
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from llvmlite import binding

from occmap import types
from occmap.errors import UsageError

F = TypeVar("F", bound=Callable[..., Any])
DIGEST_BYTES = hashlib.sha256().digest_size
RESULT_BYTES, ERROR_BYTES = 248, 8
NOTHING = type(None)
SCALARS = {bool: "boolean", int: "int64", float: "float64", NOTHING: "none"}
"""What numbers are to numba"""
IN_C: dict[type, Any] = {bool: c_bool, int: c_int64, float: c_double, NOTHING: c_void_p}
"""And in C, where an address is passed as any integer is"""
RESULTS = {"none": "", "bool": "?", "int32": "i", "int64": "q", "uint64": "Q", "float64": "d"}
"""What kernels return, by numba's names, in letters of `struct`"""

log = logging.getLogger(__name__)
_compiling = Lock()


def kernel(function: F) -> F:
    """Compile a function at its first call and keep the machine code for the next process.

    Where no folder can be written it still works, and compiles anew in every process. It takes
    arrays, numbers, None and tuples of these, and returns numbers or nothing. It makes no arrays,
    and writes only to those that its caller made for it.
    """
    return Kernel(function)  # type: ignore[return-value]  # called like it


def step(function: F) -> F:
    """Compile a function that is a step of kernels' innermost loops, and put it inline there."""
    return Kernel(function, forceinline=True)  # type: ignore[return-value]  # called like it


class Kernel:
    """A function that is compiled for each combination of types that it is called with."""

    def __init__(self, function: Callable[..., Any], **options: bool) -> None:
        self.py_func = function
        self.name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self.loaded: dict[Any, Callable[[list[Any]], Any]] = {}
        """What is called for arguments of some kinds"""
        self._options = options

    def __call__(self, *args: Any) -> Any:
        """Run the machine code for the types of these arguments."""
        values: list[Any] = []
        kind = tuple(flatten(arg, values) for arg in args)
        if kind not in self.loaded:
            with _compiling:
                if kind not in self.loaded:  # another thread may have been first
                    self.loaded[kind] = self._load(kind, values) or self._compile(kind, values)
        return self.loaded[kind](values)

    @cached_property
    def dispatcher(self) -> Any:
        """What numba knows the function as; other kernels that call it ask for it, too."""
        # What is for calls from Python and C would take a third of the time.
        unused = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
        options = {"error_model": "numpy", **unused, **self._options}
        return load_numba().njit(**options)(self.py_func)

    def _load(self, kind: Any, values: list[Any]) -> Callable[[list[Any]], Any] | None:
        """Load the code for these types, or nothing.

        Damaged machine code kills the process, so it stands after its SHA-256. Whatever goes wrong
        is a miss: the kernel is compiled, and the file is replaced.
        """
        for path in self._list_files(kind):
            with suppress(Exception):
                content = path.read_bytes()
                digest, content = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
                if hashlib.sha256(content).digest() == digest:
                    return link(content, values)
        return None

    def _compile(self, kind: Any, values: list[Any]) -> Callable[[list[Any]], Any]:
        """Compile for these types, and keep the code in the first folder that takes it."""
        content = compile_function(self.dispatcher, kind)
        for path in self._list_files(kind):
            with suppress(Exception):
                path.parent.mkdir(parents=True, exist_ok=True)
                # No temporary file is needed: a process that reads half of this one compiles anew.
                path.write_bytes(hashlib.sha256(content).digest() + content)
                break
        else:
            warn_not_kept()
        return link(content, values)

    def _list_files(self, kind: Any) -> Iterator[Path]:
        """Where the code for these types may be."""
        file = f"{self.name}-{hashlib.sha256(repr(kind).encode()).hexdigest()[:16]}.code"
        source = Path(inspect.getfile(sys.modules[self.py_func.__module__])).parent
        return (folder / file for folder in list_folders(source))


def flatten(arg: Any, values: list[Any]) -> Any:
    """Append what machine code takes for an argument to `values`, and say of what kind it is."""
    if isinstance(arg, np.ndarray):
        flags = arg.flags
        if flags.c_contiguous and flags.writeable and arg.size:
            address = ctypes.addressof(ctypes.c_char.from_buffer(arg.data))  # five times as fast
        else:
            address = arg.ctypes.data
        values.extend((None, None, arg.size, arg.itemsize, address, *arg.shape, *arg.strides))
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return arg.dtype, arg.ndim, layout, flags.aligned
    if isinstance(arg, tuple):
        return type(arg), tuple([flatten(each, values) for each in arg])
    value = arg.item() if isinstance(arg, np.generic) else arg
    values.append(value)
    return type(value)


@cache
def load_numba() -> Any:
    """Load numba, and tell it what kernels are where others call them."""
    import numba  # noqa: PLC0415  late: it takes long to load
    from numba.extending import typeof_impl  # noqa: PLC0415  likewise

    # Python's integers do not wrap, nor does 1 / 0 give inf.
    if getattr(numba.config, "DISABLE_JIT", 0):
        found = "NUMBA_DISABLE_JIT is set, and occmap's kernels are right only as machine code"
        raise UsageError(found, fix="unset it")
    typeof_impl.register(Kernel)(lambda called, _: numba.types.Dispatcher(called.dispatcher))
    return numba


def to_numba(kind: Any) -> Any:
    """Find numba's type for an argument of this kind."""
    numba = load_numba()
    if isinstance(kind, type):
        return getattr(numba.types, SCALARS[kind])
    if isinstance(kind[0], np.dtype):
        dtype, dimensions, layout, aligned = kind
        return numba.types.Array(numba.from_dtype(dtype), dimensions, layout, aligned=aligned)
    made, items = kind[0], tuple(map(to_numba, kind[1]))
    return numba.types.BaseTuple.from_types(items, None if made is tuple else made)


def compile_function(dispatcher: Any, kind: Any) -> bytes:
    """Compile a function for arguments of some kinds.

    Returns its name and what it returns, in a line of JSON, and machine code.
    """
    signature = tuple(map(to_numba, kind))
    dispatcher.compile(signature)
    compiled = dispatcher.overloads[signature]
    returned = compiled.signature.return_type
    result = "".join(RESULTS[str(each)] for each in getattr(returned, "types", [returned]))
    if struct.calcsize(result) > RESULT_BYTES or compiled.library.has_dynamic_globals:
        # The one writes beyond its room; the other knows an array by where it is in this process.
        raise NotImplementedError(f"{compiled.fndesc.qualname}: its code cannot be kept")
    described = json.dumps([compiled.fndesc.llvm_func_name, result])
    machine: bytes = compiled.library._get_compiled_object()
    if b"numba_" in machine:  # a helper, as of `array.reshape`, that a process without numba lacks
        raise NotImplementedError(f"{compiled.fndesc.qualname}: it calls a helper of numba")
    return described.encode() + b"\n" + machine


def link(content: bytes, values: Sequence[Any]) -> Callable[[list[Any]], Any]:
    """Make a function, of what `compile_function` gives, that takes such values.

    They are what `flatten` appends for its arguments.
    """
    described, _, machine = content.partition(b"\n")
    name, returned = json.loads(described)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    processor = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), processor)
    engine.add_object_file(binding.ObjectFileRef.from_data(machine))
    engine.finalize_object()
    in_c = [IN_C[type(value)] for value in values]
    prototype = ctypes.CFUNCTYPE(ctypes.c_int, c_void_p, c_void_p, *in_c)
    function = prototype(engine.get_function_address(name))
    unpack = struct.Struct(returned).unpack_from

    def call(values: list[Any]) -> Any:
        room = (ctypes.c_char * (RESULT_BYTES + ERROR_BYTES))()
        place = ctypes.addressof(room)
        if function(place, place + RESULT_BYTES, *values):
            raise IndexError  # NUMBA_BOUNDSCHECK is set
        result = unpack(room)
        return result if len(result) > 1 else next(iter(result), None)

    call.engine = engine  # type: ignore[attr-defined]  # the owner of the code
    return call


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

    A kernel's code contains that of the kernels that it calls and the values of constants, maybe of
    other folders of kernels, and knows the fields of `Rays` by their places. So the name is a
    digest of all of these, as .py or, in an install without sources, as .pyc, of what turned them
    into code, and of the processor.
    """
    others = Path(__file__).parent.glob("*/kernels/*.py*")
    found = {Path(__file__), Path(types.__file__), *source.glob("*.py*"), *others}
    sources = sorted(each for each in found if each.is_file())
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources))
    settings = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))
    settings = [item for item in settings if item[0] != "NUMBA_CACHE_DIR"]  # says where, not how
    features = binding.get_host_cpu_features().flatten()
    processor = binding.get_process_triple(), binding.get_host_cpu_name(), features
    digest.update(repr((version("numba"), settings, processor)).encode())
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
