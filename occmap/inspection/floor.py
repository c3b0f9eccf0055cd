"""The floor that clouds see: whether it says that a mount, or the poses' up, is wrong."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping

import numpy as np

from occmap.cells import Ground
from occmap.choices.values import format_mount, format_static
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.chain import Transforms
from occmap.posing.options import Concern
from occmap.posing.rotations import to_quaternions
from occmap.readers import Log
from occmap.scans.logs import count_scans
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally
from occmap.types import IDENTITY, Float64, Pose, PosedScans

SAMPLED = 60
"""Clouds of a log that are looked at, about"""
LEAST_TILT_DEG = 0.45
"""Poses are off by less, at times."""
LEAST_SLOPE_DEG = 1.0
MOST_TILT_DEG = 10.0
"""More is no small error, and linear no more."""


def list_floor_concerns(
    log: Log, poser: Poser, options: BuildOptions, ground: Ground
) -> Iterator[tuple[str, Concern]]:
    """List what the floor says against mounts and poses, with the topics of the clouds."""
    from occmap.clouds.ground import draw  # noqa: PLC0415  late: it brings numba
    from occmap.clouds.tilts import measure_tilts  # noqa: PLC0415

    share = SAMPLED / max(count_scans(log, options.selection.topics), 1)
    seen: defaultdict[str, list[PosedScans]] = defaultdict(list)
    for _, posed, _ in open_drive(log, options).read(Tally(), lambda ns, _: draw(ns) < share):
        if posed is not None:
            seen[posed.batch.topic].append(posed)
    for topic, clouds in sorted(seen.items()):
        tilts = measure_tilts(clouds, ground)
        turn = None if tilts is None else tilts.sensor if tilts.is_mount else tilts.upright
        angle = 0.0 if turn is None else math.degrees(float(np.linalg.norm(turn)))
        if tilts is None or not LEAST_TILT_DEG < angle < MOST_TILT_DEG:
            continue
        mended = mend_mount(poser, clouds[0].batch.frame, options, tilts.sensor)
        if tilts.is_mount and mended:
            found = f"the floor is tilted by {angle:.1f} deg in the sensor's own frame, wherever"
            yield topic, Concern(f"{found} it goes: its mount is wrong by that", mended)
            continue
        # What the ground is made of was turned likewise: it hides about half of the error.
        margin = options.clouds.range_margin + 2 * math.radians(angle)
        found = f"the floor is tilted by about {2 * angle:.1f} deg against the poses"
        why = "their up is wrong, and floor far away would stand up"
        yield topic, Concern(f"{found}: {why}", {"range_margin": f"{margin:.3f}"})


def tell_slope(ground: Ground) -> Iterator[str]:
    """Say if most of the floor is tilted in the map."""
    from occmap.clouds.tilts import measure_slope  # noqa: PLC0415  late: it brings numba

    angle = math.degrees(math.atan(math.hypot(*measure_slope(ground))))
    if angle > LEAST_SLOPE_DEG:
        yield (
            f"most of the floor is tilted by {angle:.1f} deg in the map: heights count from the "
            "floor, so that obstacles are right"
        )


def mend_mount(poser: Poser, frame: str, options: BuildOptions, turn: Float64) -> Mapping[str, str]:
    """Give the option for a mount that is turned by a small rotation (3,), if it is fixed."""
    given, chain = options.posing.sensor_pose, poser.chains.get(frame)
    step = chain.steps[-1] if chain and chain.steps else None
    half_x, half_y, half_z = (turn / 2).tolist()
    small = Pose(0.0, 0.0, 0.0, half_x, half_y, half_z, 1.0)
    if given is not None or chain is None:
        return {"sensor_pose": format_mount(compose(given or IDENTITY, small))}
    if step is None or step.inverted or not step.track.static:
        return {}
    mount = Pose(*step.track.position[0].tolist(), *step.track.quaternion[0].tolist())
    return {"static_transforms": format_static(step.parent, step.child, compose(mount, small))}


def compose(outer: Pose, inner: Pose) -> Pose:
    """The pose `inner`, which is given in the frame `outer`, in the frame of `outer`."""
    found = Transforms.fixed(outer).then(Transforms.fixed(inner))
    return Pose(*found.position[0].tolist(), *to_quaternions(found.rotation)[0].tolist())
