import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.posing.tracks import angle_between, rotate_by, slerp, to_quaternions
from occmap.types import Float64, Pose
from tests.posing.scenes import matrix_of

ANGLES = st.floats(-math.pi, math.pi)


def quaternion(roll: float, pitch: float, yaw: float) -> Float64:
    return np.array([Pose.from_xyzrpy((0, 0, 0), (roll, pitch, yaw))[3:]])


@settings(max_examples=50)
@given(ANGLES, ANGLES, ANGLES)
def test_a_quaternion_gives_the_matrix_of_its_angles(roll: float, pitch: float, yaw: float) -> None:
    found = rotate_by(quaternion(roll, pitch, yaw))[0]
    np.testing.assert_allclose(found, matrix_of(roll, pitch, yaw), atol=1e-12)


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 1.0])
def test_the_turn_takes_the_short_way_past_180_degrees(fraction: float) -> None:
    start, end = math.radians(170), math.radians(-170)
    found = slerp(quaternion(0, 0, start), quaternion(0, 0, end), np.array([fraction]))
    yaw = math.radians(170 + 20 * fraction)
    np.testing.assert_allclose(rotate_by(found)[0], matrix_of(yaw=yaw), atol=1e-12)


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


@settings(max_examples=50)
@given(ANGLES, ANGLES, ANGLES, st.floats(0, 1))
def test_slerp_turns_at_constant_rate_and_keeps_length(
    roll: float, pitch: float, yaw: float, fraction: float
) -> None:
    start, end = quaternion(0, 0, 0), quaternion(roll, pitch, yaw)
    found = slerp(start, end, np.array([fraction]))
    assert math.isclose(float(np.linalg.norm(found)), 1, abs_tol=1e-12)
    whole, part = angle_between(start, end)[0], angle_between(start, found)[0]
    assert math.isclose(part, fraction * whole, abs_tol=1e-7)


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
