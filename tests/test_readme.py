"""The README is true: its commands print what it shows, its code runs."""

import json
import os
import re
import shlex
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from ruamel.yaml import YAML

from occmap.gates.measures import BUILD, CHECK, COMPARE, DIFF, SAVED, TUNE, Measures
from occmap.pipeline import BuildOptions, build
from occmap.readers import Probe, Role, open_log
from occmap.types import Pose
from tests.samples import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
TIMES = re.compile(r"[\d.,]+(?= s\b)|[\d,]+(?= scans/s)|(?<=[a-z] )\d+\.\d\d(?=[,)])")
"""Seconds and scans a second, which differ from run to run."""


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def without_times(text: str) -> list[str]:
    return [
        TIMES.sub("#", line) if line.startswith("time ") else line for line in text.splitlines()
    ]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that looks like the project's root to a command."""
    (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("block", blocks("console"))
def test_commands_print_what_the_readme_shows(block: str, folder: Path) -> None:
    command, _, expected = block.removeprefix("$ ").partition("\n")
    words = shlex.split(command)
    assert words[0] == "occmap"
    if "map.npz" in words:
        build([Path("sample_logs/drive.mcap")], BuildOptions(), [Path("map.npz")])
    done = subprocess.run(
        [sys.executable, "-m", "occmap", *words[1:]],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
    )
    assert without_times(done.stdout) == without_times(expected)
    assert done.stderr == ""


def test_the_picture_on_top_is_what_the_first_command_makes(folder: Path) -> None:
    build([Path("sample_logs/drive.mcap")], BuildOptions(), [Path("map.png")])
    shown, made = (
        Image.open(path) for path in (ROOT / "sample_logs" / "map.png", folder / "map.png")
    )
    assert np.array_equal(np.asarray(shown), np.asarray(made))


def test_the_csv_in_the_readme_is_one(tmp_path: Path) -> None:
    (rows,) = re.findall(r"(?:^    [#\w].*\n)*^    stamp,.*\n(?:^    .*\n)+", README, re.MULTILINE)
    path = tmp_path / "log.csv"
    path.write_text(textwrap.dedent(rows))
    first, second = open_log(path).scans(["scan"])
    assert (first.stamp_ns, second.stamp_ns) == (12_000_000_000, 12_050_000_000)
    assert first.angle_min + 4 * first.angle_increment == pytest.approx(np.pi / 2, abs=1e-3)
    assert second.pose == Pose.planar(0.02, 0, 0.004)
    np.testing.assert_array_equal(
        second.ranges, np.array([1.51, np.nan, 7.88, np.inf, 1.49], np.float32)
    )


@pytest.mark.usefixtures("folder")
def test_library_use_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = (block for block in blocks("python") if "build_map" in block)
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["grid"].resolution == 0.1
    assert names["grid"].probability.shape == names["grid"].observed.shape
    assert len(capsys.readouterr().out.splitlines()) == 414


def test_the_reader_in_the_readme_reads(tmp_path: Path) -> None:
    (code,) = (block for block in blocks("python") if "LineReader" in block)
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 25
    names: dict[str, Any] = {}
    exec(code, names)
    path = tmp_path / "drive.lines"
    path.write_text("#lines\n1.5 2 3 0 1 2 3\n2.5 2 3 0 4 5 6\n")
    reader = names["LineReader"]()
    assert reader.recognises(Probe(path, path.read_bytes(), path.read_bytes()))
    log = reader.open(path)
    assert [(stream.count, stream.role) for stream in log.streams] == [(2, Role.SCAN)]
    scans = list(log.scans(["scan"]))
    assert [scan.stamp_ns for scan in scans] == [1_500_000_000, 2_500_000_000]
    assert scans[1].ranges.tolist() == [4, 5, 6]
    assert scans[0].pose == (2, 3, 0, 0, 0, 0, 1)
    assert scans[0].angle_increment == pytest.approx(np.pi / 2)


def test_the_reader_in_the_readme_is_a_plugin_once_it_is_packaged(tmp_path: Path) -> None:
    (code,) = (block for block in blocks("python") if "LineReader" in block)
    (section,) = re.findall(r"^    \[project\.entry-points.*\n    .*\n", README, re.MULTILINE)
    groups = tomllib.loads(textwrap.dedent(section))["project"]["entry-points"]
    package = tmp_path / "my_package"
    installed = tmp_path / "my_package-1.0.dist-info"
    for folder in (package, installed):
        folder.mkdir()
    (package / "my_module.py").write_text(code)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(
        "".join(
            f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in entries.items())
            for group, entries in groups.items()
        )
    )
    rows = [f"{1.5 + i} {0.1 * i} 3 0 1 2 3 2 1" for i in range(5)]
    (tmp_path / "drive.lines").write_text("\n".join(["#lines", *rows, ""]))

    def run(*words: str) -> dict[str, Any]:
        done = subprocess.run(
            [sys.executable, "-m", "occmap", *words, "--json"],
            capture_output=True, text=True, check=True, cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
        )  # fmt: skip
        result: dict[str, Any] = json.loads(done.stdout)
        return result

    (found,) = run("check", "drive.lines")["logs"]
    assert [(topic["topic"], topic["scans"]) for topic in found["scans"]] == [("scan", 5)]
    assert found["scans"][0]["poses"]["posed"] == 5
    built = run("build", "drive.lines", "-o", "map.pgm", "--stamps", "record")
    assert built["scans"]["used"] == 5
    assert (tmp_path / "map.pgm").exists()


def test_the_steps_of_the_ci_job_run(folder: Path) -> None:
    (job,) = blocks("yaml")
    steps = YAML(typ="safe").load(job)["jobs"]["map"]["steps"]
    script = [step["run"] for step in steps if step.get("run", "").startswith("occmap ")]
    assert len(script) == 3
    (folder / "logs").symlink_to(ROOT / "sample_logs")
    (folder / "reference").mkdir()
    build([folder / "logs" / "drive.csv"], BuildOptions(), [folder / "reference" / "map.pgm"])
    head = f'set -e; occmap() {{ "{sys.executable}" -m occmap "$@"; }}'
    done = subprocess.run(
        ["bash", "-c", "\n".join([head, *script])],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
    )
    assert (done.returncode, done.stderr) == (0, "")
    for name in ("check", "build", "diff"):
        assert json.loads((folder / f"{name}.json").read_text())["failed"] == []


def test_every_limit_is_in_the_table_with_its_unit_and_commands() -> None:
    rows = re.findall(r"^\| (`[a-z_`, ]+`) \| ([a-z0-9%]*) ?\| ([a-z, ]+) \|", README, re.MULTILINE)
    shown = {
        (name, unit, command)
        for names, unit, commands in rows
        for name in re.findall(r"[a-z_]+", names)
        for command in commands.split(", ")
    }
    tables: dict[str, Measures] = {"build": BUILD, "render": SAVED, "merge": SAVED}
    tables |= {"check": CHECK, "compare": COMPARE, "diff": DIFF, "tune": TUNE}
    assert shown == {
        (measure.name, measure.unit, command)
        for command, measures in tables.items()
        for measure in measures
    }


def test_every_option_that_the_readme_names_exists() -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "occmap", "build", "--help"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    section = README.partition("\n## Options\n")[2].partition("\n## ")[0]
    assert "--resolution" in section
    for option in re.findall(r"--[a-z][a-z-]+", section):
        assert option in shown
