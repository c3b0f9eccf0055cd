"""What commands print with --json is what the schemas say, no more and no less."""

import gzip
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from occmap.cli import COMMANDS
from occmap.cli.lists import NAMES
from tests.cli.runner import find_command, occmap
from tests.inspection_logs import Drive, write_bag
from tests.samples import DRIVES, SAMPLE_LOGS, write_csv


@cache
def load(name: str) -> dict[str, Any]:
    schema: dict[str, Any] = occmap("schema", name).json
    return schema


def validate(*words: object, code: int = 0) -> dict[str, Any]:
    """Run a command with --json, and hold what it prints against the schema that it names."""
    result = occmap(*words, "--json")
    assert result.code == code, result.err
    printed: dict[str, Any] = result.json
    name, version = printed["schema"].split("/")[1:]
    assert version == "1"
    Draft202012Validator(load(name)).validate(printed)
    return printed


def walk(schema: Any) -> Iterator[dict[str, Any]]:
    """All parts of a schema, also those of lists."""
    if isinstance(schema, dict):
        yield schema
    for part in schema.values() if isinstance(schema, dict) else schema:
        if isinstance(part, dict | list):
            yield from walk(part)


@pytest.fixture(autouse=True, scope="module")
def _logs(workplace: Path) -> None:
    """Logs that have something to tell, and evidence of two of them."""
    whole = write_csv(workplace / "a.csv", [(0, 0, 0)] * 800, [0.3, 0.5, float("nan")], 0.3)
    (workplace / "cut.csv.gz").write_bytes(gzip.compress(whole.read_bytes())[:-1000])
    write_csv(workplace / "b.csv", [(1.0, 0.0, 0.0)] * 9, [0.4, float("inf")], 0.3)
    write_bag(workplace / "room.bag", Drive(3.14159))
    (workplace / "notes.txt").write_text("hello\n")
    for line in ("a.csv -o a.npz", "b.csv -o b.npz", "a.csv -o q.npz --model quadratic"):
        assert occmap(f"build {line}").code == 0


def test_every_command_that_has_json_has_a_schema() -> None:
    commands = {name: find_command(name) for name in COMMANDS}
    having = {
        name
        for name, command in commands.items()
        if any("--json" in option.opts for option in command.params)
    }
    assert having == set(COMMANDS) - {"schema"}  # which prints nothing else
    assert set(NAMES) == having | {"error"}


@pytest.mark.parametrize("name", NAMES)
def test_a_schema_is_sound_and_strict_and_describes_every_field(name: str) -> None:
    schema = load(name)
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    for part in walk(schema):
        if part.get("type") == "object":
            assert "additionalProperties" in part
        if isinstance(fields := part.get("properties"), dict) and "type" in part:
            assert part["additionalProperties"] is False
            assert part["required"] == list(fields)
            assert all(field["description"] for field in fields.values())


@pytest.mark.parametrize("name", NAMES)
def test_numbers_have_units(name: str) -> None:
    for part in walk(load(name)):
        for each in part.get("properties", {}).values():
            kinds = each.get("type", ())
            if isinstance(each, dict) and ("number" in kinds):
                words = ("(", "hare", "How much", "error", "unit")
                assert any(word in each["description"] for word in words), each


@pytest.mark.parametrize(
    "words",
    [
        "build a.csv -o m.pgm -o m.png --start 1 --end 100 --stride 3",
        "build polygon a.csv b.csv -o m.pgm --model quadratic --max-range 0.4",
        "build cut.csv.gz b.csv b.csv -o m.pgm",
        "build b.csv --resume a.npz -o m.npz",
        "render a.npz -o m.pgm --extent 0,0,1,1 --model counting",
        "render a.npz -o m.pgm --min-passes 1",
        "merge a.npz b.npz b.npz -o m.npz",
        "merge a.npz --subtract a.npz b.npz -o m.npz",
        "check a.csv b.csv cut.csv.gz",
        "compare a.csv -o compare.png",
        "compare b.csv --model simple:p_hit=0.8 --update beam",
        "tune b.csv",
        f"tune {SAMPLE_LOGS / 'drive.mcap'} --resolution 0.1",
        "diff a.npz b.npz -o d.png",
        "diff a.npz a.npz",
        "score a.npz --log a.csv --fit",
        "score a.npz --truth b.npz --fit -o score.png",
        "explain a.npz 0.3 0",
        "explain q.npz 0.3 0 --log a.csv",
        "explain b.npz -90 -1e3 --log b.csv --model counting",
        "models",
        "readers",
        "writers",
    ],
)
def test_results_are_as_their_schemas_say(words: str) -> None:
    command, *rest = words.split()
    printed = validate(command, *rest)
    assert printed["schema"] == f"occmap/{command}/1"


@pytest.mark.parametrize("log", DRIVES, ids=lambda log: str(log.name))
def test_sample_logs_are_as_the_schema_says(log: Path) -> None:
    assert validate("check", log)["buildable"]


def test_what_cannot_be_built_is_as_the_schema_says() -> None:
    assert not validate("check", "room.bag", "notes.txt", "none.csv", code=1)["buildable"]


def test_a_limit_that_is_not_kept_is_as_the_schema_says() -> None:
    words = ["build", "b.csv", "-o", "m.pgm", "--fail-if", "hits < 60%"]
    (failed,) = validate(*words, code=3)["failed"]
    assert failed == {"name": "hits", "value": 0.5, "limit": "hits < 60%"}


@pytest.mark.parametrize(
    ("words", "code", "where"),
    [
        ("build none.csv -o m.pgm", 1, "none.csv"),
        ("build", 2, ""),
        ("build b.csv -o m.gif", 2, "m.gif"),
        ("compare b.csv --fail-if nothing>1", 2, "--fail-if 'nothing>1'"),
        ("diff a.npz", 2, ""),
        ("diff a.npz none.npz", 1, "none.npz"),
        ("check --resolution x", 2, ""),
        ("bild", 2, ""),
    ],
)
def test_errors_are_as_their_schema_says(words: str, code: int, where: str) -> None:
    printed = validate(*words.split(), code=code)
    assert printed["schema"] == "occmap/error/1"
    assert printed["error"]["exit_code"] == code
    assert printed["error"]["where"] == where


@pytest.mark.parametrize(
    "wrong",
    [
        {"model": 1},
        {"class": "odd"},
        {"probability": 1.5},
        {"probability": -0.5},
        {"unit": -1},
        {"map_extent": [0.0, 0.0, 4.0]},
        {"map_extent": [0.0, 0.0, 4.0, 5.0, 6.0]},
        {"cell": {"row": 0, "column": 6}},
        {"seen": {"hits": None}},
    ],
)
def test_what_is_not_of_the_type_is_refused(wrong: dict[str, Any]) -> None:
    right = validate("explain", "a.npz", "0.3", "0")
    assert not Draft202012Validator(load("explain")).is_valid(right | wrong)


def test_a_number_that_json_lacks_is_null() -> None:
    write_csv(Path("c.csv"), [(1.0, 0.0, 0.0)] * 5, [0.4], 0.3)  # of which one scan is held out
    (only,) = validate("compare", "c.csv", "--model", "simple", "--update", "beam")["variants"]
    assert only["share_error"] is None
