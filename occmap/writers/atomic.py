"""Files that appear whole or not at all, also through a power cut.

A file is written under a temporary name beside its target, synced, and renamed. Files that belong
together are renamed one after the other when all are complete: if the machine stops between two
renames, each is whole, but the first may be new and the next still the old one.
"""

import errno
import logging
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from occmap.errors import OutputError
from occmap.types import Paths

log = logging.getLogger(__name__)


def follow_links(path: Path) -> Path:
    """Find the file that writing to a path means: that at the end of its symbolic links."""
    return Path(os.path.realpath(path))


def check_target(path: Path) -> None:
    """Check that a file can be written, before the work that fills it starts.

    Raises
    ------
    OutputError
        The folder is missing or cannot be written, or the path cannot be that of a file.
    """
    target, mode = follow_links(path), stat.S_IFREG
    with refuse_unwritable(path):  # the name may be too long, or its links lead in a circle
        folder = (target if path.is_symlink() else path).parent
        with suppress(FileNotFoundError, NotADirectoryError):
            mode = target.stat().st_mode
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
        raise OutputError(f"is {kind}, not a file", where=path, fix="give a file name")
    check_parent(path, folder)


def check_parent(path: Path, folder: Path) -> None:
    """Check that something can be made in the folder that a path lies in.

    Raises
    ------
    OutputError
        The folder is missing or cannot be written.
    """
    if not folder.exists():
        found, fix = f"the folder {folder} does not exist", f"create it: mkdir -p {folder}"
        raise OutputError(found, where=path, fix=fix)
    if not folder.is_dir():
        raise OutputError(f"{folder} is a file, not a folder", where=path)
    if not os.access(folder, os.W_OK | os.X_OK):
        found = f"no permission to write into the folder {folder}"
        raise OutputError(found, where=path, fix="choose another folder")


MENDS = {
    errno.ENOSPC: "make room there, or write to another disk",
    errno.EFBIG: "raise the largest size of a file: see ulimit -f",
}
"""What to do about errors of the system"""


@contextmanager
def refuse_unwritable(path: Path) -> Iterator[None]:
    """Say in one line what keeps the system from writing a file or a folder; raises OutputError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or type(error).__name__
        fix = MENDS.get(error.errno or 0, "")
        raise OutputError(f"cannot be written ({reason})", where=path, fix=fix) from None


@contextmanager
def open_atomic(*paths: Path) -> Iterator[Sequence[BinaryIO]]:
    """Open files for writing that replace those at `paths` only when the block ends well.

    Whatever interrupts the block, Ctrl-C too, leaves no new file and the old ones as they were.
    A file that is replaced keeps its owner and mode; a symbolic link goes on pointing at it.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    for path in paths:
        check_target(path)
    targets = [follow_links(path) for path in paths]
    temporaries = [name_temporary(each) for each in targets]
    try:
        with refuse_unwritable(paths[0]):
            with ExitStack() as stack:
                # Not tempfile: its files are readable by their owner only, whatever the umask says.
                files = [stack.enter_context(each.open("xb")) for each in temporaries]
                for temporary, target in zip(temporaries, targets, strict=True):
                    keep_access(temporary, target)
                yield files
                for file in files:
                    file.flush()
                    os.fsync(file.fileno())
            names = [str(each) for each in temporaries], [str(each) for each in targets]
            list(map(os.replace, *names))  # all in C: no signal is answered between two renames
            for folder in {target.parent for target in targets}:
                sync_folder(folder)
    finally:
        for temporary in temporaries:
            temporary.unlink(missing_ok=True)


def name_temporary(target: Path) -> Path:
    """Name a file beside its target, whose own name may be too long to add to."""
    return target.with_name(f".occmap-{secrets.token_hex(8)}.tmp")


@contextmanager
def make_folder(path: Path, name: str = "") -> Iterator[Path]:
    """Make a folder that appears whole, or replaces the one at `path`, when the block ends well.

    Where the machine stops between two renames, the one before is still there, under a name that
    ends in `.past`.

    Parameters
    ----------
    name
        What it is called until then. What a process that was killed left under that name goes.

    Raises
    ------
    OutputError
        It cannot be put there.
    """
    target = follow_links(path)
    temporary = target.with_name(name) if name else name_temporary(target)
    shutil.rmtree(temporary, ignore_errors=True)
    past = temporary.with_suffix(".past")
    try:
        with refuse_unwritable(path):
            yield temporary
            for file in filter(Path.is_file, temporary.rglob("*")):
                with file.open("rb") as opened:
                    os.fsync(opened.fileno())
            if target.exists():
                target.rename(past)
            temporary.rename(target)
            sync_folder(target.parent)
            shutil.rmtree(past, ignore_errors=True)
    except OutputError as error:  # of the temporary folder, which nobody knows
        raise OutputError(error.found, where=path, fix=error.fix) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def keep_access(new: Path, old: Path) -> None:
    """Give a new file the owner and the mode of the one that it is to replace, if there is one."""
    if not old.exists():
        return
    kept, now = old.stat(), new.stat()
    if (now.st_uid, now.st_gid) != (kept.st_uid, kept.st_gid):
        with suppress(PermissionError):  # only root may give files away
            os.chown(new, kept.st_uid, kept.st_gid)
    if now.st_mode != kept.st_mode:  # not every file system can change it
        new.chmod(stat.S_IMODE(kept.st_mode))


def sync_folder(folder: Path) -> None:
    """Make what was renamed in a folder last through a power cut, where the system can do so."""
    with suppress(PermissionError):  # it may be written, but not read; Windows opens no folder
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL:  # some file systems do not sync folders
                raise
        finally:
            os.close(descriptor)


@contextmanager
def hold_alone(path: Path | None, outputs: Paths) -> Iterator[None]:
    """Hold a file that is added to and replaced, if it is an output; another occmap waits for it.

    Where the file is not there yet, its folder is held. The lock ends with the process. Where the
    system or the file system has no such locks, or the file cannot be opened, it is not held.
    """
    with ExitStack() as stack:
        if path is not None and follow_links(path) in map(follow_links, outputs):
            while not lock(path, stack):
                stack.close()
        yield


def lock(path: Path, stack: ExitStack) -> bool:
    """Lock a file or folder until the stack closes; False where another occmap just replaced it."""
    if sys.platform == "win32":
        return True
    import fcntl  # noqa: PLC0415  Windows has none

    with suppress(OSError):
        there = path if path.exists() else path.parent
        # NFS locks only files, and only for who may write to them.
        is_writable = there.is_file() and os.access(there, os.W_OK)
        file = os.open(there, os.O_RDWR if is_writable else os.O_RDONLY)
        stack.callback(os.close, file)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            log.warning("%s: waiting for another occmap that writes to it", path)
            fcntl.flock(file, fcntl.LOCK_EX)
        there = path if path.exists() else path.parent
        return os.path.samestat(os.fstat(file), there.stat())
    return True
