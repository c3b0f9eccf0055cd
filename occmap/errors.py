"""The errors that occmap raises: each writes its own sentence and knows its exit code."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, ClassVar, Self


class OccmapError(Exception):
    """Something a person can mend; the message is one line.

    Parameters
    ----------
    found
        What is wrong, as a sentence without a full stop.
    where
        The file, and the line, byte or topic in it.
    fix
        What to do or type next.
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, found: str, *, where: object = "", fix: str = "") -> None:
        super().__init__(found, where, fix)
        self.found = found
        self.where = str(where)
        self.fix = fix

    def __reduce__(self) -> tuple[Any, ...]:
        """Survive pickling: what is wrong, where and the fix are more than one argument."""
        return partial(type(self), self.found, where=self.where, fix=self.fix), ()

    def placed(self, where: object) -> Self:
        """The same error with a place, unless it names one already."""
        return type(self)(self.found, where=self.where or where, fix=self.fix)

    def __str__(self) -> str:
        sentence = f"{self.where}: {self.found}" if self.where else self.found
        if self.fix:
            sentence = f"{sentence}; {self.fix}"
        return " ".join(sentence.split())


class LogError(OccmapError):
    """A log cannot be read, or holds no scans."""


@contextmanager
def refuse_unreadable(
    path: object, kind: type[OccmapError] = LogError, fix: str = ""
) -> Iterator[None]:
    """Say in one line what keeps the system from reading a file; raises an error of some kind."""
    try:
        yield
    except OSError as error:
        raise kind(f"cannot be read ({error.strerror})", where=path, fix=fix) from None


class DamageError(LogError):
    """One message, scan or file of a log is damaged; the others can be used."""


class PoseError(OccmapError):
    """Scans have no pose in the map frame."""


class MountError(PoseError):
    """Scans have no pose, since neither log nor user says where the laser sits on the robot."""

    UNKNOWN = "x,y,yaw"
    """Stands in `fix` for the mount that is to be given"""

    def named(self, mount: str, why: str) -> Self:
        """The same error, which now names a mount that suits the scans, and says why it does."""
        fix = f"{self.fix.replace(self.UNKNOWN, mount)}, {why}"
        return type(self)(self.found, where=self.where, fix=fix)


class MapError(OccmapError):
    """A map cannot be made from what was observed: nothing there, or too large."""


@contextmanager
def name_log(path: object) -> Iterator[None]:
    """Let an error about a map, or about what a reader gives, name the log at which it was met.

    Raises
    ------
    MapError, DamageError
        The same, with a place.
    """
    try:
        yield
    except (MapError, DamageError) as error:
        raise error.placed(path) from None


@contextmanager
def refuse_failures() -> Iterator[None]:
    """Say in one line what the system refuses: more memory, a path too long, a disk that fails.

    Raises
    ------
    OccmapError
        In place of a MemoryError or an OSError.
    """
    try:
        yield
    except MemoryError:
        fix = "try a coarser `resolution` or fewer `jobs`"
        raise OccmapError("out of memory", fix=fix) from None
    except BrokenPipeError:  # who reads the output has seen enough
        raise
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise OccmapError(found, where=error.filename or "") from error


class OutputError(OccmapError):
    """A file cannot be written."""


class UsageError(OccmapError):
    """An option or a name that occmap does not know, or a value out of its range."""

    exit_code = 2


def require(holds: bool, found: str, fix: str) -> None:
    """Raise UsageError unless a condition on an option holds."""
    if not holds:
        raise UsageError(found, fix=fix)


class FleetError(OccmapError):
    """The workers cannot run the build."""
