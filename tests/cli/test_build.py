"""`occmap build` where all goes well: the files, the report, the notes and the flags."""

import gzip
from pathlib import Path

import pytest

from occmap.cli.build import build_command, read_request
from occmap.cli.console import Console
from occmap.options import BuildOptions, Selection, choose_model
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.report.results import DOUBTFUL_AGREEMENT, LEAST_AGREEMENT, hint_at_tune
from occmap.sensor.models import CountingModel, SimpleModel
from occmap.types import BEAM_UPDATES, Pose, PoseSample, Update
from occmap.writers import Shade, WriteOptions
from tests.cli.runner import ask, find_command, occmap, read_error
from tests.samples import PLAIN_WORDS, SAMPLE_LOGS, write_csv

pytestmark = pytest.mark.usefixtures("here")
DRIVE = SAMPLE_LOGS / "drive.csv"
HALL = SAMPLE_LOGS / "hall.mcap"


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


MOUNT = Pose(-0.1, 0, 0, 0, 0, 0, 1)
EDGE = PoseSample(0, "a", "b", Pose(1, 2, 3, 0, 0, 0, 1), static=True)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--scan-topic /a --scan-topic /b --start 1 --end 2.5 --stride 3",
         {"selection": Selection(("/a", "/b"), 1.0, 2.5, 3)}),
        ("--light-occupied", {"writing": WriteOptions(shade=Shade.LIGHT_OCCUPIED)}),
        ("--model simple:p_hit=0.8", {"model": SimpleModel(p_hit=0.8)}),
        ("--model simple --p-hit 0.9 --p-miss 0.2", {"model": SimpleModel(0.9, 0.2)}),
        ("--prior 0.4", {"model": CountingModel(0.4)}),
        ("polygon --prior 0.4", {"model": CountingModel(0.4, cut=0.4, spread=0.0)}),
        ("polygon --model counting", {"model": CountingModel()}),
        # Neither would do with the other's default.
        ("--model simple:p_miss=.75,prior=0.8 --p-hit 0.9", {"model": SimpleModel(0.9, 0.75, 0.8)}),
        ("--sensor-pose -0.1,0,0 --static-tf a,b,1,2,3,0,0,0",
         {"posing": PosingOptions(sensor_pose=MOUNT, static_transforms=(EDGE,))}),
    ],
)  # fmt: skip
def test_flags_set_the_options(words: str, expected: dict[str, object]) -> None:
    options = parse(*words.split())
    assert {name: getattr(options, name) for name in expected} == expected


def test_the_map_is_what_the_library_builds(here: Path) -> None:
    result = occmap("build", "polygon", DRIVE, "-o", "mine.pgm", "-o", "mine.png", "--strict")
    assert (result.code, result.err) == (0, "")  # the log is sound
    assert {path.name for path in here.iterdir()} == {"mine.pgm", "mine.yaml", "mine.png"}
    model = choose_model(Update.POLYGON)
    build([DRIVE], BuildOptions(update=Update.POLYGON, model=model), [Path("expected.pgm")])
    assert Path("mine.pgm").read_bytes() == Path("expected.pgm").read_bytes()


def test_the_report_is_aligned_and_says_what_was_done() -> None:
    write_csv(Path("log.csv"), [(float(second), 0, 0) for second in range(4)], [0.32])
    words = ["--resolution", 0.1, "--end", 3, "-o", "m.pgm"]
    lines = occmap("build", *PLAIN_WORDS, "log.csv", *words).out.splitlines()
    time = lines.pop(7)
    assert lines == [
        "map      24 x 1 cells of 0.1 m, x 0 to 2.4 m, y 0 to 0.1 m",
        "cells    12.5% occupied, 37.5% free, 50.0% unknown",
        "agree    100.0% of the hits lie in occupied cells",
        "update   beam, model simple:spread=0",
        "scans    3 of 4 used",
        "dropped  1 outside --start and --end",
        "beams    3: 3 hit",
        "files    m.pgm",
        "         m.yaml",
    ]
    assert time.startswith("time     ")
    assert " scans/s (open " in time


LOG = SAMPLE_LOGS / "drive.mcap"


