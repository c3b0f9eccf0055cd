"""What may stand where an output is to go, and what a command makes of it."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from occmap.store.merging import merge
from occmap.writers.atomic import hold_alone
from occmap.writers.npz import read_evidence, write_evidence
from tests.cli.runner import occmap, read_error
from tests.samples import write_csv

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="modes, links and pipes of POSIX")


@pytest.fixture(autouse=True)
def folder(here: Path) -> Path:
    write_csv(here / "a.csv", [(0.0, 0.0, 0.0)] * 10, [0.3])
    return here


def build(*outputs: str) -> None:
    assert occmap("build a.csv" + "".join(f" -o {name}" for name in outputs)).code == 0


def read_mode(name: str) -> int:
    return stat.S_IMODE(Path(name).stat().st_mode)


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666, 0o444])
def test_a_file_that_is_replaced_keeps_its_mode(mode: int) -> None:
    for name in ("m.pgm", "m.yaml", "m.npz"):
        Path(name).write_bytes(b"old")
        Path(name).chmod(mode)
    build("m.pgm", "m.npz")
    assert [read_mode(name) for name in ("m.pgm", "m.yaml", "m.npz")] == [mode] * 3


def test_a_new_file_has_the_mode_of_the_umask() -> None:
    before = os.umask(0o027)
    try:
        build("m.pgm")
    finally:
        os.umask(before)
    assert [read_mode("m.pgm"), read_mode("m.yaml")] == [0o640] * 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_file_that_is_replaced_keeps_its_owner() -> None:
    Path("m.png").write_bytes(b"old")
    os.chown("m.png", 1234, 2345)
    build("m.png")
    owner = Path("m.png").stat()
    assert (owner.st_uid, owner.st_gid) == (1234, 2345)


def test_a_symbolic_link_is_written_through(folder: Path) -> None:
    (folder / "maps").mkdir()
    Path("m.png").symlink_to("link.png")
    Path("link.png").symlink_to(folder / "maps" / "real.png")
    for _ in ("a link to nothing", "a link to a file"):
        build("m.png")
        assert Path("m.png").is_symlink()
        assert (folder / "maps" / "real.png").read_bytes().startswith(b"\x89PNG")
        assert list((folder / "maps").iterdir()) == [folder / "maps" / "real.png"]


@pytest.mark.parametrize(
    ("target", "found"),
    [
        ("m.png", "cannot be written (Too many levels of symbolic links)"),
        ("nowhere/m.png", "the folder {folder}/nowhere does not exist"),
        ("pipe", "is a device or a pipe, not a file; give a file name"),
        ("sub", "is a folder, not a file"),
    ],
)
def test_a_link_that_leads_to_no_file_is_refused_and_left(
    folder: Path, target: str, found: str
) -> None:
    os.mkfifo("pipe")
    Path("sub").mkdir()
    Path("m.png").symlink_to(target)
    error = read_error(occmap("build a.csv -o m.png"), 1)
    assert error.startswith(f"m.png: {found.format(folder=folder)}")
    assert Path("m.png").is_symlink()
    assert Path("pipe").is_fifo()


def test_a_pipe_is_refused_and_left() -> None:
    os.mkfifo("m.png")
    error = read_error(occmap("build a.csv -o m.png"), 1)
    assert error.startswith("m.png: is a device or a pipe, not a file")
    assert Path("m.png").is_fifo()


@pytest.mark.parametrize("length", [240, 250, 255])
def test_names_as_long_as_names_can_be(length: int) -> None:
    name = "m" * (length - 4) + ".png"
    build(name)
    assert Path(name).stat().st_size > 0


@pytest.mark.parametrize("other", ["./m.png", "sub/../m.png", "link/m.png", "linked.png"])
def test_two_spellings_of_one_output_are_refused(folder: Path, other: str) -> None:
    (folder / "sub").mkdir()
    Path("link").symlink_to(folder)
    Path("linked.png").symlink_to("m.png")
    error = read_error(occmap(f"build a.csv -o m.png -o {other}"), 2)
    assert error.startswith("m.png: would be written twice")
    assert not Path("m.png").exists()


INPUTS = [
    "render m.npz -o m.npz",
    "render m.npz -o sub/../m.npz",
    "render link.npz -o m.npz",
    "render m.npz -o m.pgm -o hard.npz",
    "merge m.npz n.npz -o n.npz",
    "merge n.npz --subtract m.npz -o m.npz",
    "diff m.png n.png -o m.png",
    "diff m.png n.png -o n.png",
    "build a.csv --poses m.yaml -o m.pgm",
    "build m.npz -o m.npz",
    "build bag -o bag/metadata.pgm",
    "build bag -o bag/bag_0.mcap",
    "compare m.png -o m.png",
]


@pytest.mark.parametrize("line", INPUTS)
def test_an_input_is_never_overwritten(folder: Path, line: str) -> None:
    build("m.npz", "n.npz", "m.png", "n.png", "m.pgm")
    for name in ("sub", "bag"):
        (folder / name).mkdir()
    Path("bag/metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    Path("bag/bag_0.mcap").write_bytes(b"what was recorded")
    Path("link.npz").symlink_to("m.npz")
    os.link("m.npz", "hard.npz")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert ": is an input: it would be overwritten" in read_error(occmap(line), 2)
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_map_may_be_written_into_a_folder_that_is_read_and_again(folder: Path) -> None:
    (folder / "bag").mkdir()
    shutil.copy("a.csv", "bag")
    for _ in range(2):
        assert occmap("build bag/a.csv -o bag/m.pgm -o bag/m.npz").code == 0
        assert occmap("build a.csv --resume bag/m.npz -o ./bag/m.npz").code == 0


def test_two_that_add_to_one_file_add_both(folder: Path) -> None:
    """The second waits, and then reads what the first has written, not what it found."""
    build("m.npz")
    target, first = folder / "m.npz", read_evidence(folder / "m.npz")
    second = [sys.executable, "-m", "occmap", "build", "a.csv", "--resume", "m.npz", "-o", "m.npz"]
    with hold_alone(target, [target]):
        process = subprocess.Popen(
            second, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None
        said = process.stderr.readline()
        write_evidence(target, merge([first, first]))
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert said == "m.npz: waiting for another occmap that writes to it\n"
    assert "added to 20 of 20 in m.npz" in out
    assert len(read_evidence(target).manifest.builds) == 3


def test_a_build_that_only_reads_evidence_waits_for_nobody(folder: Path) -> None:
    build("m.npz")
    with hold_alone(folder / "m.npz", [folder / "m.npz"]):
        assert occmap("build a.csv --resume m.npz -o n.npz").code == 0
