"""`occmap build` where all goes well: the files, the report, the notes and the flags."""

import gzip
import json
from pathlib import Path

import pytest

from occmap.cli.build import build_command, read_request
from occmap.cli.console import Console
from occmap.options import DEFAULT_UPDATE, BuildOptions, Selection, choose_model
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.report.results import DOUBTFUL_AGREEMENT, LEAST_AGREEMENT
from occmap.sensor import NoReturn, ReturnOptions
from occmap.sensor.models import CountingModel, SimpleModel
from occmap.types import BEAM_UPDATES, Pose, PoseSample, Update
from occmap.writers import Shade, WriteOptions
from tests.cli.runner import find_command, occmap, read_error
from tests.samples import PLAIN_WORDS, SAMPLE_LOGS, write_csv

DRIVE = SAMPLE_LOGS / "drive.csv"


def parse(*words: str) -> BuildOptions:
    """Read a command line without running it."""
    context = build_command.make_context("build", [*words, "x.log", "-o", "m.pgm"], obj=Console())
    values = dict(context.params)
    _, options = read_request(values.pop("words"), values)
    return options


def test_no_flag_leaves_every_default() -> None:
    assert parse() == BuildOptions()


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_the_first_word_may_be_the_update(update: Update) -> None:
    assert parse(update.value) == BuildOptions(update=update)


def test_the_update_chooses_the_model_where_none_is_named() -> None:
    # docs/models.md: "With `polygon`, `counting` has a cut of 0.4 and no spread".
    assert BuildOptions(update=Update.POLYGON).model == CountingModel(cut=0.4, spread=0.0)
    assert BuildOptions(update=Update.BEAM).model == BuildOptions().model == CountingModel()
    assert BuildOptions(update=Update.POLYGON, model=SimpleModel()).model == SimpleModel()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            "--min-range 0.2 --max-range 9 --range-max 10 --no-return clear --jobs 3",
            {"returns": ReturnOptions(0.2, 9.0, 10.0, NoReturn.CLEAR), "jobs": 3},
        ),
        (
            "--scan-topic /a --scan-topic /b --start 1 --end 2.5 --stride 3",
            {"selection": Selection(("/a", "/b"), 1.0, 2.5, 3)},
        ),
        ("--light-occupied", {"writing": WriteOptions(shade=Shade.LIGHT_OCCUPIED)}),
        ("--georeference 52.5,13.4,-9", {"writing": WriteOptions(georeference=(52.5, 13.4, -9.0))}),
        ("--model simple:p_hit=0.8", {"model": SimpleModel(p_hit=0.8)}),
        ("--model simple --p-hit 0.9 --p-miss 0.2", {"model": SimpleModel(0.9, 0.2)}),
        ("--prior 0.4", {"model": CountingModel(0.4)}),
        ("polygon --prior 0.4", {"model": CountingModel(0.4, cut=0.4, spread=0.0)}),
        ("polygon --model counting", {"model": CountingModel()}),
        # Neither would do with the other's default.
        (
            "--model simple:p_miss=0.75,prior=0.8 --p-hit 0.9",
            {"model": SimpleModel(0.9, 0.75, 0.8)},
        ),
        (
            "--max-pose-gap 1 --time-offset -0.5",
            {"posing": PosingOptions(max_pose_gap_s=1.0, time_offset_s=-0.5)},
        ),
        (
            "--sensor-pose -0.1,0,0 --static-tf a,b,1,2,3,0,0,0",
            {
                "posing": PosingOptions(
                    sensor_pose=Pose(-0.1, 0, 0, 0, 0, 0, 1),
                    static_transforms=(
                        PoseSample(0, "a", "b", Pose(1, 2, 3, 0, 0, 0, 1), static=True),
                    ),
                )
            },
        ),
    ],
)
def test_flags_set_the_options(words: str, expected: dict[str, object]) -> None:
    options = parse(*words.split())
    assert {name: getattr(options, name) for name in expected} == expected


def test_the_map_is_what_the_library_builds(tmp_path: Path) -> None:
    mine, expected = tmp_path / "mine.pgm", tmp_path / "expected.pgm"
    result = occmap("build", "polygon", DRIVE, "-o", mine, "-o", tmp_path / "mine.png")
    assert (result.code, result.err) == (0, "")
    model = choose_model(Update.POLYGON)
    build([DRIVE], BuildOptions(update=Update.POLYGON, model=model), [expected])
    assert mine.read_bytes() == expected.read_bytes()
    files = {path.name for path in tmp_path.iterdir()} - {"expected.pgm", "expected.yaml"}
    assert files == {"mine.pgm", "mine.yaml", "mine.png"}
    assert occmap("build", DRIVE, "-o", mine, "--strict").code == 0  # the log is sound


