"""The command table: its help agrees with the commands, and errors become exit codes."""

from importlib.metadata import version

import pytest

from occmap import cli
from occmap.cli import COMMANDS, lists
from occmap.errors import LogError, OccmapError, UsageError
from occmap.options import DEFAULT_UPDATE
from tests.cli.runner import find_command, occmap, read_error


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_says_what_the_command_says(name: str) -> None:
    command = find_command(name)
    assert command.name == name
    assert (command.help or "").partition("\n")[0] == COMMANDS[name][1]
    (help_line,) = [line for line in occmap("--help").out.splitlines() if f"  {name} " in line]
    assert help_line.split() == [name, *COMMANDS[name][1].split()]


def test_no_word_and_help_are_the_same() -> None:
    assert occmap() == occmap("--help") == occmap("-h")
    assert occmap().code == 0
    assert "Exit codes: 0 done, 1 the log" in occmap().out


def test_version() -> None:
    assert occmap("--version").out == f"occmap {version('occmap')}\n"


def fail_with(error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(lists, "load_plugins", fail)


@pytest.mark.parametrize(
    ("error", "code", "found"),
    [
        (OccmapError("found\nthis"), 1, "found this"),
        (LogError("found", where="a.log:3", fix="do that"), 1, "a.log:3: found; do that"),
        (UsageError("found", where="-r x", fix="do that"), 2, "-r x: found; do that"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "out of memory; try a coarser --resolution"),
        (OSError(36, "File name too long", "aaa"), 1, "aaa: File name too long"),
        (OSError("no number"), 1, "OSError"),
    ],
)
def test_each_error_is_one_line_and_an_exit_code(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, found: str
) -> None:
    fail_with(error, monkeypatch)
    assert read_error(occmap("readers"), code).startswith(found)


def test_a_program_that_waits_for_json_gets_the_error_in_its_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fail_with(LogError("found\nthis", where="a.log:3", fix="do that"), monkeypatch)
    told = occmap("readers", "--json")
    assert (told.code, told.err) == (1, "error: a.log:3: found this; do that\n")
    parts = {"exit_code": 1, "where": "a.log:3", "found": "found this", "fix": "do that"}
    assert told.json == {"schema": "occmap/error/1", "error": parts}


@pytest.mark.parametrize("words", [["--json", "--jsn"], ["extra", "--json"]])
def test_wrong_usage_is_json_too_wherever_json_is_asked_for(words: list[str]) -> None:
    error = occmap("readers", *words).json["error"]
    assert (error["exit_code"], error["fix"]) == (2, "see `occmap readers --help`")


def test_a_fault_of_occmap_is_one_line_and_with_v_a_traceback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fail_with(KeyError("oh\nno"), monkeypatch)
    line = read_error(occmap("readers"), 1)
    assert line.startswith("KeyError: 'oh\\nno' (at occmap/cli/lists.py:")
    assert "please report it" in line
    told = occmap("readers", "-v")
    assert told.code == 1
    assert told.err.startswith("Traceback (most recent call last):")
    assert told.err.splitlines()[-1] == f"error: {line}"


def test_no_error_leaves_run(monkeypatch: pytest.MonkeyPatch) -> None:
    fail_with(BrokenPipeError(), monkeypatch)
    silenced: list[bool] = []
    monkeypatch.setattr(cli, "discard", lambda _stream: silenced.append(True))
    assert occmap("readers") == (0, "", "")
    assert silenced == [True]


def test_the_help_of_build_names_the_default_update() -> None:
    assert f"Without it: {DEFAULT_UPDATE}." in " ".join((find_command("build").help or "").split())
