"""What publishes occmap, and what others use of its repository, agrees with the project."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.inspection_logs import Drive, write_bag
from tests.samples import ROOT, SAMPLE_LOGS

HIDDEN = ROOT / ".github"
ACTION = HIDDEN / "actions" / "occmap"
needs_bash = pytest.mark.skipif(sys.platform == "win32", reason="needs bash")


def load(path: Path) -> Any:
    return YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def test_the_recipe_is_that_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = load(HIDDEN / "conda" / "recipe.yaml")
    assert recipe["context"]["version"] == project["version"]
    assert load(ROOT / "CITATION.cff")["version"] == project["version"]
    assert recipe["about"]["summary"] == project["description"]
    assert recipe["about"]["license"] == project["license"]
    wanted = [f"python {project['requires-python']}"]
    wanted += [re.sub(r"(?=>=)", " ", line) for line in project["dependencies"]]
    assert recipe["requirements"]["run"] == wanted
    (script,) = recipe["build"]["python"]["entry_points"]
    name, _, target = script.partition(" = ")
    assert project["scripts"] == {name: target}


def test_the_container_is_made_of_files_that_are_there() -> None:
    kept = (HIDDEN / "docker" / "Dockerfile.dockerignore").read_text().splitlines()
    assert kept[0] == "*"
    assert all((ROOT / line.removeprefix("!")).exists() for line in kept[1:])
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = whole["project"]
    samples = whole["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    needed = {"occmap", "pyproject.toml", project["readme"], *project["license-files"], *samples}
    assert needed == {line.removeprefix("!") for line in kept[1:]}


def test_links_of_the_page_lead_to_the_tag(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("![map](a/b.png) [docs](docs/x.md#y) [site](https://x.org) [here](#here)\n")
    home = "https://github.com/me/occmap"
    command = [sys.executable, str(HIDDEN / "links.py"), str(page), home, "v1"]
    subprocess.run(command, check=True, timeout=60)
    image, docs = f"![map]({home}/raw/v1/a/b.png)", f"[docs]({home}/blob/v1/docs/x.md#y)"
    assert page.read_text() == f"{image} {docs} [site](https://x.org) [here](#here)\n"


def act(at: Path, **inputs: str) -> subprocess.CompletedProcess[str]:
    """Do what the action does with some inputs; others are at their defaults."""
    action = load(ACTION / "action.yml")
    defaults = {name: each.get("default", "") for name, each in action["inputs"].items()}
    (step,) = (step for step in action["runs"]["steps"] if step.get("name", "").startswith("Check"))
    values = {name.replace("_", "-"): value for name, value in inputs.items()}
    given = {
        variable: {**defaults, **values}[re.findall(r"inputs\.([\w-]+)", expression)[0]]
        for variable, expression in step["env"].items()
    }
    given["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", ACTION / "run.sh"], cwd=at, env={**os.environ, **given},
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip


@needs_bash
def test_the_action_maps_a_log_and_compares_it(tmp_path: Path) -> None:
    log = str(SAMPLE_LOGS / "drive.csv")
    done = act(tmp_path, log=log, options="--resolution 0.1", fail_if="agreement < 60%\n\n")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    folder = tmp_path / "occmap-map"
    files = {"check.json", "build.json", "map.pgm", "map.yaml", "map.png", "map.npz"}
    assert {path.name for path in folder.iterdir()} == files
    assert json.loads((folder / "build.json").read_text())["map"]["resolution"] == 0.1
    given = {"log": log, "reference": "occmap-map/map.yaml"}
    again = act(tmp_path, **given, folder="fine")
    assert again.returncode == 1
    assert "build both with one --resolution" in again.stderr
    same = act(tmp_path, **given, folder="same", options="--resolution 0.1")
    assert same.returncode == 0
    assert json.loads((tmp_path / "same" / "diff.json").read_text())["changed"] == 0


@needs_bash
def test_the_action_maps_a_log_that_needs_options(tmp_path: Path) -> None:
    log = str(write_bag(tmp_path / "room.bag", Drive()))
    failed = act(tmp_path, log=log)
    assert failed.returncode == 1
    assert "--sensor-pose" in failed.stderr
    done = act(tmp_path, log=log, log_options="--sensor-pose 0,0,0", options="--model simple")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


@needs_bash
@pytest.mark.parametrize(
    ("options", "code"), [("--fail-if 'agreement < 1%'", 0), ("--fail-if 'agreement < 1%", 1)]
)
def test_quotes_keep_an_option_of_the_action_whole(tmp_path: Path, options: str, code: int) -> None:
    done = act(tmp_path, log=str(SAMPLE_LOGS / "drive.csv"), options=options)
    assert done.returncode == code, done.stderr
    assert ("unmatched single quote" in done.stderr) == bool(code)


@needs_bash
@pytest.mark.parametrize(
    "limits", [{"check_fail_if": "topics == 1"}, {"fail_if": "hits > 1%\nunknown > 1%"}]
)
def test_the_action_fails_where_a_limit_is_not_kept(tmp_path: Path, limits: dict[str, str]) -> None:
    done = act(tmp_path, log=str(SAMPLE_LOGS / "drive.csv"), **limits)
    assert done.returncode == 3
    assert "--fail-if says" in done.stderr
