"""The command table, the lists of what is installed, and how errors become exit codes."""

from importlib.metadata import EntryPoint, version
from pathlib import Path
from typing import get_args

import pytest

from occmap import cli, plugins
from occmap.cli import COMMANDS, lists
from occmap.errors import LogError, OccmapError, UsageError
from occmap.options import DEFAULT_UPDATE
from tests.cli.runner import ask, find_command, occmap, read_error


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


@pytest.fixture
def broken_plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Install, in every group, a plugin that does not import."""
    known = {group: plugins.list_plugins(group) for group in get_args(plugins.Group)}
    for group in known:
        known[group] += (EntryPoint("sonar", "there.is.no.such:Module", group),)
    monkeypatch.setattr(plugins, "list_plugins", known.__getitem__)


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("readers", "carmen clouds csv mcap rosbag"),
        ("models", "counting quadratic simple"),
        ("writers", "csv ground.tif html keepout.pgm mcap npz pgm png tif tiles tum zarr"),
    ],
)
def test_all_that_is_installed_is_listed(command: str, names: str) -> None:
    listed = ask(command)
    assert listed["broken"] == []
    assert [plugin["name"] for plugin in listed[command]] == names.split()
    text = occmap(command).out
    for plugin in listed[command]:
        assert f"{plugin['name']} " in text
        assert plugin["description"] in text


def test_models_have_parameters_with_defaults() -> None:
    listed = ask("models")["models"]
    (simple,) = [model for model in listed if model["name"] == "simple"]
    observed = {"p_hit": 0.7, "p_miss": 0.4, "prior": 0.5, "cut": 0.5, "spread": 0.08}
    assert simple["parameters"] == observed | {"clamp_min": 0.0, "clamp_max": 1.0}
    assert "p_hit=0.7, p_miss=0.4, prior=0.5" in occmap("models").out


@pytest.mark.usefixtures("broken_plugin")
@pytest.mark.parametrize("command", ["readers", "models"])
def test_a_broken_plugin_is_named_with_its_reason(command: str) -> None:
    reason = "ModuleNotFoundError: No module named 'there'"
    result = occmap(command)
    assert result.code == 0
    assert result.out.splitlines()[-1] == f"sonar is installed but does not load: {reason}"
    listed = ask(command)
    assert listed["broken"] == [{"name": "sonar", "reason": reason}]
    assert len(listed[command]) >= 3


@pytest.mark.usefixtures("broken_plugin")
def test_a_log_that_a_broken_reader_may_know_names_the_reader(here: Path) -> None:
    (here / "x.log").write_text("hello\n")
    error = read_error(occmap("build x.log -o m.pgm"), 1)
    fix = "carmen, clouds, csv, mcap, rosbag (sonar cannot be loaded): see `occmap readers`"
    assert error.endswith(f"it starts with 'hello'; occmap reads {fix}")


def test_quiet_keeps_only_what_json_asks_for() -> None:
    assert occmap("readers", "-q").out == ""
    assert ask("readers -q")["readers"]
