"""The pages are true: their commands print what they show, their code runs, their links lead on."""

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from ruamel.yaml import YAML

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import open_log
from occmap.report.limits import BUILD, CHECK, COMPARE, DIFF, SAVED, SCORE, TUNE, Measures
from occmap.types import Pose
from tests.cli.runner import spawn
from tests.documents import PAGES, Session, list_blocks, list_steps, matches, read_page
from tests.samples import ROOT

FROM_RECORDINGS = {"walls.png"}
"""Pictures of logs that do not belong to the project; all others are made by their page."""
COMMANDS = ("build", "check", "compare", "diff", "explain", "merge", "render", "score", "tune")
LONGEST = 9_000
"""Bytes of the README, which a newcomer reads in three minutes"""
TEXTS = (*PAGES, "CONTRIBUTING.md", "CHANGELOG.md")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that looks like the project's root to a command."""
    (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", PAGES)
def test_commands_do_what_the_page_shows(page: str, folder: Path) -> None:
    session = Session(folder)
    for block in list_blocks(page, "console", "sh"):
        for step in list_steps(block):
            printed = session.run(step.command)
            if step.expected is None:
                assert session.code == 0, f"{step.command}\n{printed}"
            else:
                assert matches(printed, step.expected), f"{step.command}\n{printed}"
    pictures = set(re.findall(r"\]\(pictures/(.*?)\)", read_page(page)))
    for name in pictures - FROM_RECORDINGS:
        shown, made = (
            np.asarray(Image.open(each / name)) for each in (ROOT / "docs" / "pictures", folder)
        )
        assert np.array_equal(shown, made), name


@pytest.mark.parametrize("page", PAGES)
def test_no_block_is_left_out_for_its_mark(page: str) -> None:
    text = read_page(page)
    blocks = list_blocks(page, "console", "sh", "python", "csv", "toml", "yaml")
    assert text.count("```") == 2 * len(blocks)
    for block in blocks:
        if block.language == "console":
            assert block.code.startswith("$ ")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("page", PAGES)
def test_python_runs(page: str) -> None:
    names: dict[str, Any] = {}
    for block in list_blocks(page, "python"):
        exec(block.code, names)
    if page == "README.md":
        assert names["grid"].resolution == 0.1
        assert names["grid"].probability.shape == names["grid"].observed.shape


def test_what_the_page_about_python_shows_is_typed(tmp_path: Path) -> None:
    shown = tmp_path / "shown.py"
    shown.write_text("\n".join(block.code for block in list_blocks("docs/python.md", "python")))
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", shown], cwd=ROOT,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert checked.returncode == 0, checked.stdout


@pytest.mark.parametrize("page", TEXTS)
def test_links_lead_somewhere(page: str) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", read_page(page)):
        path, _, anchor = target.partition("#")
        if path.startswith("https:"):
            continue
        place = (ROOT / page).parent / path if path else ROOT / page
        assert place.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)$", place.read_text(encoding="utf-8"), re.MULTILINE)
            marks = [re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles]
            assert anchor in marks, target


@pytest.mark.parametrize("page", TEXTS)
def test_modules_and_files_that_a_page_names_exist(page: str) -> None:
    text = read_page(page)
    for module in re.findall(r"python -m ([\w.]*\w)", text):
        assert find_spec(module), module
    for path in re.findall(r"`((?:occmap|tests)/[a-z_/]+|[\w/]+\.(?:py|cpp))`", text):
        places = (ROOT, *ROOT.glob("occmap/**/"), *ROOT.glob("tests/**/"))
        assert any((place / path).exists() for place in places), path
    if page == "docs/architecture.md":
        names = re.findall(r"`([a-z.]+)\.(?!py\b|toml\b)(\w+)`", text)
        assert len(names) > 5
        for module, name in names:
            assert hasattr(import_module(f"occmap.{module}"), name), f"{module}.{name}"


def test_every_option_that_a_page_names_exists(tmp_path: Path) -> None:
    session = Session(tmp_path)
    lines = [f"occmap {command} --help" for command in COMMANDS]
    helps = "".join(map(session.run, [*lines, "occmap build --help-all"]))
    listed = set(re.findall(r"--[a-z][a-z-]+", helps))
    text = "".join(map(read_page, PAGES))
    commands = re.findall(r"occmap (?:build|check|compare|diff|explain|merge|render) .*", text)
    named = {*re.findall(r"--[a-z][a-z-]+", "\n".join(commands))}
    named |= {*re.findall(r"`(--[a-z][a-z-]+)", text)}
    assert len(named) > 30
    assert named <= listed


def test_the_csv_of_the_page_on_formats_is_one(tmp_path: Path) -> None:
    (rows,) = list_blocks("docs/formats.md", "csv")
    path = tmp_path / "log.csv"
    path.write_text(rows.code)
    first, second = open_log(path).scans(["scan"])
    assert (first.stamp_ns, second.stamp_ns) == (12_000_000_000, 12_050_000_000)
    assert first.angle_min + 4 * first.angle_increment == pytest.approx(np.pi / 2, abs=1e-3)
    assert second.pose == Pose.planar(0.02, 0, 0.004)
    np.testing.assert_array_equal(
        second.ranges, np.array([1.51, np.nan, 7.88, np.inf, 1.49], np.float32)
    )