def test_the_report_is_aligned_and_says_what_was_done(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(float(second), 0, 0) for second in range(4)], [0.32])
    words = ["--resolution", 0.1, "--end", 3, "-o", tmp_path / "m.pgm"]
    lines = occmap("build", *PLAIN_WORDS, log, *words).out.splitlines()
    assert lines[:7] == [
        "map      24 x 1 cells of 0.1 m, x 0 to 2.4 m, y 0 to 0.1 m",
        "cells    12.5% occupied, 37.5% free, 50.0% unknown",
        "agree    100.0% of the hits lie in occupied cells",
        "update   beam, model simple:spread=0",
        "scans    3 of 4 used",
        "dropped  1 outside --start and --end",
        "beams    3: 3 hit",
    ]
    assert lines[7].startswith("time     ")
    assert " scans/s (open " in lines[7]
    assert lines[8:] == [f"files    {tmp_path / 'm.pgm'}", f"         {tmp_path / 'm.yaml'}"]


@pytest.mark.parametrize(
    ("late_s", "hint", "notes"),
    [(0.0, "", 0), (0.1, "; walls may be doubled: `occmap tune LOG` looks for", 0), (0.4, "", 1)],
)
def test_tune_is_named_where_walls_may_be_doubled(
    tmp_path: Path, late_s: float, hint: str, notes: int
) -> None:
    """On this drive 0, 100 and 400 ms leave 100%, 56% and 31% of the hits in occupied cells."""
    words = [SAMPLE_LOGS / "drive.mcap", "--time-offset", late_s]
    built = occmap("build", *words, "-o", tmp_path / "m.pgm")
    (line,) = (line for line in built.out.splitlines() if line.startswith("agree"))
    assert line.partition("occupied cells")[2].startswith(hint)
    assert bool(hint) == ("occmap tune" in built.out)
    assert built.err.count("occmap tune") == notes
    assert bool(hint) == ("walls may be doubled" in occmap("check", *words).out)


def test_where_poses_stand_beside_scans_no_clock_is_blamed(tmp_path: Path) -> None:
    words = [SAMPLE_LOGS / "drive.csv", "--sensor-pose", "0.07,0.03,0.03"]
    report = json.loads(occmap("build", *words, "-o", tmp_path / "m.pgm", "--json").out)
    assert LEAST_AGREEMENT < report["map"]["agreement"] < DOUBTFUL_AGREEMENT
    for command in (["build", *words, "-o", tmp_path / "m.pgm"], ["check", *words]):
        assert "occmap tune" not in occmap(*command).out


@pytest.mark.parametrize("command", ["build", "check"])
def test_where_poses_stand_beside_scans_no_time_mends_them(tmp_path: Path, command: str) -> None:
    words = [SAMPLE_LOGS / "drive.csv", "--sensor-pose", "0.3,0.3,0.4"]
    outputs = ["-o", tmp_path / "m.pgm"] if command == "build" else []
    told = occmap(command, *words, *outputs)
    assert "the poses do not fit the scans; " in told.err + told.out
    assert "another trajectory by --poses FILE" in told.err + told.out
    for vain in ("tune", "--time-offset", "--deskew"):
        assert vain not in told.err + told.out


def test_json_is_one_object_and_nothing_else(tmp_path: Path) -> None:
    result = occmap("build", DRIVE, "--json", "-o", tmp_path / "m.pgm")
    report = json.loads(result.out)
    assert report["scans"] == {"read": 414, "used": 414, "dropped": {}}
    assert report["map"]["update"] == DEFAULT_UPDATE.value
    assert result.err == ""


def write_cut(folder: Path) -> Path:
    """Write a log whose gzip data ends early."""
    whole = write_csv(folder / "log.csv", [(n / 1e4, 0.0, 0.0) for n in range(3000)], [0.3])
    cut = folder / "cut.csv.gz"
    cut.write_bytes(gzip.compress(whole.read_bytes())[:-1000])
    return cut


def test_damage_is_a_note_and_with_strict_an_error_after_the_map(tmp_path: Path) -> None:
    log, target = write_cut(tmp_path), tmp_path / "m.pgm"
    result = occmap("build", log, "-o", target)
    (note,) = result.err.splitlines()
    assert result.code == 0
    assert note.startswith(f"note: {log}: the gzip data is cut short")
    target.unlink()

    strict = occmap("build", log, "-o", target, "--strict", "-q")
    assert "the gzip data is cut short" in read_error(strict, 1)
    assert strict.err.endswith("(--strict); the map was written\n")
    assert target.exists()
    told = occmap("build", log, "-o", target, "--strict", "--json")
    assert (told.code, len(told.err.splitlines())) == (1, 2)
    assert json.loads(told.out)["damage"]


def test_a_map_without_walls_is_noted(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0, 0, 0)], [1.0, 2.0], 0.5)
    words = ["build", log, "--max-range", "0.5", "-o", tmp_path / "map.pgm"]
    assert "note: no beam hit anything, so the map has no walls" in occmap(*words).err
    words[3] = "1.5"
    assert occmap(*words).err == ""


