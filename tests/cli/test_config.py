"""Options that a team repeats stand in a file beside the logs, or in one that is named."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.cli.runner import ask, occmap, read_error
from tests.samples import SAMPLE_LOGS


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return Path(shutil.copy(SAMPLE_LOGS / "drive.csv", tmp_path / "drive.csv"))


def write(log: Path, text: str, name: str = "occmap.toml") -> Path:
    path = log.parent / name
    path.write_text(text)
    return path


def map_of(log: Path, *words: object) -> Any:
    return ask("build", log, "-o", log.parent / "m.pgm", *words)


TYPED = [
    *("-r", 0.1, "--max-range", 5, "--ignore-sector", "2.5,-2.5", "--ignore-sector", "1,1.2"),
    *("--footprint", "-0.4,-0.3,0.2,0.3", "--no-return", "clear", "--stride", 3),
]
FILE = """
resolution = 0.1
max-range = 5
ignore-sector = [[2.5, -2.5], "1,1.2"]
footprint = [-0.4, -0.3, 0.2, 0.3]
no-return = "clear"
stride = 3
"""


def test_a_file_says_what_might_be_typed(log: Path) -> None:
    typed = map_of(log, *TYPED)
    cells = (log.parent / "m.pgm").read_bytes()
    path = write(log, FILE)
    read = map_of(log)
    assert read["map"] == typed["map"]
    assert (log.parent / "m.pgm").read_bytes() == cells
    assert read["notes"][0].startswith(
        f"{path}: resolution = 0.1, max-range = 5, ignore-sector = [[2.5, "
    )


def test_what_is_kept_of_a_build_holds_the_options_of_the_file(log: Path) -> None:
    write(log, FILE)
    assert occmap("build", log, "-o", log.parent / "m.npz").code == 0
    told = ask("render", log.parent / "m.npz", "-o", log.parent / "m.pgm")
    assert told["map"]["resolution"] == 0.1
    assert told["scans"]["dropped"]["left out by --stride"] > 0
    command = ask("check", log)["command"]
    assert command[command.index("--max-range") + 1] == "5"


def test_a_named_file_goes_before_the_one_beside_the_logs_and_a_typed_value_before_both(
    log: Path,
) -> None:
    write(log, "resolution = 0.1")
    other = write(log, "resolution = 0.2", "other.toml")
    for words, resolution in (((), 0.1), (("--config", other), 0.2), (("-r", 0.4), 0.4)):
        assert map_of(log, *words)["map"]["resolution"] == resolution


def test_flags_and_options_of_one_command(log: Path) -> None:
    build = "[build]\nlight-occupied = true\nstrict = false\n"
    write(log, f'stride = 3\n{build}[check]\nfail-if = "warnings > 0"\n')
    image, typed = log.parent / "m.png", log.parent / "typed.png"
    assert occmap("build", log, "-o", image).code == 0
    (log.parent / "occmap.toml").unlink()
    assert occmap("build", log, "-o", typed, "--light-occupied", "--stride", 3).code == 0
    assert image.read_bytes() == typed.read_bytes()
    write(log, '[check]\nfail-if = ["topics == 1", "scans_read > 5"]\n')
    assert occmap("check", log).code == 3
    assert occmap("build", log, "-o", image).code == 0


def test_options_of_other_commands_are_passed_over(log: Path) -> None:
    path = write(log, "hit-offset = 0.25\n")
    told = occmap("check", log)
    assert told == (0, told.out, f"note: {path}: no option of this command\n")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("resoluton = 0.1", "no option is called 'resoluton'; did you mean 'resolution'?"),
        ("quiet = true", "no option is called 'quiet'"),  # only the terminal knows it
        ("max_range = 5", "no option is called 'max_range'; did you mean 'max-range'?"),
        ("[buidl]\nstride = 2", "[buidl]: no command is called 'buidl'; did you mean 'build'?"),
        ("extent = [0, 0, 1]", "--extent [0, 0, 1]: 3 values where 4 belong"),
        ("fail-if = 'unknown > 5'", "5 is not a share below 1; write 5% or 0.05"),
        ("[check]\nstrid = 2", "no option is called 'strid'; did you mean 'stride'?"),
        ("align = true", "--align is True; give a number, or "),
        ("footprint = 3", "--footprint is 3; give x_min,y_min"),
        ("static-tf = [3]", "--static-tf [3]: 0 values where 6 belong"),
        ('resolution = "x"', "--resolution is 'x'; give a number"),
        ("resolution = true", "--resolution is True; give a number"),
        ("resolution = [0.1]", "--resolution is [0.1]; give a number"),
        ("max-cells = true", "--max-cells is True; give a whole number"),
        ("model = 3", "--model is 3; give text"),
        ("p-hit = [0.8]", "--p-hit is [0.8]; give a number"),
        ("scan-topic = [['a']]", "--scan-topic is ['a']; give a list, each item text"),
        ("fail-if = 3", "--fail-if is 3; give a limit such as"),
        ("start = 2020-01-01", "--start is datetime.date(2020, 1, 1); give a number"),
        ("[build.start]", "--start is {}; give a number"),
        ("stride = inf", "--stride is inf; give a whole number"),
        ("jobs = 1.5", "--jobs is 1.5; give a whole number"),
        ("strict = 'no'", "--strict: is 'no'; write true or false"),
        ("light-occupied = 1", "--light-occupied: is 1; write true or false"),
        ('deskew = "of"', '--deskew is \'of\'; give "auto" or "on" or "off"'),
        (r'poses = "a\u0000b"', r"--poses is 'a\x00b'; give text"),
        ("stride = [", "is not TOML ("),
    ],
)
def test_a_wrong_file_is_one_line(log: Path, text: str, found: str) -> None:
    path = write(log, text)
    error = read_error(occmap("build", log, "-o", log.parent / "m.pgm"), 2)
    assert error.startswith(f"{path}: ")
    assert found in error


@pytest.mark.parametrize(
    ("command", "text", "found"),
    [("build", "resolution = 0", "resolution of 0.0 m"), ("check", "output = 'z.pgm'", "z.pgm: ")],
)
def test_a_value_that_is_refused_later_comes_after_the_file(
    log: Path, command: str, text: str, found: str
) -> None:
    path = write(log, text)
    told = occmap(command, log, *(["-o", log.parent / "m.pgm"] if command == "build" else []))
    note, error = told.err.splitlines()
    assert note.startswith(f"note: {path}: {text.split(maxsplit=1)[0]} = ")
    assert error.startswith("error: ")
    assert found in error
    assert told.code == 2


def test_only_what_takes_effect_is_told(log: Path) -> None:
    path = write(log, "resolution = 0.1\nstride = 2")
    words = ["build", log, "-o", log.parent / "m.pgm", "-r", 0.2]
    assert f"note: {path}: stride = 2\n" in occmap(*words).err
    assert f"note: {path}: all of it is typed, too\n" in occmap(*words, "--stride", 3).err


def test_what_is_typed_wrong_is_not_laid_on_the_file(log: Path) -> None:
    write(log, "resolution = 0.1\nstride = 2")
    error = read_error(occmap("build", log, "-o", log.parent / "m.pgm", "-r", "x"), 2)
    assert error.startswith("--resolution is 'x'; give a number")
    told = occmap("build", log, "-o", log.parent / "m.pgm", "-r", "0")
    assert (told.code, "error: a resolution of 0.0 m" in told.err) == (2, True)


def test_a_file_that_is_not_there_and_two_that_are(log: Path, tmp_path: Path) -> None:
    words = ["build", log, "-o", log.parent / "m.pgm"]
    error = read_error(occmap(*words, "--config", tmp_path / "none.toml"), 2)
    found = "cannot be read (No such file or directory); check the path of --config"
    assert error == f"{tmp_path / 'none.toml'}: {found}"
    path = write(log, "stride = 2")
    (tmp_path / "other").mkdir()
    other = Path(shutil.copy(log, tmp_path / "other" / "b.csv"))
    error = read_error(occmap("check", log, other), 2)
    assert f": {path}, none; " in error
    beside = write(other, "stride = 3")
    error = read_error(occmap("check", log, other), 2)
    assert f": {path}, {beside}; " in error
    assert error.endswith("with --config")
    assert occmap("check", log, other, "--config", path).code == 0


def test_an_update_is_no_log_that_lacks_a_file(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(log, "resolution = 0.1")
    (tmp_path / "elsewhere" / "beam").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "elsewhere")
    words = ["beam", log, "-o", log.parent / "m.pgm"]
    assert ask("build", *words)["map"]["resolution"] == 0.1


def test_the_logs_of_an_option_have_their_file_beside_them(log: Path) -> None:
    assert occmap("build", log, "-o", log.parent / "m.pgm").code == 0
    path = write(log, "stride = 4\n")
    told = ask("score", log.parent / "m.yaml", "--log", log)
    assert told["notes"][0] == f"{path}: stride = 4"
    assert told["by_logs"]["scans"]["used"] == 104  # of 414


def test_files_are_looked_for_beside_the_file_that_names_them(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (log.parent / "shapes.csv").write_text("occupied,box,0,0,1,1\n")
    path = write(log, 'edits = "shapes.csv"')
    monkeypatch.chdir(Path(__file__).parent)
    assert map_of(log)["notes"][0] == f'{path}: edits = "{log.parent / "shapes.csv"}"'
