"""CARMEN logs: files written by hand, and the real ones."""

import gzip
import math
import random
from pathlib import Path

import numpy as np
import pytest

from occmap.errors import LogError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import Log, Note, Probe, Role, Stream, probe_path, text_log
from occmap.readers.carmen import CarmenReader
from occmap.sensor import ReturnOptions
from occmap.sensor.bands import RangeLimits
from occmap.types import PoseBatch, ScanBatch
from tests.readers.runs import open_carmen
from tests.samples import find_real


def flaser(stamp: float, ranges: str = "1.5 2.5 3.5", word: str = "FLASER") -> str:
    return f"{word} {len(ranges.split())} {ranges} 1 2 0 1 2 0 {stamp} host {stamp}\n"


def raw(stamp: float) -> str:
    return f"RAWLASER1 0 -1 2 0.5 8 0 0 2 1.5 2.5 0 {stamp} host {stamp}\n"


HEADER = "# message formats defined: PARAM SYNC ODOM FLASER RLASER\n"
ODOM = "ODOM 1 0 0 0 0 0 {0} host {0}\n"
OFFSET = "PARAM robot_frontlaser_offset 0.25 nohost 0\n"


def stamps(log: Log, *topics: str) -> list[float]:
    return [scan.stamp_ns / 1e9 for scan in log.scans(topics or ("FLASER",))]


def test_a_small_log(tmp_path: Path) -> None:
    content = HEADER + OFFSET + ODOM.format(1) + flaser(2) + "\n" + flaser(3) + "SYNC x 4 host 4\n"
    log = open_carmen(tmp_path, content)
    assert log.streams == [
        Stream("PARAM", "PARAM", 1, Role.OTHER),
        Stream("ODOM", "ODOM", 1, Role.POSE),
        Stream("FLASER", "FLASER", 2, Role.SCAN),
        Stream("SYNC", "SYNC", 1, Role.OTHER),
    ]
    assert stamps(log) == [2, 3]
    assert stamps(log) == [2, 3], "a second reading begins at the start"
    (moved,) = log.poses()
    assert (moved.parent, moved.child, moved.pose.x) == ("odom", "base_link", 1)
    assert [note.damage for note in log.notes] == [False] * 2


def test_no_transform_is_invented(tmp_path: Path) -> None:
    log = open_carmen(tmp_path, raw(1) + ODOM.format(1))
    assert [sample.topic for sample in log.poses()] == ["ODOM"]


def test_the_limit_is_what_the_log_states(tmp_path: Path) -> None:
    """FLASER states none, whatever its ranges are; a raw scan has a field for it."""
    ranges = " ".join(f"{1 + beam / 100:.2f}" for beam in range(168)) + " 81.91" * 12
    log = open_carmen(tmp_path, flaser(1, ranges))
    assert [scan.range_max for scan in log.scans(["FLASER"])] == [math.inf]
    assert not any("81.91" in note.text for note in log.notes)
    assert [scan.range_max for scan in open_carmen(tmp_path, raw(1)).scans(["RAWLASER1"])] == [8.0]


def test_unknown_beam_counts_are_noted_once(tmp_path: Path) -> None:
    log = open_carmen(tmp_path, flaser(1) + flaser(2))
    (note,) = (note for note in log.notes if "no angles" in note.text)
    assert note.text == "FLASER states no angles: 3 beams are read as 90 deg apart, from -90 deg"


def test_raw_scans_are_left_out_beside_posed_ones(tmp_path: Path) -> None:
    log = open_carmen(tmp_path, flaser(1) + raw(1))
    assert [stream.role for stream in log.streams] == [Role.SCAN, Role.OTHER]
    assert any(note.text.startswith("RAWLASER1 repeats") for note in log.notes)


def test_raw_scans_alone_are_scans(tmp_path: Path) -> None:
    (stream,) = open_carmen(tmp_path, raw(1)).streams
    assert stream == Stream("RAWLASER1", "RAWLASER1", 1, Role.SCAN)


def test_scans_of_no_beams_are_passed_over(tmp_path: Path) -> None:
    log = open_carmen(tmp_path, flaser(1) + flaser(2, ranges=""))
    assert stamps(log) == [1]
    assert Stream("FLASER without beams", "FLASER without beams", 1, Role.OTHER) in log.streams


