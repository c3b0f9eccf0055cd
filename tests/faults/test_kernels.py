"""Kept machine code that is damaged, or cannot be kept: kernels work, and mend what is there."""

import hashlib
import io
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap import jit
from occmap.errors import UsageError
from occmap.jit import Kernel, kernel
from tests.cli.runner import occmap
from tests.samples import SAMPLE_LOGS
from tests.test_layers import list_loaded_by


def double(value: float) -> float:
    return 2 * value


def put_what_is_no_code(_code: bytes) -> bytes:
    content = pickle.dumps(("of", "another", "make"))
    return hashlib.sha256(content).digest() + content


def flip_bit(code: bytes, place: int) -> bytes:
    return code[: place // 8] + bytes([code[place // 8] ^ 1 << place % 8]) + code[place // 8 + 1 :]


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "nothing is left": lambda _: b"",
    "half is left": lambda code: code[: len(code) // 2],
    "zeros are left": lambda code: bytes(len(code)),
    "other things are there": put_what_is_no_code,
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(jit, "list_folders", lambda _: (tmp_path / "kept",))
    return tmp_path / "kept"


def load(value: float = 21.0) -> Any:
    """What a new process finds of a kernel's code; None where it has to compile."""
    return Kernel(double)._load((type(value),), [value])


def run_anew() -> tuple[float, bool]:
    """Call a kernel as a new process would; return its result and whether code was there."""
    found = load() is not None
    return kernel(double)(21.0), found


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_code_is_compiled_anew_and_replaced(folder: Path, damage: str) -> None:
    assert run_anew() == (42.0, False)
    assert run_anew() == (42.0, True)
    (file,) = folder.iterdir()
    file.write_bytes(DAMAGE[damage](file.read_bytes()))
    assert run_anew() == (42.0, False)
    assert run_anew() == (42.0, True)


def test_no_flipped_bit_is_ever_run(folder: Path) -> None:
    run_anew()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    for place in np.linspace(0, 8 * len(whole) - 1, 300).astype(int).tolist():
        file.write_bytes(flip_bit(whole, place))
        assert load() is None
    file.write_bytes(whole)
    assert load() is not None


def test_code_that_cannot_be_read_or_written_is_done_without(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run_anew()
    (file,) = folder.iterdir()
    file.unlink()
    file.mkdir()  # neither a file to read nor a place to write one
    jit.warn_not_kept.cache_clear()
    assert run_anew() == (42.0, False)
    assert run_anew() == (42.0, False)
    (record,) = caplog.records
    assert "cannot be kept" in record.message
    assert "NUMBA_CACHE_DIR" in record.message


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), MemoryError()])
def test_a_full_disk_leaves_no_code_that_the_next_process_trusts(
    folder: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    class FullDisk(io.FileIO):
        def write(self, data: Any) -> int:
            super().write(data[: len(data) // 2])
            raise fault

    with monkeypatch.context() as patch:
        patch.setattr(io, "open", lambda path, mode, *_: FullDisk(path, mode))
        jit.warn_not_kept()  # said already: this test is not about it
        assert run_anew() == (42.0, False)
    (file,) = folder.iterdir()
    assert file.stat().st_size > 100
    assert run_anew() == (42.0, False)
    assert run_anew() == (42.0, True)


def test_code_is_loaded_from_a_folder_that_cannot_be_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_anew()
    nowhere = Path("/dev/null/below a file")
    monkeypatch.setattr(jit, "list_folders", lambda _: (nowhere, folder))
    assert run_anew() == (42.0, True)
    monkeypatch.setattr(jit, "list_folders", lambda _: (nowhere, folder.with_name("another")))
    assert run_anew() == (42.0, False)
    assert run_anew() == (42.0, True)


def test_kernels_that_cannot_be_compiled_say_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.config.DISABLE_JIT", 1)
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT is set"):
        jit.load_numba.__wrapped__()


BUILD = """
import sys
from occmap.cli import run
print(run(["build", "beam", *sys.argv[1:], "-q", "--jobs", "1"]), "numba" in sys.modules)
"""
"""Prints the exit code, and whether numba was needed"""


def test_a_build_loads_its_kernels_and_mends_them(tmp_path: Path) -> None:
    """A kernel's code is missing, there, and cut, as a full disk leaves it: each build works.

    The code of the other kernels is that which this process keeps, as compiling takes seconds.
    """
    folder, target = tmp_path / "cache", tmp_path / "m.pgm"
    words = SAMPLE_LOGS / "drive.mcap", "-o", target
    assert occmap("build", "beam", *words).code == 0
    places = jit.list_folders(Path(jit.__file__).parent / "grid" / "kernels")
    shutil.copytree(next(filter(Path.exists, places)), folder / places[0].name)
    next(folder.rglob("*.project_ends-*")).unlink()
    said, numbers, maps = [], [], [target.read_bytes()]
    for _ in range(3):
        command = [sys.executable, "-c", BUILD, *map(str, words)]
        shown, place = subprocess.STDOUT, {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
        said.append(subprocess.check_output(command, stderr=shown, text=True, env=place))
        maps.append(target.read_bytes())
        files = [path for path in folder.rglob("*") if path.is_file()]
        numbers.append(len(files))
        if len(said) == 2:
            (file,) = folder.rglob("*.project_ends-*")
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert said == ["0 True\n", "0 False\n", "0 True\n"]
    assert numbers[0] > 3
    assert numbers == [numbers[0]] * 3
    assert maps == [maps[0]] * 4


def test_a_build_of_clouds_needs_no_numba_either(tmp_path: Path) -> None:
    words = "build", SAMPLE_LOGS / "hall.mcap", "-o", tmp_path / "m.pgm"
    assert occmap(*words).code == 0  # and compiles, if nothing did before
    assert "numba" not in list_loaded_by(*words)


@pytest.mark.parametrize("suffix", [".py", ".pyc"])
def test_code_is_not_shared_by_kernels_that_differ(tmp_path: Path, suffix: str) -> None:
    folders = [tmp_path / "old", tmp_path / "new"]
    for folder in folders:
        folder.mkdir()
        (folder / f"lines{suffix}").write_text(folder.name)
    old, new = (jit.list_folders(folder)[0].name for folder in folders)
    assert old != new


def take_first(numbers: Any) -> float:
    return float(numbers.reshape(-1)[0])


def test_code_that_calls_a_helper_of_numba_is_refused() -> None:
    """A process that loads it without numba would end."""
    with pytest.raises(NotImplementedError, match="take_first: it calls a helper"):
        kernel(take_first)(np.zeros((2, 2)))
