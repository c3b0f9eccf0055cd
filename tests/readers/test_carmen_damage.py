"""CARMEN logs with a byte gone, or cut: what is lost or may be is said, and all else stays."""

import random
from contextlib import suppress
from pathlib import Path

import pytest

from occmap.errors import LogError
from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.readers.runs import open_carmen
from tests.readers.test_carmen import HEADER, ODOM, OFFSET, flaser, raw, stamps

SCANS = 40
MEASURED = [f"{2 + beam / 8:.2f}" for beam in range(150)]
NOTHING = ["81.83"] * 30
LOG = "".join(
    f"FLASER 180 {' '.join(MEASURED + NOTHING)} {t}.25 2 0 {t}.25 2 0 {t}.5 host {t}.5\n"
    for t in range(SCANS)
)


def list_bytes() -> list[int]:
    """Some dots of a scan in the middle, without which it reads 8183 m or 1750 m, and any bytes."""
    start = LOG.index("FLASER", len(LOG) // 2)
    dots = [at for at in range(start, LOG.index("\n", start)) if LOG[at] == "."]
    dice = random.Random(1)
    return dice.sample(dots, 15) + dice.sample(range(LOG.index("\n") + 1, len(LOG)), 25)


@pytest.mark.parametrize("index", list_bytes())
def test_a_deleted_byte_leaves_the_no_return_value_known(tmp_path: Path, index: int) -> None:
    log = open_carmen(tmp_path, LOG[:index] + LOG[index + 1 :])
    report = build([log.path], BuildOptions()).report
    assert report.scans.used >= SCANS - 2
    assert report.beams.no_return >= len(NOTHING) * report.scans.used - 1


@pytest.mark.parametrize(
    "line", ["SYNC a 4 host 4", "SYNC a 4 ho", "PARAM robot_wid", "# a comm", "VERTEX2 7 1.5"]
)
def test_a_last_line_that_may_be_cut_is_told(tmp_path: Path, line: str) -> None:
    log = open_carmen(tmp_path, LOG + line)
    assert list(log.poses()) == []
    assert log.notes[0].text.startswith(f"line {SCANS + 1}, the last, has no line end")


def test_a_last_line_cut_anywhere(tmp_path: Path) -> None:
    whole, last = HEADER + flaser(1) + flaser(2), flaser(3).rstrip()
    for cut in range(1, len(last)):
        log = open_carmen(tmp_path, whole + last[:cut])
        damage = [note.text for note in log.notes if note.damage]
        if stamps(log) == [1, 2]:
            assert damage == [] or "the first is line 4: " in damage[0]
        else:
            assert stamps(log) == [1, 2, 3]
            assert last[:cut].split()[:-1] == last.split()[:-1], "only the second time is cut"
        assert log.streams[0].count == len(stamps(log))


@pytest.mark.parametrize("at", [0, 1, 2])
@pytest.mark.parametrize("bad", ["2,5", "2.5 2.5"])
def test_a_malformed_line_is_left_out_wherever_it_is(tmp_path: Path, at: int, bad: str) -> None:
    lines = [flaser(1), flaser(2), flaser(3)]
    lines[at] = lines[at].replace("2.5", bad)
    log = open_carmen(tmp_path, HEADER + "".join(lines))
    assert len(stamps(log)) == 2
    (damage,) = [note.text for note in log.notes if note.damage]
    assert damage.startswith(f"1 of 3 lines are malformed and left out, the first is line {at + 2}")


def test_malformed_lines_alone_are_an_error_that_names_the_first(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"\.log:2: '2,5' where a number belongs; correct or delete"):
        open_carmen(tmp_path, HEADER + flaser(2).replace("2.5", "2,5"))
    log = open_carmen(tmp_path, flaser(1) + "ODOM 1 2 three 0 0 0 1 host 1\n" + flaser(2))
    with pytest.raises(LogError, match=r"\.log:2: 'three' where"):
        list(log.poses())


def test_flipped_bytes_give_a_log_error_or_scans(tmp_path: Path) -> None:
    content = "".join([OFFSET, ODOM.format(1), flaser(1), raw(2), flaser(3)]).encode()
    for at in range(len(content)):
        flipped = bytearray(content)
        flipped[at] ^= 1 << at % 8
        with suppress(LogError):
            log = open_carmen(tmp_path, bytes(flipped))
            assert len(stamps(log, "FLASER", "RAWLASER1")) <= 3
            list(log.poses())


def test_a_line_without_a_time_is_damage_among_others_that_have_one(tmp_path: Path) -> None:
    timed = [flaser(stamp) for stamp in range(60)]
    bare = timed[0].rsplit(None, 3)[0] + "\n"
    log = open_carmen(tmp_path, "".join([*timed[:30], bare, *timed[30:]]))
    assert stamps(log) == list(range(60))
    (note,) = (note for note in log.notes if note.damage)
    assert "the first is line 31: 3 numbers before the time" in note.text