def test_other_lines_are_counted(tmp_path: Path) -> None:
    content = flaser(1) + "# a\n#b\n" + "VERTEX2 0 0 0 0\n" * 3 + "gr\u00fcn 1\n"
    log = open_carmen(tmp_path, content)
    assert Note("4 lines without scan or pose passed over") in log.notes
    assert [(stream.topic, stream.count) for stream in log.streams[1:]] == [
        ("VERTEX2", 3),
        ("other", 1),
    ]


def test_garbage_words_do_not_fill_the_memory(tmp_path: Path) -> None:
    log = open_carmen(tmp_path, flaser(1) + "".join(f"word{n} 1\n" for n in range(1000)))
    assert [stream.count for stream in log.streams] == [1, 1000]


def test_a_large_log_is_streamed_with_the_same_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = "".join(flaser(stamp, "1.5 81.91") for stamp in range(20)) + "FLASER 2 1"
    kept = open_carmen(tmp_path, content)
    monkeypatch.setattr(text_log, "MAX_KEPT_BYTES", 5000)
    streamed = open_carmen(tmp_path, content)
    for one, other in zip(kept.scans(["FLASER"]), streamed.scans(["FLASER"]), strict=True):
        np.testing.assert_array_equal(one.ranges, other.ranges)
        assert one._replace(ranges=other.ranges) == other
    assert kept.notes == streamed.notes


def summarise(log: Log) -> list[object]:
    """All that a reading of a log gives."""
    scans = log.scans(["FLASER", "RAWLASER1"])
    listed = [[scan.ranges.tolist(), *scan[:4], *scan[5:]] for scan in scans]
    return [log.streams, listed, list(log.poses()), log.notes]


def test_how_many_lines_are_parsed_together_makes_no_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [HEADER, OFFSET, *(flaser(stamp) for stamp in range(25)), raw(25), ODOM.format(26)]
    lines[9] = flaser(7).replace("2.5", "2.5.5 x")
    lines[15] = flaser(13, "1.5 nan inf 4")
    lines[20] = flaser(18, "1.5-2.5")
    path = tmp_path / "cut.log.gz"
    path.write_bytes(gzip.compress("".join(lines).encode())[:-4])
    log = CarmenReader().open(path)
    expected = summarise(log)
    assert [note.damage for note in log.notes].count(True) == 2
    for size in (1, 700, 1500):
        monkeypatch.setattr("occmap.readers.text_log.BLOCK_BYTES", size)
        np.testing.assert_equal(summarise(CarmenReader().open(path)), expected)


def test_scans_of_two_lasers_stay_in_file_order(tmp_path: Path) -> None:
    lines = [flaser(stamp, word="RLASER" if stamp % 2 else "FLASER") for stamp in range(6)]
    log = open_carmen(tmp_path, "".join(lines))
    assert [scan.topic for scan in log.scans(["FLASER", "RLASER"])] == ["FLASER", "RLASER"] * 3
    stamps = [stamp_ns / 10**9 for stamp_ns, *_ in log.scans(["FLASER", "RLASER"])]
    assert stamps == list(range(6))


def test_scans_that_are_alike_come_at_a_stroke(tmp_path: Path) -> None:
    log = open_carmen(tmp_path, HEADER + "".join(flaser(i) + ODOM.format(i) for i in range(6)))
    (run,) = log.stacked_scans(["FLASER"])
    assert isinstance(run, ScanBatch)
    assert run.stamp_ns.tolist() == [stamp * 10**9 for stamp in range(6)]
    assert list(log.stacked_scans(["RLASER"])) == []
    (batch,) = log.stacked_poses()
    assert isinstance(batch, PoseBatch)
    assert batch.split() == list(log.poses())
    assert [sample.stamp_ns for sample in log.poses()] == run.stamp_ns.tolist()


