"""De-skewing: a laser turns while it measures, so each beam of a scan gets a pose of its own.

A scan that is not de-skewed has one pose, at its stamp.
"""

import numpy as np

from occmap.posing.chain import Chain, Transforms
from occmap.posing.options import Deskew
from occmap.types import Bool, Int64, PosedScans, ScanBatch

MAX_TURN_S = 60.0
"""A scan that is said to take longer has a wrong time_increment."""
MAX_AUTO_TURN_S = 1.0
"""The slowest laser that is de-skewed unasked; some drivers write milliseconds for seconds."""
MOMENTS = 33
"""Poses looked up for one de-skewed scan; see `place_beams` for how close that is."""


def choose_deskewed(batch: ScanBatch, deskew: Deskew, chain: Chain) -> tuple[Bool, list[str]]:
    """Choose the scans (S) whose beams get poses of their own, and say what was decided.

    AUTO asks for a believable scan time and for poses dense enough to show the motion in it.
    """
    if deskew is Deskew.OFF:
        return np.zeros(len(batch.stamp_ns), np.bool_), []
    with np.errstate(invalid="ignore", over="ignore"):  # a log may state any number
        duration_s = np.abs(batch.time_increment) * (batch.ranges.shape[1] - 1)
    is_auto = deskew is Deskew.AUTO
    longest_s = MAX_AUTO_TURN_S if is_auto else MAX_TURN_S
    chosen: Bool = (duration_s > 0) & (duration_s <= longest_s)
    notes = []
    if is_auto:
        chosen &= chain.is_dense(duration_s)
    elif not chosen.all():
        notes.append(
            f"scans of {batch.frame!r} that state no believable time between beams are not "
            "de-skewed"
        )
    if chosen.any():
        notes.append(f"de-skewed: each beam of {batch.frame!r} has a pose of its own")
    return chosen, notes


def list_moments(batch: ScanBatch) -> Int64:
    """List the moments (S, K) of scans at which poses are looked up, from their stamps on (ns)."""
    beams = batch.ranges.shape[1]
    seconds = np.linspace(0, (beams - 1) * batch.time_increment, min(beams, MOMENTS), axis=1)
    return np.round(seconds * 1e9).astype(np.int64)


def place_beams(batch: ScanBatch, posed: Bool, found: Transforms) -> PosedScans:
    """Keep the scans (S) that are posed; where there are K moments of each, each beam has a pose.

    Between two moments positions and matrices are interpolated linearly. At 720 degrees a second
    and ten scans a second a matrix is then off by 2e-4: 2 mm at ten metres.
    """
    scans = len(posed)
    position = found.position.reshape(scans, -1, 3)[posed]
    rotation = found.rotation.reshape(scans, -1, 9)[posed]
    batch, moments = batch.take(posed), position.shape[1]
    if moments == 1:
        return PosedScans(batch, position[:, 0], rotation.reshape(-1, 3, 3))
    at = np.linspace(0, moments - 1, batch.ranges.shape[1])
    share = np.maximum(0, 1 - np.abs(at[:, None] - np.arange(moments)))
    rotation = share @ rotation
    return PosedScans(batch, share @ position, rotation.reshape(*rotation.shape[:2], 3, 3))
