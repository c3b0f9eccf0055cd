import errno
import os
import stat
from pathlib import Path
from typing import Any

import pytest

from occmap.errors import OutputError
from occmap.writers.atomic import open_atomic


def test_writes_the_file_and_nothing_else(tmp_path: Path) -> None:
    with open_atomic(tmp_path / "map.pgm") as (file,):
        file.write(b"new")
        assert not (tmp_path / "map.pgm").exists()
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.pgm"]
    assert (tmp_path / "map.pgm").read_bytes() == b"new"


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError])
def test_an_interrupted_write_keeps_the_old_file(
    tmp_path: Path, failure: type[BaseException]
) -> None:
    target = tmp_path / "map.pgm"
    target.write_bytes(b"old")

    def interrupt_halfway() -> None:
        with open_atomic(target) as (file,):
            file.write(b"half")
            raise failure

    with pytest.raises(failure):
        interrupt_halfway()
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_full_disk_is_one_sentence(tmp_path: Path) -> None:
    target = tmp_path / "map.pgm"
    with pytest.raises(OutputError) as caught, open_atomic(target):
        raise OSError(28, "No space left on device")
    assert str(caught.value) == (
        f"{target}: cannot be written (No space left on device); make room there, or write to "
        "another disk"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc on this system")
def test_folder_that_refuses_new_files() -> None:
    with pytest.raises(OutputError), open_atomic(Path("/proc/map.pgm")):
        pytest.fail("the block must not run")


@pytest.mark.parametrize("code", [errno.EINVAL, errno.EACCES, errno.EIO])
def test_a_folder_that_cannot_be_synced_is_an_error_only_where_the_disk_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """Some file systems sync no folders, and who may write into one may be barred from reading."""
    plain_open, plain_fsync = os.open, os.fsync

    def open_descriptor(path: Any, flags: int, *mode: int) -> int:
        if Path(path) == tmp_path and code == errno.EACCES:
            raise OSError(code, "refused")
        return plain_open(path, flags, *mode)

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(code, "refused")
        plain_fsync(descriptor)

    monkeypatch.setattr(os, "open", open_descriptor)
    monkeypatch.setattr(os, "fsync", fsync)
    said = ""
    try:
        with open_atomic(tmp_path / "map.pgm") as (file,):
            file.write(b"new")
    except OutputError as error:
        said = str(error)
    assert ("refused" in said) == (code == errno.EIO)
    assert (tmp_path / "map.pgm").read_bytes() == b"new"