@pytest.mark.parametrize(
    "content",
    [
        HEADER + "# nothing else yet\n",
        "FLASER 180 1.5 1.5",
        "ODOM -0.5 0 0 0 0 0 1 host 1\n",
        "VERTEX2 0 0 0 0\nROBOTLASER1 0 -1.57 3.14 0.0087 50 0.1 0 360 1.67",
        "PARAM robot_length 1 2 host 3\n" * 200,
        "# a comment\n" * 10 + "VERTEX2 1 2 3 4\n" * 300,
    ],
)
def test_recognises_carmen_by_content(content: str) -> None:
    data = content.encode()[:4096]
    assert CarmenReader().recognises(Probe(Path("any"), data, data))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n",
        b"The FLASER 180 of a robot\nwrites ODOM lines.\n",
        b"FLASER is a word\nODOM too\n",
        b"stamp,angle_min,angle_increment,r0,r1\n",
        b"PARAM\n",
        b"ODOM 1 2\0\0\0",
        b"#ROSBAG V2.0\n\x13\x00\x00\x00",
        bytes(range(256)),
    ],
)
def test_does_not_claim_what_is_not_carmen(content: bytes) -> None:
    assert not CarmenReader().recognises(Probe(Path("any"), content, content))


@pytest.mark.parametrize(
    ("name", "scans", "beams", "poses", "first"),
    [
        ("intel-corrected", 910, 180, 14541, (32_906_800_000, 0.600266, -0.0320327)),
        ("freiburg-079-corrected", 4791, 360, 9725, (227_623_000, 0.00123601, -0.00106807)),
        ("csail-corrected", 406, 361, 2394, (1_134_860_000_000_000_000, 0.154, 0.068)),
        ("fr079-robotlaser", 1464, 360, 0, (1_211_520_329_000, -0.040001, 0.0)),
    ],
)
def test_real_logs(
    name: str, scans: int, beams: int, poses: int, first: tuple[int, float, float]
) -> None:
    path = find_real(f"carmen/{name}.log.gz")
    assert CarmenReader().recognises(probe_path(path))
    log, limits = CarmenReader().open(path), RangeLimits(ReturnOptions())
    (stream,) = (stream for stream in log.streams if stream.role is Role.SCAN)
    found = list(log.scans([stream.topic]))
    assert stream.count == len(found) == scans
    assert {scan.ranges.size for scan in found} == {beams}
    assert found[0].pose is not None
    assert (found[0].stamp_ns, found[0].pose.x, found[0].pose.y) == first
    assert sum(not sample.static for sample in log.poses()) == poses
    assert not any(note.damage for note in log.notes)
    for scan in found:
        limits.see(scan)
    (note,) = limits.list_notes()
    if name == "fr079-robotlaser":
        assert {scan.range_max for scan in found} == {50}
        assert (found[0].angle_min, found[0].angle_increment) == (-1.570796, 0.008727)
        assert "10,528 of 527,040 ranges (2.0%) are above it, up to 81.91 m" in note
    else:
        assert {scan.range_max for scan in found} == {math.inf}
        assert "read 81.8" in note or "read 81.9" in note


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


def test_a_line_behind_zeros_is_passed_over_and_no_other(tmp_path: Path) -> None:
    """A power cut leaves them."""
    log = open_carmen(tmp_path, HEADER + flaser(1) + "\0\0" + flaser(2) + flaser(3))
    assert stamps(log) == [1, 3]


def test_malformed_lines_alone_are_an_error_that_names_the_first(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"\.log:2: '2,5' where a number belongs; correct or delete"):
        open_carmen(tmp_path, HEADER + flaser(2).replace("2.5", "2,5"))
    log = open_carmen(tmp_path, flaser(1) + "ODOM 1 2 three 0 0 0 1 host 1\n" + flaser(2))
    with pytest.raises(LogError, match=r"\.log:2: 'three' where"):
        list(log.poses())


def test_a_line_without_a_time_is_damage(tmp_path: Path) -> None:
    timed = [flaser(stamp) for stamp in range(60)]
    bare = timed[0].rsplit(None, 3)[0] + "\n"
    log = open_carmen(tmp_path, "".join([*timed[:30], bare, *timed[30:]]))
    assert stamps(log) == list(range(60))
    (note,) = (note for note in log.notes if note.damage)
    assert "the first is line 31: 3 numbers before the time" in note.text
