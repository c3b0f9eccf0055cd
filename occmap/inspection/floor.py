"""The floor that clouds see: whether it says that a mount, or the poses' up, is wrong."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occmap.cells import Ground
from occmap.choices.values import format_mount, format_static
from occmap.clouds.mounting import find_seat
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.chain import Transforms
from occmap.posing.options import Concern
from occmap.posing.rotations import to_quaternions
from occmap.readers import Log
from occmap.scans.logs import count_scans
from occmap.scans.mounts import mount_scans, open_drive
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
    log: Log, poser: Poser, options: BuildOptions, ground: Ground | None
) -> Iterator[tuple[str, Concern]]:
    """List what the floor says against mounts and poses, with the topics of the clouds.

    Parameters
    ----------
    ground
        None where none was found.
    """
    from occmap.clouds.ground import draw  # noqa: PLC0415  late: it brings numba
    from occmap.clouds.tilts import measure_tilts  # noqa: PLC0415

    share = SAMPLED / max(count_scans(log, options.selection.topics), 1)
    seen: defaultdict[str, list[PosedScans]] = defaultdict(list)
    for _, posed, _ in open_drive(log, options).read(Tally(), lambda ns, _: draw(ns) < share):
        if posed is not None:
            seen[posed.batch.topic].append(posed)
    for topic, clouds in sorted(seen.items()):
        mount = find_mount(poser, clouds[0].batch.frame, options)
        if concern := find_misplaced(mount, clouds):
            yield topic, concern
            continue
        tilts = None if ground is None else measure_tilts(clouds, ground)
        turn = None if tilts is None else tilts.sensor if tilts.is_mount else tilts.upright
        angle = 0.0 if turn is None else math.degrees(float(np.linalg.norm(turn)))
        if tilts is None or not LEAST_TILT_DEG < angle < MOST_TILT_DEG:
            continue
        if tilts.is_mount and mount:
            half_x, half_y, half_z = (tilts.sensor / 2).tolist()
            small = Pose(0.0, 0.0, 0.0, half_x, half_y, half_z, 1.0)
            mended = mount.write(compose(mount.pose, small))
            found = f"the floor is tilted by {angle:.1f} deg in the sensor's own frame, wherever"
            yield topic, Concern(f"{found} it goes: its mount is wrong by that", mended)
            continue
        # What the ground is made of was turned likewise: it hides about half of the error.
        margin = options.clouds.range_margin + 2 * math.radians(angle)
        found = f"the floor is tilted by about {2 * angle:.1f} deg against the poses"
        why = "their up is wrong, and floor far away would stand up"
        yield topic, Concern(f"{found}: {why}", {"range_margin": f"{margin:.3f}"})


def find_misplaced(mount: "Mount | None", clouds: Sequence[PosedScans]) -> Concern | None:
    """Find out if a sensor sits in another way than its poses say: by far, as in another frame."""
    if mount is None:
        return None
    on_body = [mount_scans(each, Transforms.fixed(mount.pose).invert().first) for each in clouds]
    seat = find_seat(on_body)
    if seat is None:
        return None
    up = Transforms.fixed(seat.mount).rotation[0, 2]
    angle, of_body = find_angle(clouds, up), find_angle(on_body, np.array([0.0, 0.0, 1.0]))
    if angle < MOST_TILT_DEG or of_body > MOST_TILT_DEG:
        return None
    mended = mount.write(Pose(*mount.pose[:3], *seat.mount[3:]))
    given = " ".join(f"`{name}=({value})`" for name, value in mended.items())
    found = f"the floor stands askew by {angle:.0f} deg in the map, wherever the sensor goes"
    return Concern(f"{found}: its mount is another; {given} lays it flat", mended)


def find_angle(scans: Sequence[PosedScans], axis: Float64) -> float:
    """Find how far from upright an axis of the sensor (3,) is in most scans (degrees)."""
    rise = np.concatenate([each.at_first_beam[1][:, 2] @ axis for each in scans])
    return math.degrees(math.acos(float(np.clip(np.median(rise), -1, 1))))


def tell_slope(ground: Ground) -> Iterator[str]:
    """Say if most of the floor is tilted in the map."""
    from occmap.clouds.tilts import measure_slope  # noqa: PLC0415  late: it brings numba

    angle = math.degrees(math.atan(math.hypot(*measure_slope(ground))))
    if angle > LEAST_SLOPE_DEG:
        yield (
            f"most of the floor is tilted by {angle:.1f} deg in the map: heights count from the "
            "floor, so that obstacles are right"
        )


class Mount(NamedTuple):
    """How a sensor is mounted, and how another mount is given in its place."""

    pose: Pose
    write: Callable[[Pose], Mapping[str, str]]
    """Gives the option for a mount"""


def find_mount(poser: Poser, frame: str, options: BuildOptions) -> Mount | None:
    """Find the mount of a sensor; None where it is not fixed."""
    given, chain = options.posing.sensor_pose, poser.chains.get(frame)
    # None, or of a frame that tf does not know: the poses are the sensor's own.
    if given is not None or chain is None or frame not in poser.sources.tree:
        return Mount(given or IDENTITY, lambda pose: {"sensor_pose": format_mount(pose)})
    step = chain.steps[-1] if chain.steps else None
    if step is None or step.inverted or not step.track.static:
        return None
    pose = Pose(*step.track.position[0].tolist(), *step.track.quaternion[0].tolist())
    frames = step.parent, step.child
    return Mount(pose, lambda pose: {"static_transforms": format_static(*frames, pose)})


def compose(outer: Pose, inner: Pose) -> Pose:
    """The pose `inner`, which is given in the frame `outer`, in the frame of `outer`."""
    found = Transforms.fixed(outer).then(Transforms.fixed(inner))
    return Pose(*found.position[0].tolist(), *to_quaternions(found.rotation)[0].tolist())
