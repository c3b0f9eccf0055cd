"""`--fail-if` where something is measured: exit code 3, a line each, and the result as usual."""

import gzip
from pathlib import Path

import pytest

from occmap.report.limits import BUILD, CHECK, COMPARE, COUNT, DIFF, SAVED, Measures
from tests.cli.runner import Result, occmap, read_error
from tests.samples import PLAIN_WORDS, write_csv

COMMANDS: dict[str, tuple[list[str], Measures]] = {
    "build": ([*PLAIN_WORDS, "log.csv", "--end", "8", "-o", "m.png"], BUILD),
    "check": (["log.csv"], CHECK),
    "compare": (["log.csv", "--model", "simple"], COMPARE),
    "render": (["log.npz", "-o", "m.png"], SAVED),
    "merge": (["log.npz", "log.npz", "-o", "m.png"], SAVED),
    "diff": (["log.npz", "half.npz"], DIFF),
}
by_command = pytest.mark.parametrize(
    ("command", "words", "measures"),
    [(name, *rest) for name, rest in COMMANDS.items()],
    ids=list(COMMANDS),
)


@pytest.fixture(autouse=True, scope="module")
def _logs(workplace: Path) -> None:
    """Ten scans of a wall and of nothing, and two pieces of evidence of them."""
    write_csv(workplace / "log.csv", [(0.025, 0.025, 0.0)] * 10, [1.0, float("inf")], 0.3)
    # In the second, one miss takes a cell from a prior of 0.6 to even odds: undecided.
    for line in ("log.npz", "half.npz --end 1 --model simple:p_miss=0.5,prior=0.6,spread=0"):
        assert occmap("build", *PLAIN_WORDS, *f"log.csv -o {line}".split()).code == 0


def run(command: str, *more: str) -> Result:
    return occmap(command, *COMMANDS[command][0], *more)


@by_command
def test_all_that_is_measured_is_a_number_and_fails_where_it_is_told_to(
    command: str, words: list[str], measures: Measures
) -> None:
    limits = [word for each in measures for word in ("--fail-if", f"{each.name} >= 0")]
    low = [word for each in measures for word in ("--fail-if", f"{each.name} < 0")]
    result = occmap(command, *words, *limits, *low, "--json", "-q")
    assert result.code == 3
    found = {each["name"]: each for each in result.json["failed"]}
    assert found.keys() == {each.name for each in measures}
    assert len(result.err.splitlines()) == len(measures)
    for measure in measures:
        is_negative = measure.name == "log_likelihood"
        assert found[measure.name]["limit"].rstrip("%").endswith("< 0" if is_negative else ">= 0")
        value = found[measure.name]["value"]
        assert isinstance(value, int if measure.unit == COUNT else int | float)


@by_command
def test_names_are_in_the_help_and_wrong_ones_are_refused_before_anything_is_read(
    command: str, words: list[str], measures: Measures
) -> None:
    kept = occmap(command, *words, "--fail-if", f"{measures[0].name} < 0", "--json")
    assert (kept.code, kept.json["failed"]) == (0, [])
    gone = [word.replace("log.", "no.").replace("half.", "no.") for word in words]
    error = read_error(occmap(command, *gone, "--fail-if", "nothing > 1"), 2)
    names = ", ".join(each.name for each in measures)
    assert error.endswith(f"there are {names}")
    assert f"Names: {names}." in " ".join(occmap(command, "--help").out.split())


def measure(command: str, name: str, *more: str) -> float:
    for sign in (">=", "<"):
        result = run(command, "--fail-if", f"{name} {sign} 0", "--json", *more)
        if result.code == 3:
            return float(result.json["failed"][0]["value"])
    raise AssertionError(name)