def find_plugin(name: str) -> str:
    blocks = list_blocks("docs/plugins.md", "python")
    (code,) = (block.code for block in blocks if name in block.code)
    return code


def test_the_plugins_of_the_page_work_once_they_are_packaged(tmp_path: Path) -> None:
    plugins = list(map(find_plugin, ("LineReader", "HarshModel", "TextWriter")))
    assert sum(bool(line.strip()) for line in plugins[0].splitlines()) <= 25
    (section,) = list_blocks("docs/plugins.md", "toml")
    groups = tomllib.loads(section.code)["project"]["entry-points"]
    assert set(groups) == {"occmap.readers", "occmap.models", "occmap.writers"}
    package, installed = tmp_path / "my_package", tmp_path / "my_package-1.0.dist-info"
    package.mkdir()
    installed.mkdir()
    (package / "my_module.py").write_text("\n".join(plugins))
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    points = "".join(
        f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in entries.items())
        for group, entries in groups.items()
    )
    (installed / "entry_points.txt").write_text(points)
    rows = [f"{1.5 + i} {0.1 * i} 3 0 1 2 3 2 1" for i in range(5)]
    (tmp_path / "drive.lines").write_text("\n".join(["#lines", *rows, ""]))

    def run(*words: str) -> Any:
        path = os.environ | {"PYTHONPATH": str(tmp_path)}
        return json.loads(spawn(*words, "--json", cwd=tmp_path, env=path).stdout)

    (found,) = run("check", "drive.lines")["logs"]
    (topic,) = found["scans"]
    assert (topic["topic"], topic["scans"], topic["poses"]["posed"]) == ("scan", 5, 5)
    assert (topic["times"]["start_ns"], topic["times"]["end_ns"]) == (1_500_000_000, 5_500_000_000)
    assert (topic["ranges"]["smallest"], topic["ranges"]["largest"]) == (1, 3)
    assert topic["shapes"][0]["angle_increment"] == pytest.approx(np.pi / 4)
    built = run("build", "drive.lines", "-o", "map.txt", "--model", "harsh", "--stamps", "record")
    assert built["scans"]["used"] == 5
    text = (tmp_path / "map.txt").read_text()
    assert set(text) == set("#. \n")
    assert len(text.splitlines()) == built["map"]["rows"]


def test_the_steps_of_the_ci_job_run(folder: Path) -> None:
    (job,) = (each for each in list_blocks("docs/pipelines.md", "yaml") if "jobs:" in each.code)
    steps = YAML(typ="safe").load(job.code)["jobs"]["map"]["steps"]
    script = [step["run"] for step in steps if step.get("run", "").startswith("occmap ")]
    assert len(script) == 3
    (folder / "logs").symlink_to(ROOT / "sample_logs")
    (folder / "reference").mkdir()
    build([folder / "logs" / "drive.csv"], BuildOptions(), [folder / "reference" / "map.pgm"])
    session = Session(folder)
    assert [(session.run(line), session.code) for line in script] == [("", 0)] * 3
    for name in ("check", "build", "diff"):
        assert json.loads((folder / f"{name}.json").read_text())["failed"] == []


def test_every_limit_is_in_the_table_with_its_unit_and_commands() -> None:
    rows = re.findall(
        r"^\| (`[a-z0-9_`, ]+`) \| ([a-z0-9%]*) ?\| ([a-z, ]+) \|",
        read_page("docs/pipelines.md"),
        re.MULTILINE,
    )
    shown = {
        (name, unit, command)
        for names, unit, commands in rows
        for name in re.findall(r"[a-z0-9_]+", names)
        for command in commands.split(", ")
    }
    tables: dict[str, Measures] = {"build": BUILD, "render": SAVED, "merge": SAVED}
    tables |= {"check": CHECK, "compare": COMPARE, "diff": DIFF, "score": SCORE, "tune": TUNE}
    assert shown == {
        (measure.name, measure.unit, command)
        for command, measures in tables.items()
        for measure in measures
    }


def find_section(title: str) -> str:
    return read_page("README.md").partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def test_the_picture_on_top_of_the_readme_is_what_a_bare_build_makes(tmp_path: Path) -> None:
    build([ROOT / "sample_logs" / "drive.mcap"], BuildOptions(), [tmp_path / "map.png"])
    shown, made = (Image.open(each / "map.png") for each in (ROOT / "sample_logs", tmp_path))
    assert np.array_equal(np.asarray(shown), np.asarray(made))


def test_the_readme_is_short_and_shows_ten_options_of_the_usual_help(tmp_path: Path) -> None:
    assert (ROOT / "README.md").stat().st_size <= LONGEST
    rows = re.findall(r"^\| `(--?[a-z-]+)", find_section("Options"), re.MULTILINE)
    assert len(rows) == 10
    listed = Session(tmp_path).run("occmap build --help")
    for option in rows:
        assert re.search(rf"(?<![\w-]){option}\b", listed), option


@pytest.mark.parametrize("page", [*PAGES[1:], "CONTRIBUTING.md", "CHANGELOG.md"])
def test_the_readme_leads_to_every_page(page: str) -> None:
    assert f"]({page})" in find_section("Read on")