@pytest.mark.parametrize(
    ("late_s", "hint", "notes"),
    [(0.0, "", 0), (0.1, f"; walls may be doubled: `occmap tune {LOG} --time-o", 0), (0.4, "", 1)],
)
def test_tune_is_named_where_walls_may_be_doubled(late_s: float, hint: str, notes: int) -> None:
    """On this drive 0, 100 and 400 ms leave 100%, 56% and 31% of the hits in occupied cells."""
    words = [LOG, "--time-offset", late_s]
    built = occmap("build", *words, "-o", "m.pgm")
    (line,) = (line for line in built.out.splitlines() if line.startswith("agree"))
    assert line.partition("occupied cells")[2].startswith(hint)
    assert bool(hint) == ("occmap tune" in built.out)
    assert built.err.count("occmap tune") == notes
    assert bool(hint) == ("walls may be doubled" in occmap("check", *words).out)


@pytest.mark.parametrize(
    "words",
    ["polygon", "-r 0.04", "--hit-offset 0.4", "--spread 0", "--no-return clear", "--model simple"],
)
def test_tune_is_not_named_where_walls_may_be_thin_by_choice(words: str) -> None:
    built = occmap("build", *words.split(), LOG, "--time-offset", 0.1, "-o", "m.pgm")
    assert (built.code, "occmap tune" in built.out) == (0, False)


def test_a_hint_names_a_few_logs_as_they_are_typed() -> None:
    options = BuildOptions()
    assert hint_at_tune(0.7, ["a b", "c"], options).split("`")[1] == "occmap tune 'a b' c"
    assert hint_at_tune(0.7, list("abcd"), options).split("`")[1] == "occmap tune a b c ..."
    turned = BuildOptions(posing=PosingOptions(align=5.0))  # which tune does not take
    assert hint_at_tune(0.7, ["a"], turned).split("`")[1] == "occmap tune a"
    assert [hint_at_tune(share, ["a"], options) for share in (None, 0.5, 0.8)] == [""] * 3


def test_where_poses_stand_beside_scans_no_clock_is_blamed() -> None:
    words = [DRIVE, "--sensor-pose", "0.07,0.03,0.03"]
    report = ask("build", *words, "-o", "m.pgm")
    assert LEAST_AGREEMENT < report["map"]["agreement"] < DOUBTFUL_AGREEMENT
    for command in (["build", *words, "-o", "m.pgm"], ["check", *words]):
        assert "occmap tune" not in occmap(*command).out


@pytest.mark.parametrize("command", ["build -o m.pgm", "check"])
def test_where_poses_stand_beside_scans_no_time_mends_them(command: str) -> None:
    told = occmap(*command.split(), SAMPLE_LOGS / "drive.csv", "--sensor-pose", "0.3,0.3,0.4")
    assert "the poses do not fit the scans; " in told.err + told.out
    assert "another trajectory by --poses FILE" in told.err + told.out
    for vain in ("tune", "--time-offset", "--deskew"):
        assert vain not in told.err + told.out


def test_scans_that_state_no_times_of_beams_are_not_to_be_deskewed() -> None:
    told = occmap("build", SAMPLE_LOGS / "drive.bag", "--sensor-pose", "0.3,0.3,0.4", "-o", "m.pgm")
    assert "try `occmap tune` or another trajectory by --poses FILE" in told.err
    assert "--deskew" not in told.err


def test_damage_is_a_note_and_with_strict_an_error_after_the_map(here: Path) -> None:
    """The log's gzip data ends early."""
    whole = write_csv(here / "log.csv", [(n / 1e4, 0.0, 0.0) for n in range(3000)], [0.3])
    Path("cut.csv.gz").write_bytes(gzip.compress(whole.read_bytes())[:-1000])
    line, damage = "build cut.csv.gz -o m.pgm", "cut.csv.gz: the gzip data is cut short"
    told = occmap(line)
    assert (told.code, told.err.count("\n")) == (0, 1)
    assert told.err.startswith(f"note: {damage}")
    assert occmap(f"{line} -q") == (0, "", "")
    Path("m.pgm").unlink()

    strict = read_error(occmap(f"{line} --strict -q"), 1)
    assert strict.startswith(damage)
    assert strict.endswith("(--strict); the map was written")
    assert Path("m.pgm").exists()
    told = occmap(f"{line} --strict --json")
    assert (told.code, told.err.count("\n")) == (1, 2)
    assert told.json["damage"]


