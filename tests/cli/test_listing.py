"""`occmap readers`, `models` and `writers`: what is installed, and what is broken."""

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import get_args

import pytest

from occmap import plugins
from tests.cli.runner import ask, occmap, read_error


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