@pytest.mark.parametrize(
    ("step", "beams", "note"),
    [
        (1.0, 271, "271 beams go round 43 times: angles are radians; are these degrees?"),
        (-0.5, 20, "20 beams go round 1.51 times: angles are radians; are these degrees?"),
        (0.0, 3, "3 beams all point the same way: angle_increment is 0"),
        (0.0, 1, ""),
        (0.1, 90, ""),
    ],
)
def test_odd_angles_are_noted_by_build_and_check(
    tmp_path: Path, step: float, beams: int, note: str
) -> None:
    log = write_csv(tmp_path / "log.csv", [(0, 0, 0)] * 3, [1.0] * beams, step)
    told = f"note: {log}: scan: {note}\n" if note else ""
    assert occmap("build", log, "-o", tmp_path / "map.pgm").err == told
    lines = occmap("check", log).out.splitlines()
    assert (f"warning   {log}: scan: {note}" in lines) == bool(note)
    assert any("degrees?" in line or "same way" in line for line in lines) == bool(note)


def test_options_of_the_other_update_are_noted(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0, 0, 0)], [1.0, 1.0], 0.1)
    words = [log, "--jump", "0.3", "--border-gap", "4", "-o", tmp_path / "map.pgm"]
    told = "note: --{} does nothing with the {} update\n".format
    both = told("jump", "beam") + told("border-gap", "beam")
    assert occmap("build", "beam", *words).err == both
    assert occmap("build", *words).err == told("border-gap", "surface")
    assert occmap("build", "polygon", *words).err == ""


def test_options_of_scans_are_noted_where_clouds_are_mapped(tmp_path: Path) -> None:
    words = ["--no-return", "clear", "--range-max", "30", "--footprint=-0.3,-0.3,0.3,0.3"]
    err = occmap("build", SAMPLE_LOGS / "hall.mcap", *words, "-o", tmp_path / "m.pgm").err
    idle = [line for line in err.splitlines() if "does nothing" in line]
    assert [line.split()[1] for line in idle] == ["--no-return", "--range-max"]


def test_options_of_clouds_are_noted_where_scans_are_mapped(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0, 0, 0)], [1.0, 1.0], 0.1)
    words = ["--jump", "0.3", "--max-height", "2", "--ground", "flat"]
    err = occmap("build", log, *words, "-o", tmp_path / "m.pgm").err
    assert [line.split()[1] for line in err.splitlines()] == ["--max-height", "--ground"]


def test_a_band_without_a_ceiling_is_mapped_like_one_with_a_very_high_one(tmp_path: Path) -> None:
    made = []
    for height in ("inf", "1000"):
        path = tmp_path / f"{height}.pgm"
        words = ["--max-height", height, "-o", path]
        assert occmap("build", SAMPLE_LOGS / "hall.mcap", *words).code == 0
        made.append(path.read_bytes())
    assert made[0] == made[1]


def test_options_of_a_build_by_workers_are_noted_without_workers(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0, 0, 0)], [1.0])
    words = ["build", log, "-o", tmp_path / "m.pgm", "--scratch", tmp_path]
    told = occmap(*words, "--json")
    assert json.loads(told.out)["notes"] == ["--scratch does nothing without --dask"]
    assert told.err == "note: --scratch does nothing without --dask\n"


def test_quiet_prints_nothing(tmp_path: Path) -> None:
    assert occmap("build", write_cut(tmp_path), "-o", tmp_path / "m.pgm", "-q") == (0, "", "")


def test_a_bar_never_passes_its_total(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers: list[tuple[float, float]] = []
    closed: list[bool] = []

    class Bar:
        n, total = 0, 0

        def __init__(self, **_: object) -> None:
            pass

        def close(self) -> None:
            closed.append(True)

        def update(self, scans: int) -> None:
            self.n += scans
            numbers.append((self.n, self.total))

    monkeypatch.setattr("tqdm.tqdm", Bar)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    Console(quiet=True).advance(5, 10)
    assert not numbers
    console = Console()
    for scans in (5, 5, -10, 5, 7):
        console.advance(scans, 10)
    assert closed == []
    console.clear()
    assert closed == [True]
    assert [done for done, _ in numbers] == [5, 10, 0, 5, 12]
    assert all(done <= total for done, total in numbers)


def test_help_leaves_rare_options_to_help_all() -> None:
    usual, whole = occmap("build", "--help").out, occmap("build", "--help-all").out
    assert len(usual.splitlines()) < 100 < len(whole.splitlines())
    options = [option for each in find_command("build").params for option in each.opts]
    rare = {each for each in options if each.startswith("--") and f" {each}" not in usual}
    assert {"--jump", "--scratch", "--epsilon", "--deskew"} < rare
    assert all(f" {each}" in whole for each in options if each.startswith("--"))
    assert "--help-all" not in occmap("check", "--help").out


def test_help_lists_options_by_section() -> None:
    text = occmap("build", "--help").out
    assert text.startswith("Usage: occmap build [OPTIONS] [beam|polygon|surface] LOG...")
    heads = [line for line in text.splitlines() if line.endswith(":") and line[0] != " "]
    assert heads == [
        "Files:",
        "Map:",
        "What a range means:",
        "Sensor model:",
        "Which scans:",
        "Where the scans were taken:",
        "Limits:",
        "Run:",
    ]
    assert "--resolution M" in text.split("Map:")[1].split("What a")[0]
