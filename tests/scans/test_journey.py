import numpy as np

from occmap.posing import DropReason
from occmap.scans.tally import Tally
from occmap.sensor import ReturnCounts
from occmap.types import Float64, Kind, Rays
from tests.posing.scenes import SECOND, attach, batch_at, bolted, build, drive, turned


def see(scans: range, beams: int = 3, x: float = 0.0) -> Rays:
    """Scans of beams that all end 2 m away, at bearings a quarter turn apart."""
    bearing = np.arange(beams) * np.pi / 2
    ways: Float64 = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    shape = len(scans), beams
    return Rays.along(
        np.tile([x, 1.0], (len(scans), 1, 1)),
        np.broadcast_to(ways, (*shape, 2)),
        np.full(shape, 2.0, np.float32),
        np.full(shape, Kind.HIT, np.uint8),
        np.array(scans),
        full_circle=False,
    )


def test_where_a_laser_was_and_which_scans_have_no_pose_is_known_of_a_log() -> None:
    mount = bolted("base_link", "laser", turned(0, y=1))
    log = drive("odom", "base_link", seconds=[0, 1, 2, 6, 7])
    poser = build(*log, mount, time_offset_s=-100)
    attach(poser, batch_at([99, 100.5, 103]), batch_at([106.5]))
    (way,) = poser.list_trajectories("a.bag")
    assert (way.log, way.parent, way.frame) == ("a.bag", "odom", "laser")
    assert way.stamp_ns.tolist() == [100.5 * SECOND, 106.5 * SECOND]
    assert way.pose.tolist() == [[0.5, 1, 0, 0, 0, 0, 1], [6.5, 1, 0, 0, 0, 0, 1]]
    lost = ((99 * SECOND, DropReason.BEFORE), (103 * SECOND, DropReason.GAP))
    assert way.dropped == lost


def test_a_laser_whose_log_names_no_frames_gets_names() -> None:
    poser = build()
    stated = batch_at([1])
    attach(poser, stated)
    (way,) = poser.list_trajectories("a.log")
    assert (way.parent, way.frame, len(way.stamp_ns)) == ("map", "laser", 0)
    assert way.dropped == ((SECOND, DropReason.NO_TRANSFORM),)


def test_hits_are_kept_where_they_lie() -> None:
    tally = Tally(shown_every=1)
    tally.show(see(range(2, 3), x=5.0))
    (scan,) = tally.shown
    assert (scan.stamp_ns, scan.origin) == (2, (5.0, 1.0))
    np.testing.assert_allclose(scan.x, [7, 5, 3], atol=1e-6)
    np.testing.assert_allclose(scan.y, [1, 3, 1], atol=1e-6)


def test_a_sample_is_spread_over_all_scans_and_their_beams() -> None:
    tally = Tally(shown_every=10)
    for start in range(0, 4000, 250):
        tally.show(see(range(start, start + 250), beams=1200))
        tally.use(250, ReturnCounts())
    assert [scan.stamp_ns for scan in tally.shown] == list(range(0, 4000, 10))
    assert {len(scan.x) for scan in tally.shown} == {400}


def test_logs_add_up_and_a_second_reading_forgets_the_first() -> None:
    first = Tally(shown_every=1)
    first.show(see(range(1)))
    second = first.start_over()
    assert second.shown == []
    second.show(see(range(1, 2)))
    first.add(second)
    assert [scan.stamp_ns for scan in first.shown] == [0, 1]
