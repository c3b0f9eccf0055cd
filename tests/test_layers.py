"""The layers keep apart: read from the imports of every module, and from what a process loads."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.samples import ROOT, SAMPLE_LOGS

PACKAGE = ROOT / "occmap"
DRIVE = SAMPLE_LOGS / "drive.csv"
MODULES = sorted(PACKAGE.rglob("*.py"))

LAYERS = ("readers", "posing", "sensor", "grid", "writers")
SHARED = {"cells", "choices", "errors", "jit", "plugins", "report", "types", "values"}
OWNERS = {
    "click": {"cli"},
    "tqdm": {"cli"},
    "rosbags": {"readers", "writers"},
    "mcap": {"readers", "writers"},
    "apsw": {"readers"},
    "PIL": {"readers", "writers"},
    "llvmlite": {"jit"},
    "numba": {"jit"},
    "rasterio": {"writers"},
    "zarr": {"store"},
    "distributed": {"fleet"},
    "bokeh": {"page"},
    "jinja2": {"page"},
}
"""Who alone may import a package."""

LIBRARIES = {"rosbags", "mcap", "PIL"}
RARE = {*LIBRARIES, "numba", "tqdm"}
HEAVY = {
    *("numpy", "numba", "llvmlite", "rosbags", "mcap", "PIL", "tqdm", "zarr", "distributed"),
    "importlib.metadata",
}
BUILD_COMMAND = {f"occmap.cli.{name}" for name in ("build", "console", "declaring", "options")}


def name_module(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


@cache
def list_imports(path: Path) -> tuple[str, ...]:
    """Name all that a module imports, within functions and for type checkers, too."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names += (f"{node.module}.{alias.name}" for alias in node.names)
    return tuple(names)


def find_layer(module: str) -> str:
    """Name the part of occmap that a module is in; "" for anything else.

    `report` and each of its modules is a part of its own: results know what made them, while all
    may use the words.
    """
    parts = module.split(".")
    if ".".join(parts[:3]) in {"occmap.report.limits", "occmap.report.results"}:
        return ".".join(parts[1:3])
    return parts[1] if parts[0] == "occmap" and len(parts) > 1 else ""


def find_met(path: Path) -> set[str]:
    """Name the parts of occmap that a module imports from, without its own."""
    return {find_layer(name) for name in list_imports(path)} - {find_layer(name_module(path)), ""}


def list_modules(*layers: str) -> list[Path]:
    return [path for path in MODULES if find_layer(name_module(path)) in layers]


@pytest.mark.parametrize("path", list_modules(*LAYERS), ids=name_module)
def test_layers_do_not_know_each_other(path: Path) -> None:
    assert find_met(path) <= SHARED


@pytest.mark.parametrize("name", sorted(SHARED))
def test_what_all_share_knows_only_what_all_share(name: str) -> None:
    paths = list_modules(name)
    assert paths
    assert all(find_met(path) <= SHARED for path in paths)


CONTAINERS = {"bag1", "containers", "records", "sqlite"}


@pytest.mark.parametrize("name", sorted(CONTAINERS))
def test_containers_know_nothing_of_what_messages_mean(name: str) -> None:
    names = list_imports(PACKAGE / "readers" / f"{name}.py")
    met = {name.split(".")[2] for name in names if name.startswith("occmap.readers.")}
    assert met <= {*CONTAINERS, "NoteList"}


def test_no_two_parts_know_each_other_in_a_circle() -> None:
    known: dict[str, set[str]] = defaultdict(set)
    for path in MODULES:
        known[find_layer(name_module(path))] |= find_met(path)
    known.pop("")  # the package itself hands on names of the API, and all may ask for its version
    TopologicalSorter(known).prepare()  # raises CycleError with the circle


def test_nothing_knows_the_command_line() -> None:
    knowing = {name_module(path) for path in MODULES if "cli" in find_met(path)}
    assert knowing == {"occmap.__main__"}


FLAG = re.compile(r"(?<![\w-])(--[a-z]+(-[a-z]+)*|-o)(?![\w>-])")


