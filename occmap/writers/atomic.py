"""Files that appear whole or not at all: a temporary name beside the target, then a rename."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from occmap.errors import OutputError


def check_target(path: Path) -> None:
    """Check that a file can be written, before the work that fills it starts.

    Raises
    ------
    OutputError
        The folder is missing or cannot be written, or the path is a folder itself.
    """
    folder = path.parent
    if path.is_dir():
        raise OutputError("is a folder, not a file", where=path, fix="give a file name")
    if not folder.exists():
        raise OutputError(
            f"the folder {folder} does not exist", where=path, fix=f"create it: mkdir -p {folder}"
        )
    if not folder.is_dir():
        raise OutputError(f"{folder} is a file, not a folder", where=path)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(
            f"no permission to write into the folder {folder}",
            where=path,
            fix="choose another folder",
        )


@contextmanager
def open_atomic(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that replaces `path` only when the block ends without an error.

    Whatever interrupts the block, Ctrl-C too, leaves no new file and an old one as it was.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    check_target(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        # Not tempfile: its files are readable by their owner only, whatever the umask says.
        with temporary.open("xb") as file:
            yield file
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise OutputError(f"cannot be written ({reason})", where=path) from None
    finally:
        temporary.unlink(missing_ok=True)