@pytest.mark.parametrize(
    ("command", "name", "value"),
    [
        ("build", "scans_read", 10),
        ("build", "scans_used", 8),  # at 0 to 7 s
        ("build", "dropped_scans", 0),
        ("build", "hits", 0.5),
        ("build", "no_return", 0.5),
        ("build", "cells", 21),  # one row from the sensor's cell to that of the wall
        ("build", "area", 21 * 0.05**2),
        ("build", "occupied", 1 / 21),
        ("build", "free", 20 / 21),
        ("build", "unknown", 0),
        ("build", "damage", 0),
        ("render", "scans_used", 10),
        ("merge", "scans_used", 20),
        ("merge", "notes", 1),  # the log is in it twice
        ("check", "scans_read", 10),
        ("check", "topics", 1),
        ("check", "dropped_scans", 0),
        ("check", "hits", 0.5),
        ("check", "largest_gap", 1),
        ("check", "cells", 23 * 3),  # a hit half a cell behind, and the cells around it
        ("compare", "share", 1),
        ("compare", "scans_used", 10),
        ("diff", "known", 21),
        ("diff", "changed", 20 / 21),  # one scan leaves the wall occupied, and all else undecided
        ("diff", "free_to_occupied", 0),
        ("diff", "changed_cells", 20),
        ("diff", "largest_blob", 20),
    ],
)
def test_what_is_measured(command: str, name: str, value: float) -> None:
    assert measure(command, name) == pytest.approx(value)


@pytest.mark.parametrize("command", ["build", "check"])
def test_dropped_are_scans_that_are_lost_and_not_those_that_nobody_asked_for(command: str) -> None:
    astray = (float("nan"), 0.0, 0.0)
    path = [(0.025, 0.025, 0.0), astray, *[(0.025, 0.025, 0.0)] * 7, astray]
    log = write_csv(Path("astray.csv"), path, [1.0])
    words = [*(["-o", "m.png"] if command == "build" else []), "--end", "8", "--stride", "2"]
    for start, share in (("0", 0), ("1", 0.25)):  # seconds 0, 2, 4, 6; then 1, 3, 5, 7
        limit = f"dropped_scans != {share}"
        assert occmap(command, log, *words, "--start", start, "--fail-if", limit).code == 0


def test_files_and_result_come_before_the_limits() -> None:
    Path("m.png").unlink(missing_ok=True)
    result = run("build", "--fail-if", "unknown < 1%", "--fail-if", "scans_used < 100")
    assert result.code == 3
    assert Path("m.png").exists()
    assert result.out.startswith("map ")
    assert result.err.splitlines() == [
        "error: unknown is 0%, and --fail-if says < 1%",
        "error: scans_used is 8, and --fail-if says < 100",
    ]


def test_damage_weighs_more_than_a_limit_and_both_are_told(tmp_path: Path) -> None:
    whole = write_csv(tmp_path / "whole.csv", [(0.0, 0.0, 0.0)] * 3000, [0.3])
    log = tmp_path / "cut.csv.gz"
    log.write_bytes(gzip.compress(whole.read_bytes())[:-1000])
    words = ["-o", "m.png", "--strict", "--fail-if", "damage > 0", "-q"]
    limit, damage = occmap("build", log, *words).err.splitlines()
    assert limit == "error: damage is 1, and --fail-if says > 0"
    assert "(--strict)" in damage
    assert occmap("build", log, *words).code == 1
    assert occmap("check", log, "--fail-if", "damage > 0").code == 3


@pytest.mark.parametrize(
    "line", ["build day -o m.png", "check day", "compare day --update beam", "tune day"]
)
def test_a_recording_that_nothing_can_read_is_damage_to_its_folder(here: Path, line: str) -> None:
    (here / "day").mkdir()
    write_csv(here / "day" / "drive.csv", [(0.1 * step, 0.0, 0.0) for step in range(30)], [1.0])
    (here / "day" / "lost.bag").write_bytes(b"nothing")
    told = occmap(f"{line} --json --fail-if damage>0")
    assert (told.code, told.json["failed"][0]["value"]) == (3, 1)
    assert told.err.count("lost.bag: passed over") == 1
    noted = told.json["warnings" if line.startswith("check") else "damage"]
    assert noted[0].startswith("day/lost.bag: passed over, though named like a recording")
    assert line != "check day" or "lost.bag" not in str(told.json["notes"])


def test_a_log_that_cannot_be_mapped_weighs_more_than_a_limit() -> None:
    result = occmap("check", "no.csv", "--fail-if", "scans_read < 1", "--json")
    assert (result.code, len(result.json["failed"])) == (1, 1)


def test_fail_above_is_a_limit_on_what_changed() -> None:
    result = run("diff", "--fail-above", "1%", "--fail-if", "changed > 0.5", "--json")
    assert result.err.splitlines() == [
        "error: changed is 95.2%, and --fail-above says > 1%",
        "error: changed is 95.2%, and --fail-if says > 50%",
    ]
    limits = [each["limit"] for each in result.json["failed"]]
    assert limits == ["changed > 1%", "changed > 50%"]