def list_texts(path: Path) -> Iterator[str]:
    """All texts of a module, docstrings, too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_only_the_command_line_spells_flags() -> None:
    others = [path for path in MODULES if find_layer(name_module(path)) not in {"cli", "options"}]
    assert not [
        (name_module(path), text)
        for path in others
        for text in list_texts(path)
        if FLAG.search(text)
    ]
    assert any(FLAG.search(text) for text in list_texts(PACKAGE / "cli" / "options.py"))


@pytest.mark.parametrize("package", OWNERS)
def test_a_package_has_its_owners(package: str) -> None:
    importing = {
        find_layer(name_module(path))
        for path in MODULES
        if any(name.split(".")[0] == package for name in list_imports(path))
    }
    assert importing == OWNERS[package]


def test_what_is_imported_is_named_as_a_dependency_and_nothing_else() -> None:
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    chosen = ("foxglove", "dask", "geotiff", "report")
    lines = [*project["dependencies"], *(line for name in chosen for line in extras[name])]
    named = {line.partition(">=")[0] for line in lines}
    imported = {name.split(".")[0] for path in MODULES for name in list_imports(path)}
    foreign = imported - sys.stdlib_module_names - {"occmap", "_typeshed"}
    # A namespace such as google is shared by several packages.
    known = packages_distributions()
    owners = [{name.lower() for name in known[each]} for each in foreign]
    assert all(names & named for names in owners)
    assert not named - set().union(*owners)


def test_the_walk_sees_the_imports() -> None:
    build = {met for path in list_modules("pipeline", "scans") for met in find_met(path)}
    assert set(LAYERS) <= build
    assert "tqdm.tqdm" in set(list_imports(PACKAGE / "cli" / "console.py"))


def list_loaded(code: str) -> set[str]:
    """Name the modules that a process has loaded after running some code."""
    script = f"{code}\nimport json, sys; print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=300
    )
    return set(json.loads(done.stderr.splitlines()[-1]))


def call(*words: object) -> str:
    return f"from occmap.cli import run; assert run({[*map(str, words)]}) == 0"


def list_loaded_by(*words: object) -> set[str]:
    """Name the modules that a process has loaded after a command."""
    return list_loaded(call(*words))


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        (call("--help"), HEAVY),
        (call(), HEAVY),
        ("import occmap; assert 'build_map' in dir(occmap)", HEAVY),
        (call("build", "--help"), RARE),
        (call("models"), RARE),
        (f"import occmap; assert occmap.read_log({str(DRIVE)!r}).streams", LIBRARIES),
    ],
)
def test_nothing_is_loaded_before_it_is_needed(code: str, absent: set[str]) -> None:
    assert list_loaded(code).isdisjoint(absent)


def test_saved_evidence_needs_no_engine_and_to_be_rendered_little_of_numpy(tmp_path: Path) -> None:
    saved, target = tmp_path / "m.npz", tmp_path / "m.pgm"
    build([DRIVE], BuildOptions(), [saved])
    assert list_loaded_by("merge", saved, saved, "-o", target).isdisjoint(RARE)
    # Masked arrays take a tenth of a render.
    assert list_loaded_by("render", saved, "-o", target).isdisjoint({*RARE, "numpy.ma"})


@pytest.mark.parametrize("update", ["beam", "polygon"])
def test_a_build_loads_what_it_needs_and_no_more(update: str, tmp_path: Path) -> None:
    log = SAMPLE_LOGS / "drive.log"
    loaded = list_loaded_by("build", update, log, "-o", tmp_path / "m.pgm")
    assert loaded.isdisjoint({*LIBRARIES, "tqdm", "ruamel", "jsonschema"})
    others = {"difference", "explanation", "inspection", "scoring"}
    assert {f"occmap.{name}" for name in others} <= set(map(name_module, MODULES)) - loaded
    assert {name for name in loaded if name.startswith("occmap.cli.")} <= BUILD_COMMAND


def list_needed(path: Path) -> set[str]:
    """Name the modules of occmap that an import of this one runs before it is whole."""
    names = {name_module(each) for each in MODULES}
    needed = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            found = {f"{node.module}.{alias.name}" for alias in node.names} & names
            needed |= found or {node.module or ""} & names
    parents = {name.rpartition(".")[0] for name in needed}
    own = name_module(path)
    return needed | {each for each in parents & names if not own.startswith(each)}


def test_every_module_can_be_the_first_that_is_imported() -> None:
    needed = {name_module(path): list_needed(path) for path in MODULES}
    assert len(needed["occmap.pipeline"]) > 10
    TopologicalSorter(needed).prepare()  # raises CycleError with the circle
