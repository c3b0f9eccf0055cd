"""Chains against poses worked out by hand, and against a slow and plain scalar reference."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.posing import POSED, DropReason
from occmap.posing.chain import Chain, find_holds, make_chain
from occmap.posing.frames import Edge, Source
from occmap.posing.tracks import TrackBuilder, angle_between, rotate_by, slerp, to_quaternions
from occmap.types import Float64, Pose
from tests.posing.scenes import SECOND, matrix_of, turned, yaw_of

BEFORE, AFTER = DropReason.BEFORE.code, DropReason.AFTER.code
GAP, TURN = DropReason.GAP.code, DropReason.TURN.code
Keyed = Sequence[tuple[float, Pose]]
"""Seconds and poses."""


def edge(parent: str, child: str, keyed: Keyed) -> Edge:
    return edge_ns(parent, child, [(round(seconds * SECOND), pose) for seconds, pose in keyed])


def edge_ns(parent: str, child: str, keyed: Sequence[tuple[int, Pose]]) -> Edge:
    builder = TrackBuilder()
    for stamp_ns, pose in keyed:
        builder.add(stamp_ns, stamp_ns, pose)
    track = builder.build()
    assert track is not None
    return Edge(parent, child, track, Source.TF)


def chain_of(*edges: Edge, max_gap_s: float | None = None) -> Chain:
    return make_chain(edges, max_gap_s)


def look_up(chain: Chain, *seconds: float) -> tuple[Float64, Float64, list[int]]:
    found = chain.at(np.array([round(t * SECOND) for t in seconds], np.int64))
    return found.position, found.rotation, found.status.tolist()


DRIVE = edge("odom", "base", [(0, turned(0)), (10, turned(90, x=10))])


def test_nothing_is_extrapolated() -> None:
    _, _, status = look_up(chain_of(DRIVE), -1e-9, 0, 10, 10 + 1e-9)
    assert status == [BEFORE, POSED, POSED, AFTER]


def test_nothing_is_interpolated_across_a_long_gap() -> None:
    driven = edge("odom", "base", [(t, turned(0, x=t)) for t in (0, 1, 4, 5)])
    _, _, status = look_up(chain_of(driven, max_gap_s=2.0), 0.5, 1, 1.5, 3.9, 4, 4.5)
    assert status == [POSED, POSED, GAP, GAP, POSED, POSED]


def test_a_gap_of_exactly_the_limit_is_bridged() -> None:
    chain = chain_of(edge("odom", "base", [(0, turned(0)), (2, turned(0, x=2))]), max_gap_s=2.0)
    assert look_up(chain, 1)[2] == [POSED]


def test_clouds_have_no_pose_in_a_turn_between_key_frames() -> None:
    """But straight on, within 0.3 s, and so near to a key frame that the robot hardly turned."""
    turns = (0, 10, 20, 21.9, 31.9)
    driven = edge("odom", "base", list(zip((0, 1, 1.3, 3.3, 6), map(turned, turns), strict=True)))
    stamp_ns = np.array([0, 20, 21, 500, 979, 980, 1150, 2000, 4000, 6000]) * (SECOND // 1000)
    turning = [POSED, POSED, TURN, TURN, TURN, POSED, POSED, POSED, TURN, POSED]
    chain = chain_of(driven, max_gap_s=2.0)
    assert chain.at(stamp_ns, in_clouds=True).status.tolist() == turning
    assert set(chain.at(stamp_ns).status.tolist()) == {POSED, GAP}
    assert not chain_of(driven).at(stamp_ns, in_clouds=True).status.any()


def test_a_correction_that_jumps_breaks_at_its_sample() -> None:
    """It may drift by 0.1 m and 0.05 rad, and by 0.05 m and 0.01 rad more in a second."""
    places = [turned(0), turned(0, x=0.19), turned(0, x=0.41), turned(3.9, x=0.41)]
    correction = edge(
        "map", "odom", [*zip((0, 2, 4, 6), places, strict=True), (7, turned(7.5, x=0.41))]
    )
    # Before 4 s by 0.22 m in 2 s, where 0.2 m may be, and before 7 s by 0.063 rad in 1 s, where
    # 0.06 may be.
    assert find_holds(correction.track).tolist() == [False, True, False, True, False]


def test_a_correction_that_is_recorded_the_other_way_round_holds_too() -> None:
    upward = edge("odom", "map", [(0, turned(0)), (10, turned(0, x=-5))])
    position, _, _ = look_up(chain_of(upward.invert(), DRIVE), 5)
    assert position.tolist() == [[5, 0, 0]]  # and not 7.5, halfway through the jump


@pytest.mark.parametrize(
    ("interval_s", "duration_s", "dense"),
    [(0.3, 0.1, True), (0.31, 0.1, False), (0.35, 0.4, True), (0.45, 0.4, False), (0, 9, False)],
)
def test_whether_poses_show_how_a_sensor_moved(
    interval_s: float, duration_s: float, dense: bool
) -> None:
    chain = Chain((), (), interval_s)
    assert chain.is_dense(np.array([duration_s])).tolist() == [dense]


def test_a_step_recorded_the_other_way_round_is_inverted() -> None:
    upward = edge("base", "map", [(0, turned(90, x=3)), (1, turned(90, x=5))])
    chain = make_chain([upward.invert()], None)
    position, rotation, _ = look_up(chain, 0.5)
    # The map lies at (4, 0) in the base, turned left by 90: in the map the base is at (0, 4).
    np.testing.assert_allclose(position, [[0, 4, 0]], atol=1e-12)
    np.testing.assert_allclose(yaw_of(rotation), [-math.pi / 2])


def test_a_fixed_transform_sent_late_limits_nothing() -> None:
    mount = edge("base", "laser", [(4, turned(0, y=1)), (5, turned(0, y=1))])
    position, _, status = look_up(chain_of(DRIVE, mount), 0, 10)
    assert status == [POSED] * 2
    np.testing.assert_allclose(position[:, :2], [[0, 1], [9, 0]], atol=1e-12)


def test_where_nothing_moves_the_most_sampled_edge_says_when_the_robot_was_seen() -> None:
    standing = edge("odom", "base", [(t, turned(0)) for t in range(5)])
    mount = edge("base", "laser", [(1, turned(0)), (2, turned(0))])
    _, _, status = look_up(chain_of(standing, mount), -1, 0, 4, 5)
    assert status == [BEFORE, POSED, POSED, AFTER]


def odometry(seconds: int) -> Edge:
    return edge("odom", "base", [(t, turned(0, x=t)) for t in range(seconds + 1)])


def test_a_correction_that_jumps_holds_until_the_jump() -> None:
    correction = edge("map", "odom", [(t, turned(0, y=2.0 * (t >= 2))) for t in range(5)])
    position, _, _ = look_up(chain_of(correction, odometry(4)), 1.0, 1.5, 1.999, 2.0, 2.5)
    np.testing.assert_allclose(position[:, 1], [0, 0, 0, 2, 2], atol=1e-12)
    np.testing.assert_allclose(position[:, 0], [1.0, 1.5, 1.999, 2.0, 2.5], atol=1e-12)


def test_a_correction_that_creeps_is_interpolated() -> None:
    correction = edge("map", "odom", [(t, turned(0, y=0.05 * t)) for t in range(5)])
    position, _, _ = look_up(chain_of(correction, odometry(4)), 1.5)
    np.testing.assert_allclose(position, [[1.5, 0.075, 0]], atol=1e-12)


def test_map_to_odom_that_carries_all_the_motion_is_interpolated() -> None:
    """SLAM without odometry moves map -> odom by metres a second, and nothing moves below."""
    chain = chain_of(
        edge("map", "odom", [(t, turned(0, x=3 * t)) for t in range(3)]),
        edge("odom", "base", [(0, turned(0))]),
    )
    np.testing.assert_allclose(look_up(chain, 0.5)[0], [[1.5, 0, 0]], atol=1e-12)


def test_a_body_with_a_turning_laser_is_no_correction() -> None:
    spinning = edge("base", "laser", [(t, turned(60 * t)) for t in range(5)])
    fast = edge("odom", "base", [(t, turned(0, x=5 * t)) for t in range(5)])
    np.testing.assert_allclose(look_up(chain_of(fast, spinning), 0.5)[0], [[2.5, 0, 0]], atol=1e-12)


def test_the_interval_is_that_of_the_drive_not_of_its_correction() -> None:
    correction = edge("map", "odom", [(0, turned(0)), (4, turned(0, y=1))])
    chain = chain_of(correction, edge("odom", "base", [(t / 2, turned(0, x=t)) for t in range(9)]))
    assert chain.interval_s == 0.5
    assert chain.is_dense(np.array([0.6, 0.4])).tolist() == [True, False]


# The reference: one stamp at a time, Python numbers, 4x4 matrices; slerp by its axis and angle.


def multiply(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float, float]:
    along_a, along_b = np.array(a[:3]), np.array(b[:3])
    x, y, z = a[3] * along_b + b[3] * along_a + np.cross(along_a, along_b)
    return x, y, z, a[3] * b[3] - along_a @ along_b


def turn_part(start: Sequence[float], end: Sequence[float], share: float) -> Sequence[float]:
    x, y, z, w = multiply((-start[0], -start[1], -start[2], start[3]), end)
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0:
        return start
    half = math.atan2(length, w) * share
    scale = math.sin(half) / length
    return multiply(start, (x * scale, y * scale, z * scale, math.cos(half)))


def transform(pose: Sequence[float]) -> Float64:
    x, y, z = pose[:3]
    columns = []
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        qx, qy, qz, qw = pose[3:]
        turned_axis = multiply(multiply((qx, qy, qz, qw), (*axis, 0.0)), (-qx, -qy, -qz, qw))
        columns.append([*turned_axis[:3], 0.0])
    return np.array([*columns, [x, y, z, 1.0]]).T


def reference(keyed: Sequence[tuple[int, Pose]], stamp_ns: int) -> Float64 | None:
    if len(keyed) == 1:
        return transform(keyed[0][1])
    for (t0, a), (t1, b) in itertools.pairwise(keyed):
        if t0 <= stamp_ns <= t1:
            share = (stamp_ns - t0) / (t1 - t0)
            position = [p + share * (q - p) for p, q in zip(a[:3], b[:3], strict=True)]
            return transform([*position, *turn_part(a[3:], b[3:], share)])
    return None


def draw_track(rng: np.random.Generator, samples: int) -> list[tuple[int, Pose]]:
    """Poses at some of 21 stamps, a tenth of a second apart."""
    tenths = np.sort(rng.choice(21, samples, replace=False)).tolist()
    places, angles = rng.uniform(-50, 50, (samples, 3)), rng.uniform(-3, 3, (samples, 3))
    poses = [Pose.from_xyzrpy(*each) for each in zip(places.tolist(), angles.tolist(), strict=True)]
    return [(10**18 + 10**8 * t, pose) for t, pose in zip(tenths, poses, strict=True)]


@pytest.mark.parametrize("seed", range(40))
def test_chains_equal_the_slow_reference(seed: int) -> None:
    """Two steps that move, and two below them that never do."""
    rng = np.random.default_rng(seed)
    tracks = [draw_track(rng, samples) for samples in (4, 6, 1, 1)]
    frames = itertools.pairwise(["map", "body", "mast", "head", "laser"])
    edges = [edge_ns(*names, keyed) for names, keyed in zip(frames, tracks, strict=True)]
    tenths, others = 10**8 * rng.integers(-1, 22, 4), rng.integers(-(10**8), 21 * 10**8, 8)
    stamps = 10**18 + np.append(tenths, others)
    found = chain_of(*edges).at(stamps)
    for i, stamp_ns in enumerate(stamps.tolist()):
        steps = [reference(keyed, stamp_ns) for keyed in tracks]
        known = [step for step in steps if step is not None]
        assert (found.status[i] == POSED) == (len(known) == 4)
        if len(known) == 4:
            expected = known[0] @ known[1] @ known[2] @ known[3]
            np.testing.assert_allclose(found.position[i], expected[:3, 3], atol=1e-9)
            np.testing.assert_allclose(found.rotation[i], expected[:3, :3], atol=1e-9)


ANGLES = st.floats(-math.pi, math.pi)


def quaternion(roll: float, pitch: float, yaw: float) -> Float64:
    return np.array([Pose.from_xyzrpy((0, 0, 0), (roll, pitch, yaw))[3:]])


@settings(max_examples=50)
@given(ANGLES, ANGLES, ANGLES)
def test_a_quaternion_gives_the_matrix_of_its_angles(roll: float, pitch: float, yaw: float) -> None:
    found = rotate_by(quaternion(roll, pitch, yaw))[0]
    np.testing.assert_allclose(found, matrix_of(roll, pitch, yaw), atol=1e-12)


@settings(max_examples=50)
@given(ANGLES, ANGLES, st.floats(0, 1))
def test_q_and_minus_q_are_one_rotation(first: float, second: float, fraction: float) -> None:
    start, end = quaternion(first, 0.2, 0.1), quaternion(0.3, 0.2, second)
    share = np.array([fraction])
    one, other = slerp(start, end, share), slerp(start, -end, share)
    # Half a turn apart, either way round is the shorter one.
    if abs(float((start * end).sum())) > 1e-9:
        np.testing.assert_allclose(rotate_by(one), rotate_by(other), atol=1e-9)


@pytest.mark.parametrize("step", [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-3])
def test_tiny_turns_are_exact(step: float) -> None:
    start, end = quaternion(0.1, 0.2, 1.0), quaternion(0.1, 0.2, 1.0 + step)
    found = slerp(start, end, np.array([0.25]))
    np.testing.assert_allclose(found, quaternion(0.1, 0.2, 1.0 + step / 4), atol=1e-15)
    assert math.isclose(float(angle_between(start, end)[0]), step, rel_tol=1e-3, abs_tol=1e-15)


def test_quaternions_of_matrices_are_those_the_matrices_were_made_of() -> None:
    half = np.sqrt(0.5)
    given = np.random.default_rng(3).normal(size=(200, 4))
    half_turns = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [half, -half, 0, 0]]
    given = np.concatenate([given, half_turns, [[0.6, -0.8, 1e-9, 1e-9], [1e-9, 0, -1, 1e-9]]])
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    found = to_quaternions(rotate_by(given))
    assert (found[:, 3] >= 0).all()
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->i", found, given)), 1, atol=1e-12)
    np.testing.assert_allclose(rotate_by(found), rotate_by(given), atol=1e-12)


def test_a_matrix_that_a_file_rounds_gives_its_rotation_as_exactly() -> None:
    """KITTI writes seven digits."""
    turns = [quaternion(0.3, -1.2, yaw) for yaw in np.linspace(-3, 3, 99).tolist()]
    given = rotate_by(np.concatenate(turns))
    rounded = np.array([float(f"{value:.6e}") for value in given.ravel()]).reshape(given.shape)
    np.testing.assert_allclose(rotate_by(to_quaternions(rounded)), given, atol=5e-7)
