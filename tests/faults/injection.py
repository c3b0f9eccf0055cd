"""Faults of a disk and of a memory, at the n-th call of a kind within one folder."""

import builtins
import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

KINDS = ("open", "read", "write", "fsync", "rename")
FAULTS: dict[str, Callable[[], Exception]] = {
    "EIO": lambda: OSError(errno.EIO, os.strerror(errno.EIO)),
    "ENOSPC": lambda: OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)),
    "EINTR": lambda: OSError(errno.EINTR, os.strerror(errno.EINTR)),
    "memory": MemoryError,
}


class Injector:
    """Counts the calls of each kind, and raises at one of them."""

    def __init__(self, folder: Path, kind: str = "", number: int = 0, fault: str = "EIO") -> None:
        self.folder = os.path.realpath(folder)
        self.counts = dict.fromkeys(KINDS, 0)
        self._target = kind, number
        self._fault = fault

    @property
    def fired(self) -> bool:
        kind, number = self._target
        return bool(kind) and self.counts[kind] >= number

    def count(self, kind: str) -> None:
        self.counts[kind] += 1
        if (kind, self.counts[kind]) == self._target:
            raise FAULTS[self._fault]()

    def concerns(self, file: Any) -> bool:
        if isinstance(file, int):
            return False
        return str(os.path.realpath(os.fspath(file))).startswith(self.folder)

    def open(self, file: Any, mode: str = "r", *args: Any, **settings: Any) -> Any:
        """Open as `open` does, with buffers of the usual kind over a file that has faults."""
        if not self.concerns(file):
            return plain_open(file, mode, *args, **settings)
        self.count("open")
        raw = FaultyFile(file, mode.replace("b", "").replace("t", ""), self)
        buffered: Any = io.BufferedWriter(raw) if raw.writable() else io.BufferedReader(raw)
        if "b" in mode:
            return buffered
        return io.TextIOWrapper(buffered, encoding=settings.get("encoding"))


class FaultyFile(io.FileIO):
    def __init__(self, file: Any, mode: str, injector: Injector) -> None:
        super().__init__(file, mode)
        self._injector = injector

    def readinto(self, buffer: Any) -> Any:
        self._injector.count("read")
        return super().readinto(buffer)

    def readall(self) -> Any:
        self._injector.count("read")
        return super().readall()

    def write(self, data: Any) -> Any:
        """Write; at a fault only half, as on a disk that is full, but nothing where interrupted."""
        try:
            self._injector.count("write")
        except InterruptedError:
            raise
        except Exception:
            super().write(memoryview(data)[: len(data) // 2])
            raise
        return super().write(data)


plain_open, plain_os_open, plain_fsync, plain_replace = open, os.open, os.fsync, os.replace


@contextmanager
def inject(injector: Injector) -> Iterator[None]:
    """Let the injector see each call in the block."""

    def open_descriptor(file: Any, *args: Any, **settings: Any) -> int:
        if injector.concerns(file):
            injector.count("open")
        return plain_os_open(file, *args, **settings)

    def sync(descriptor: int) -> None:
        injector.count("fsync")
        plain_fsync(descriptor)

    def rename(old: Any, new: Any, **settings: Any) -> None:
        if injector.concerns(new):
            injector.count("rename")
        plain_replace(old, new, **settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builtins, "open", injector.open)
        patch.setattr(io, "open", injector.open)
        patch.setattr(os, "open", open_descriptor)
        patch.setattr(os, "fsync", sync)
        patch.setattr(os, "replace", rename)
        yield
