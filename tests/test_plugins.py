"""Plugins that go wrong: each is named, and the blame is not put on occmap."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from string import Template

import pytest

from occmap import plugins
from tests.cli.runner import ask, occmap, read_error

PACKAGE = "made_up_plugin"
POINTS = """
[occmap.readers]
lines = made_up_plugin:Reader
csv = made_up_plugin:Reader
[occmap.models]
plain = made_up_plugin:NotModel
priorless = made_up_plugin:Priorless
odd = made_up_plugin:Model
even = made_up_plugin:Model
[occmap.writers]
txt = made_up_plugin:Writer
"""
CODE = """
import numpy as np
from dataclasses import dataclass
from occmap.readers import Log as Base, Role, Stream
from occmap.types import Pose, Scan

class Reader:
    name, description = "lines", "a log of one scan"
    def recognises(self, probe): return probe.content.startswith(b"#lines")
    def open(self, path): return $log

class Log($base):
    def __init__(self, path):
        self.path, self.notes, self.streams = path, $notes, [Stream("scan", "", 1, Role.SCAN)]
    def poses(self): return $poses
    def scans(self, topics):
        ranges, pose = np.ones(5, np.float32), Pose.planar(0, 0, 0)
        yield $scan

class NotModel: name, description = "plain", "no dataclass"

@dataclass(frozen=True)
class Priorless:
    name, description = "priorless", "no prior"
    def log_odds(self, hits, misses): return hits

@dataclass(frozen=True)
class Model(Priorless):
    name = "odd"
    prior: float = $prior
    def log_odds(self, hits, misses): return $odds

class Writer:
    description = "text"
    def targets(self, path): return $targets
    def write(self, path, grid, options): $write
"""
GOOD = {
    "log": "Log(path)",
    "base": "object",
    "poses": "iter(())",
    "notes": "[]",
    "prior": "0.5",
    "targets": "(path,)",
    "scan": 'Scan(0, "laser", -1, 0.5, ranges, 0, np.inf, pose=pose)',
    "odds": "hits - misses",
    "write": "path.touch()",
}
BAD_SCAN = 'Scan(0.5, "laser", 0, 1, np.ones(5, np.float32), 0, 9)'
POSELESS = {"scan": 'Scan(0, "laser", -1, 0.5, ranges, 0, np.inf)'}
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs the plugins beside a log, with some of their lines replaced."""

    def make(**lines: str) -> None:
        code = Template(CODE).substitute(GOOD | lines)
        (tmp_path / f"{PACKAGE}.py").write_text(code)
        info = tmp_path / f"{PACKAGE}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {PACKAGE}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(POINTS)
        (tmp_path / "a.log").write_text("#lines\n")
        plugins.list_plugins.cache_clear()

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield make
    plugins.list_plugins.cache_clear()
    sys.modules.pop(PACKAGE, None)


@pytest.mark.parametrize(
    ("command", "name", "why"),
    [
        ("models", "plain", "made_up_plugin:NotModel is no dataclass"),
        ("models", "priorless", "made_up_plugin:Priorless has no prior"),
        ("models", "even", "made_up_plugin:Model calls itself odd"),
        ("readers", "csv", "made_up_plugin:Reader has the name of another one"),
    ],
)
def test_a_plugin_that_cannot_be_used_is_named(
    install: Install, command: str, name: str, why: str
) -> None:
    install()
    listed = ask(command)
    assert [why in fault["reason"] for fault in listed["broken"] if fault["name"] == name] == [True]
    assert {"odd", "lines"} & {each["name"] for each in listed[command]}


@pytest.mark.parametrize("base", ["object", "Base"])
def test_good_ones_work_and_need_not_say_what_they_wrote(install: Install, base: str) -> None:
    install(base=base)
    assert ask("build a.log --model odd -o m.txt")["files"] == ["m.txt"]


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        ({"scan": "[][0]"}, f"{PACKAGE}.py:18); this is a fault in the plugin {PACKAGE}:"),
        ({"odds": "1 // 0"}, f"{PACKAGE}.py:31); this is a fault in the plugin {PACKAGE}:"),
        ({"write": "1 // 0"}, f"{PACKAGE}.py:36); this is a fault in the plugin {PACKAGE}:"),
        ({"log": "None"}, "a.log: the reader lines gives None, which has no path"),
        ({"log": "type('Log', (), {'path': path})()"}, "a.log: the reader lines gives Log, which"),
        ({"prior": "2"}, "the model odd has the prior 2; give one"),
        ({"scan": "{}"}, "a.log: its reader gives dict where a Scan belongs"),
        (POSELESS | {"poses": '["word"]'}, "reader gives 'word' where a PoseSample belongs"),
        (POSELESS | {"poses": BAD_SCAN}, "a.log: holds 0.5 where a time"),
        (POSELESS | {"poses": "None"}, "reader gives None where some PoseSample belongs"),
        ({"scan": BAD_SCAN}, "a.log: holds 0.5 where a time"),
        ({"odds": "np.zeros(9)"}, "the model odd gives no log-odds"),
        ({"odds": "hits * np.nan"}, "the model odd gives no log-odds"),
        ({"write": "return [path]"}, "m.txt: its writer did not write it"),
    ],
)
def test_who_is_at_fault_is_named(install: Install, lines: dict[str, str], named: str) -> None:
    install(**lines)
    result = occmap("build a.log --model odd -o m.txt")
    assert named in read_error(result, result.code)
    assert "fault in occmap" not in result.err


def test_text_is_taken_where_notes_and_paths_belong(install: Install) -> None:
    install(notes='["hello"]', targets="str(path)", write="path.touch(); return str(path)")
    made = ask("build a.log --model odd -o m.txt")
    assert made["files"] == ["m.txt"]
    assert "a.log: hello" in made["notes"]


def test_what_a_writer_does_to_the_map_spoils_no_other_output(install: Install) -> None:
    install(write="grid.log_odds[:] = 9")
    result = occmap("build a.log --model odd -o m.txt -o m.pgm")
    assert "read-only" in read_error(result, result.code)
    assert f"fault in the plugin {PACKAGE}" in result.err
    assert not Path("m.pgm").exists()


@pytest.mark.parametrize("kind", ["float32", "uint8"])
def test_masked_ranges_are_not_measured(install: Install, kind: str) -> None:
    masked = f"np.ma.masked_array(ranges, [0, 0, 0, 1, 1], {kind!r})"
    install(scan=GOOD["scan"].replace("ranges", masked))
    beams = ask("build a.log --model odd -o m.pgm")["beams"]
    assert (beams["hit"], beams["nan"]) == (3, 2)
