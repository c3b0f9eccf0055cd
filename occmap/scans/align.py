"""The turn that brings the walls of a map along its axes.

nav2 and others ignore the yaw of the origin in a map's YAML, so a building that lies askew in its
map stays so. Turning the poses before anything is traced costs no cell its sharpness.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from occmap.options import BuildOptions
from occmap.readers import open_log
from occmap.scans.mounts import open_drive
from occmap.sensor import interpret
from occmap.types import Float64, Kind, Paths, Rays

GAPS = (2, 4, 8, 16, 32)
"""A chord of a wall joins the ends of two beams that are this many beams apart."""
CHORD_M = 0.5
"""Chords are from this long (m) to twice as long: shorter ones show the noise of ranges."""
STRAIGHT_M = 0.02
"""Where a wall is straight, the beam in the middle ends at most this far from the chord (m)."""
BINS = 360
"""Bins of the histogram over a quarter turn"""
BLUR = 9
"""Neighbouring bins that are added up, so that noise does not split a direction"""
NARROW_DEG = (5.0, 3.0)
"""Only chords this near to the direction found before count in the next mean."""
COMMON_SHARE = 1 / 3
"""In a building, at least this share of the length of all chords lies within 3 degrees of one
direction. Logs of buildings have 0.5 to 0.74; walls in all directions would have a fifteenth."""
DIGITS = 2
"""The angle is rounded to hundredths of a degree, so that a map can be made again by hand."""


def sample_rays(paths: Paths, options: BuildOptions) -> Iterator[Rays]:
    """Interpret some scans of all logs, spread evenly over each.

    Raises
    ------
    OccmapError
        A log cannot be read, or has no scans or no poses.
    """
    for path in paths:
        for part in open_drive(open_log(path, options.reading), options).sample():
            yield interpret(part, options.returns)[0]


def settle_align(paths: Paths, options: BuildOptions) -> tuple[BuildOptions, list[str]]:
    """Find the turn of a map where the user leaves it to the scans; a note says if they show none.

    Raises
    ------
    OccmapError
        A log cannot be read, or has no scans or no poses.
    """
    if options.posing.align is not None:
        return options, []
    chords = [list_chords(rays) for rays in sample_rays(paths, options)]
    turn, share = find_turn(np.concatenate([np.zeros((0, 2)), *chords]))
    notes = []
    if share < COMMON_SHARE:
        turn = 0.0
        common = f"{share:.0%} of the length of walls lies within 3 degrees of one direction"
        found = common if any(map(len, chords)) else "no beams of laser scans show a straight wall"
        notes.append(f"{found}, so the map is not turned; give an angle with `align=DEG`")
    return replace(options, posing=replace(options.posing, align=turn)), notes


def list_chords(rays: Rays) -> Float64:
    """List straight pieces of walls that single scans see, as vectors (N, 2) in metres."""
    hit, end = rays.kind == Kind.HIT, rays.end
    chords = [np.zeros((0, 2))]
    for gap in (gap for gap in GAPS if gap < hit.shape[1]):
        half = gap // 2
        start, middle, stop = end[:, :-gap], end[:, half:-half], end[:, gap:]
        chord, bow = stop - start, middle - (start + stop) / 2
        length = np.hypot(chord[..., 0], chord[..., 1])
        across = np.abs(bow[..., 0] * chord[..., 1] - bow[..., 1] * chord[..., 0])
        seen = hit[:, :-gap] & hit[:, half:-half] & hit[:, gap:]
        long = (length >= CHORD_M) & (length < 2 * CHORD_M)
        chords.append(chord[seen & long & (across < STRAIGHT_M * length)])
    return np.concatenate(chords)


def find_turn(chords: Float64) -> tuple[float, float]:
    """Find the smallest turn by which walls run along the axes.

    Directions count modulo a quarter turn and by length. The fullest part of a histogram is a first
    estimate, which the mean of the directions near it refines. The mean is taken of four times the
    angles, so that angles a quarter turn apart are the same (Mardia and Jupp 2000, directional
    statistics).

    Parameters
    ----------
    chords
        (N, 2) pieces of walls.

    Returns
    -------
    turn, share
        Degrees, counter-clockwise, from -45 to 45; and how much of the length of all chords lies
        within 3 degrees of the direction found.
    """
    length = np.hypot(chords[:, 0], chords[:, 1])
    if not length.any():
        return 0.0, 0.0
    angle = np.degrees(np.arctan2(chords[:, 1], chords[:, 0])) % 90
    bins, _ = np.histogram(angle, BINS, (0, 90), weights=length)
    sums = np.convolve(np.pad(bins, BLUR // 2, "wrap"), np.ones(BLUR), "valid")
    wall = (float(np.argmax(sums)) + 0.5) * 90 / BINS
    for narrow in NARROW_DEG:
        off = wrap(angle - wall)
        near = np.abs(off) < narrow
        mean = np.sum(length[near] * np.exp(4j * np.radians(off[near])))
        wall += float(np.degrees(np.angle(mean))) / 4
    share = float(length[np.abs(wrap(angle - wall)) < NARROW_DEG[-1]].sum() / length.sum())
    return round(float(wrap(np.array(-wall))), DIGITS) + 0.0, share


def wrap(angle: Float64) -> Float64:
    """Reduce angles by quarter turns to -45 to 45 degrees."""
    return np.asarray((angle + 45) % 90 - 45)
