"""Options that a team repeats stand in a file beside the logs, or in one that is named."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.cli.runner import ask, occmap, read_error
from tests.samples import SAMPLE_LOGS

LOG, FILE_BESIDE = "site/drive.csv", "site/occmap.toml"


@pytest.fixture(autouse=True)
def _log(here: Path) -> None:
    """The log lies in a folder, and the test works beside that."""
    (here / "site").mkdir()
    shutil.copy(SAMPLE_LOGS / "drive.csv", here / "site")


def write(text: str, name: str = FILE_BESIDE) -> None:
    Path(name).write_text(text)


def make_map(words: str = "") -> Any:
    return ask(f"build {LOG} -o m.pgm {words}")


TYPED = (
    "-r 0.1 --max-range 5 --ignore-sector 2.5,-2.5 --ignore-sector 1,1.2 "
    "--footprint -0.4,-0.3,0.2,0.3 --no-return clear --stride 3"
)
FILE = """
resolution = 0.1
max-range = 5
ignore-sector = [[2.5, -2.5], "1,1.2"]
footprint = [-0.4, -0.3, 0.2, 0.3]
no-return = "clear"
stride = 3
"""


def test_a_file_says_what_might_be_typed() -> None:
    typed, cells = make_map(TYPED), Path("m.pgm").read_bytes()
    write(FILE)
    read = make_map()
    assert read["map"] == typed["map"]
    assert Path("m.pgm").read_bytes() == cells
    assert read["notes"][0].startswith(f"{FILE_BESIDE}: resolution = 0.1, max-range = 5, ignore-se")


def test_what_is_kept_of_a_build_holds_the_options_of_the_file() -> None:
    write(FILE)
    assert occmap(f"build {LOG} -o m.npz").code == 0
    told = ask("render m.npz -o m.pgm")
    assert told["map"]["resolution"] == 0.1
    assert told["scans"]["dropped"]["left out by --stride"] > 0
    command = ask(f"check {LOG}")["command"]
    assert command[command.index("--max-range") + 1] == "5"


@pytest.mark.parametrize(
    ("words", "resolution"), [("", 0.1), ("--config other.toml", 0.2), ("-r 0.4", 0.4)]
)
def test_a_named_file_goes_before_the_one_beside_the_logs_and_a_typed_value_before_both(
    words: str, resolution: float
) -> None:
    write("resolution = 0.1")
    write("resolution = 0.2", "other.toml")
    assert make_map(words)["map"]["resolution"] == resolution


def test_flags_and_options_of_one_command() -> None:
    build = "[build]\nlight-occupied = true\nstrict = false\n"
    write(f'stride = 3\n{build}[check]\nfail-if = "warnings > 0"\n')
    assert occmap(f"build {LOG} -o m.png").code == 0
    Path(FILE_BESIDE).unlink()
    assert occmap(f"build {LOG} -o typed.png --light-occupied --stride 3").code == 0
    assert Path("m.png").read_bytes() == Path("typed.png").read_bytes()
    write('[check]\nfail-if = ["topics == 1", "scans_read > 5"]\n')
    assert occmap(f"check {LOG}").code == 3
    assert occmap(f"build {LOG} -o m.png").code == 0


NOTHING = "nothing in it is for this command, or all is typed, too"


def test_no_poses_are_not_those_of_the_folder() -> None:
    Path("slam.mcap").touch()
    write('poses = ""')
    assert "error: --poses is empty" in occmap(f"build {LOG} -o m.pgm").err


def test_options_of_other_commands_are_passed_over() -> None:
    write("pass-gap = 20\n")
    told = occmap(f"check {LOG}")
    assert told == (0, told.out, f"note: {FILE_BESIDE}: {NOTHING}\n")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("resoluton = 0.1", "no option is called 'resoluton'; did you mean 'resolution'?"),
        ("quiet = true", "no option is called 'quiet'"),  # only the terminal knows it
        ("max_range = 5", "no option is called 'max_range'; did you mean 'max-range'?"),
        ("[buidl]\nstride = 2", "[buidl]: no command is called 'buidl'; did you mean 'build'?"),
        ("extent = [0, 0, 1]", "--extent [0, 0, 1]: 3 values where 4 belong"),
        ("fail-if = 'unknown > 5'", "5 is not a share; write 5% or 0.05"),
        ("align = true", "--align is True; give a number, or "),
        ("static-tf = [3]", "--static-tf [3]: 0 values where 6 belong"),
        ('resolution = "x"', "--resolution is 'x'; give a number"),
        ("model = 3", "--model is 3; give text"),
        ("scan-topic = [['a']]", "--scan-topic is ['a']; give a list, each item text"),
        ("fail-if = 3", "--fail-if is 3; give a limit such as"),
        ("start = 2020-01-01", "--start is datetime.date(2020, 1, 1); give a number"),
        ("[build.start]", "--start is {}; give a number"),
        ("strict = 'no'", "--strict: is 'no'; write true or false"),
        ("light-occupied = 1", "--light-occupied: is 1; write true or false"),
        ("stride = [", "is not TOML ("),
    ],
)
def test_a_wrong_file_is_one_line(text: str, found: str) -> None:
    write(text)
    error = read_error(occmap(f"build {LOG} -o m.pgm"), 2)
    assert error.startswith(f"{FILE_BESIDE}: ")
    assert found in error


def test_a_value_that_is_refused_later_comes_after_the_file() -> None:
    write("output = 'z.pgm'")
    told = occmap(f"check {LOG}")
    note, error = told.err.splitlines()
    assert note.startswith(f"note: {FILE_BESIDE}: output = ")
    assert error.startswith("error: z.pgm: ")
    assert told.code == 2


def test_only_what_takes_effect_is_told() -> None:
    write("\ufeffresolution = 0.1\r\nstride = 2")  # begun by a byte order mark, which says nothing
    assert make_map("-r 0.2")["notes"] == [f"{FILE_BESIDE}: stride = 2"]
    assert make_map("-r 0.2 --stride 3")["notes"] == [f"{FILE_BESIDE}: {NOTHING}"]


def test_what_is_typed_wrong_is_not_laid_on_the_file() -> None:
    write("resolution = 0.1\nstride = 2")
    error = read_error(occmap(f"build {LOG} -o m.pgm -r x"), 2)
    assert error.startswith("--resolution is 'x'; give a number")
    told = occmap(f"build {LOG} -o m.pgm -r 0")
    assert (told.code, "error: a resolution of 0.0 m" in told.err) == (2, True)


def test_a_file_that_is_not_there_and_two_that_are() -> None:
    error = read_error(occmap(f"build {LOG} -o m.pgm --config none.toml"), 2)
    assert error.startswith("none.toml: cannot be read (No such file or directory); check the path")
    write("stride = 2")
    shutil.copytree("site", "other")
    Path("other/occmap.toml").unlink()
    both = f"check {LOG} other/drive.csv"
    assert f": {FILE_BESIDE}, none; " in read_error(occmap(both), 2)
    write("stride = 3", "other/occmap.toml")
    error = read_error(occmap(both), 2)
    assert f": {FILE_BESIDE}, other/occmap.toml; " in error
    assert error.endswith("with --config")
    assert occmap(f"{both} --config {FILE_BESIDE}").code == 0


def test_an_update_is_no_log_that_lacks_a_file() -> None:
    write("resolution = 0.1")
    Path("beam").mkdir()
    assert ask(f"build beam {LOG} -o m.pgm")["map"]["resolution"] == 0.1


def test_the_logs_of_an_option_have_their_file_beside_them() -> None:
    assert occmap(f"build {LOG} -o m.pgm").code == 0
    write("stride = 4")
    told = ask(f"score m.yaml --log {LOG}")
    assert told["notes"][0] == f"{FILE_BESIDE}: stride = 4"
    assert told["by_logs"]["scans"]["used"] == 104  # of 414


def test_files_are_looked_for_beside_the_file_that_names_them() -> None:
    write("occupied,box,0,0,1,1\n", "site/shapes.csv")
    write('edits = "shapes.csv"')
    assert make_map()["notes"][0] == f'{FILE_BESIDE}: edits = "site/shapes.csv"'
