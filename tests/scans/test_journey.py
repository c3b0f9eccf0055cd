from pathlib import Path

import numpy as np

from occmap.posing import DropReason
from occmap.scans.tally import JourneyRecorder
from occmap.sensor import ReturnOptions, interpret
from occmap.types import Attached, PosedScans, ScanBatch

LOG = Path("a.bag")


def batch_of(*stamps: int, beams: int = 3) -> ScanBatch:
    ranges = np.full((len(stamps), beams), 2.0, np.float32)
    turn = np.pi / 2
    time_increment = np.zeros(len(stamps))
    return ScanBatch("laser", 0.0, turn, 0.0, 10.0, np.array(stamps), ranges, time_increment)


def pose(batch: ScanBatch, x: float) -> PosedScans:
    scans = len(batch.stamp_ns)
    position = np.tile([x, 1.0, 0.0], (scans, 1))
    return PosedScans(batch, position, np.tile(np.eye(3), (scans, 1, 1)))


def record(recorder: JourneyRecorder, attached: Attached, parent: str | None = None) -> None:
    """Record a batch as a build does."""
    recorder.follow(LOG, parent, attached)
    if attached.posed is not None:
        recorder.sample(interpret(attached.posed, ReturnOptions())[0])


def test_poses_hits_and_lost_scans_are_kept() -> None:
    recorder = JourneyRecorder(1)
    whole = batch_of(1, 2, 3)
    second = pose(whole.take(np.array([1])), 5.0)
    record(recorder, Attached(whole, second, {DropReason.GAP: 2}), "odom")
    record(recorder, Attached(batch_of(4), pose(batch_of(4), 6.0), {}), "odom")
    journey = recorder.finish()
    (way,) = journey.trajectories
    assert (way.log, way.parent, way.frame) == ("a.bag", "odom", "laser")
    assert way.stamp_ns.tolist() == [2, 4]
    assert way.pose.tolist() == [[5, 1, 0, 0, 0, 0, 1], [6, 1, 0, 0, 0, 0, 1]]
    assert way.dropped == ((1, DropReason.GAP.value), (3, DropReason.GAP.value))
    first = journey.scans[0]
    assert first.stamp_ns == 2
    np.testing.assert_allclose(first.x, [7, 5, 3], atol=1e-6)
    np.testing.assert_allclose(first.y, [1, 3, 1], atol=1e-6)


def test_a_sample_is_spread_over_all_scans_and_their_beams() -> None:
    recorder = JourneyRecorder(10)
    for start in range(0, 4000, 250):
        batch = batch_of(*range(start, start + 250), beams=1200)
        record(recorder, Attached(batch, pose(batch, 0.0), {}))
    scans = recorder.finish().scans
    assert [scan.stamp_ns for scan in scans] == list(range(0, 4000, 10))
    assert {len(scan.x) for scan in scans} == {400}


def test_parts_of_a_log_add_up_and_a_second_reading_forgets_the_first() -> None:
    first = JourneyRecorder(1)
    record(first, Attached(batch_of(1), pose(batch_of(1), 0.0), {}))
    second = first.start_over()
    assert second.finish().trajectories == ()
    lost: dict[str, int] = {DropReason.GAP: 1}
    record(second, Attached(batch_of(2, 3), pose(batch_of(2), 0.0), lost))
    first.add(second)
    (way,) = first.finish().trajectories
    assert way.stamp_ns.tolist() == [1, 2]
    assert [stamp_ns for stamp_ns, _ in way.dropped] == [3]
    assert len(first.finish().scans) == 2