@pytest.mark.parametrize("workers", [[], ["--dask", "local", "--jobs", "1"]])
def test_logs_that_cannot_be_read_are_left_out_as_damage(here: Path, workers: list[str]) -> None:
    (here / "rnd.bag").write_bytes(b"nothing")
    (here / "cut.mcap").write_bytes((SAMPLE_LOGS / "drive.mcap").read_bytes()[:60])
    (here / "no_poses.csv").write_text("stamp,angle_min,angle_increment,r0\n1,0,0,2\n")
    line = ["build", "rnd.bag", DRIVE, "cut.mcap", "no_poses.csv", "-o", "m.pgm"]
    assert read_error(occmap(*line, "-q"), 1).startswith("rnd.bag: ")
    told = ask(*line, *workers, "--skip-unreadable", "--fail-if", "damage > 3")
    assert told["logs"] == [str(DRIVE)]
    assert told["scans"]["used"] == 414
    first, second, third = told["damage"]
    assert third.startswith("no_poses.csv: left out: the scans have no poses")
    assert first.startswith("rnd.bag: left out: a text file of no known log format")
    assert second.startswith("cut.mcap: left out: nothing in it can be read")
    assert set(told["damage"]) <= set(told["notes"])
    assert occmap(*line, "--skip-unreadable", "--fail-if", "damage > 2").code == 3
    none = occmap("build", "rnd.bag", "-o", "m.pgm", "--skip-unreadable")
    assert read_error(none, 1).startswith("rnd.bag: a text file of no known")
    (here / "good.bag").write_bytes(DRIVE.read_bytes())
    strict = occmap("build", "*.bag", "-o", "m.pgm", "--strict", "--json")
    assert (strict.code, strict.err.count("note: rnd.bag:")) == (1, len(strict.json["damage"]))


def test_a_map_without_walls_is_noted() -> None:
    write_csv(Path("log.csv"), [(0, 0, 0)], [1.0, 2.0], 0.5)
    told = occmap("build log.csv -o m.pgm --max-range 0.5")
    assert "note: no beam hit anything, so the map has no walls" in told.err
    assert occmap("build log.csv -o m.pgm --max-range 1.5").err == ""


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
def test_odd_angles_are_noted_by_build_and_check(step: float, beams: int, note: str) -> None:
    write_csv(Path("log.csv"), [(0, 0, 0)] * 3, [1.0] * beams, step)
    told = f"log.csv: scan: {note}"
    assert occmap("build log.csv -o m.pgm").err == (f"note: {told}\n" if note else "")
    warnings = [each for each in occmap("check log.csv").out.splitlines() if each[:4] == "warn"]
    assert warnings == ([f"warning   {told}"] if note else [])


@pytest.mark.parametrize(
    ("line", "idle"),
    [
        ("beam log.csv --jump 0.3 --border-gap 4", "--jump --border-gap"),
        ("surface log.csv --jump 0.3 --border-gap 4", "--border-gap"),
        ("polygon log.csv --jump 0.3 --border-gap 4", ""),
        ("log.csv --jump 0.3 --max-height 2 --ground flat", "--max-height --ground"),
        (f"{HALL} --no-return clear --range-max 9 --footprint=-1,-1,1,1", "--no-return"),
        ("log.csv --scratch .", "--scratch"),  # which is for workers
    ],
)
def test_options_that_do_nothing_are_noted(line: str, idle: str) -> None:
    write_csv(Path("log.csv"), [(0, 0, 0)], [1.0, 1.0], 0.1)
    told = occmap(f"build {line} -o m.pgm --json")
    notes = [f"note: {each}" for each in told.json["notes"]]
    assert told.err.splitlines() == notes
    assert [each.split()[1] for each in notes if "does nothing" in each] == idle.split()


def test_a_band_without_a_ceiling_is_mapped_like_one_with_a_very_high_one() -> None:
    for name, height in (("a", "inf"), ("b", "1000")):
        assert occmap(f"build {HALL} --max-height {height} -o {name}.pgm").code == 0
    assert Path("a.pgm").read_bytes() == Path("b.pgm").read_bytes()


def test_points_of_clouds_beyond_the_sensors_limit_are_no_return() -> None:
    for name, words in (("a", "--range-max 4"), ("b", "--max-range 4"), ("c", "--range-max 9")):
        assert occmap(f"build {HALL} {words} -o {name}.pgm").code == 0
    a, b, c = (Path(f"{name}.pgm").read_bytes() for name in "abc")
    assert a == b != c


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
    of_poses = ["What a range means:", "Where the scans were taken:", "Which scans:"]
    assert heads == ["Files:", "Map:", *of_poses, "Sensor model:", "Limits:", "Run:"]
    assert "--resolution M" in text.split("Map:")[1].split("What a")[0]
