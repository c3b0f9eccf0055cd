"""Where the poses of a log come from, what is missing, and which option would mend it.

The floor that clouds see says whether a mount, or the poses' up, is wrong.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import TypeAlias

import numpy as np

from occmap.cells import Box, CellBox, Ground
from occmap.choices import format_mount, list_values, mark_options, take
from occmap.clouds.mounting import find_seat, measure_tilts
from occmap.errors import MapError
from occmap.evidence import count_steady, list_contradictions
from occmap.grid import Lattice
from occmap.inspection.findings import Coverage, MountFindings, PoseFindings, ScanFindings
from occmap.inspection.survey import TopicSurvey
from occmap.options import OPTIONS, BuildOptions
from occmap.posing import POSED, Concern, Deskew, Doubt, Stamps
from occmap.posing.attach import Poser
from occmap.posing.chain import Chain, Transforms, place_logs
from occmap.posing.sources import Sources
from occmap.readers import Role
from occmap.report import count
from occmap.report.results import DOUBTFUL_AGREEMENT, LEAST_AGREEMENT
from occmap.scans import Keep, estimate_agreement, make_engine, mounts
from occmap.scans.logs import read_poser
from occmap.scans.mounts import PosePlan
from occmap.scans.stream import Drive
from occmap.scans.tally import Tally
from occmap.types import IDENTITY, Float64, Pose, PosedScans, Update

Clouds: TypeAlias = Sequence[PosedScans]
"""A sample of the clouds of a topic"""

WELL_POSED = 0.9
"""If a smaller share of the scans has poses, the other of the two times is tried."""
DRIFT_S = 0.1
"""Where stamps drift by more against the record times, the other of the two is tried, too (s)."""
BETTER = 0.05
"""So many more of the hits agree by an option that suits the scans clearly better."""
OTHER_POSES = {"poses", "map_frame", "stamps"}
"""Options that replace the poses, and with them what is wrong with those"""
MOST_TRIED = 6
"""So many options are tried for a topic: each takes a map of the sample"""


def find_better(drive: Drive, topic: TopicSurvey, found: ScanFindings) -> Concern | None:
    """Find the option by which the scans of a topic fit each other best, if clearly better.

    Each is tried alone, on the sample of scans. Scans without a pose count as ones that fit none.

    Parameters
    ----------
    found
        What is known of the topic so far.
    """
    given = list_values(replace(drive.options, posing=drive.poser.options))
    usual = 1.0 if found.agreement is None else found.agreement
    posed = topic.posed / max(found.kept, 1) if topic.stated else share_posed(drive.poser, topic)
    most, better = usual * posed + BETTER, None
    others = list(islice(list_others(drive.poser, topic, found), MOST_TRIED))
    if found.misfit and "sensor_pose" in found.misfit.remedy:
        others[:0] = found.misfit.remedy.items()
    for name, value in others:
        changed = take(BuildOptions, given | {name: OPTIONS[name].read(value)})
        poser, parts = pose_sample(drive, topic, changed)
        agreement = estimate_agreement(parts, changed)
        share = posed if topic.stated else share_posed(poser, topic)
        if agreement is not None and agreement < LEAST_AGREEMENT <= (found.agreement or 0.0):
            continue  # poses that do not fit are no gain, however many
        if (fit := share * (usual if agreement is None else agreement)) > most:
            most, better = fit, tell_better(found.agreement, agreement, {name: value})
    # Of a mount it is told in any case that it is wrong.
    return None if better and "sensor_pose" in better.remedy else better


def tell_better(usual: float | None, share: float | None, remedy: Mapping[str, str]) -> Concern:
    """Say how much better the scans of a topic fit each other with an option.

    Parameters
    ----------
    usual, share
        Of the hits of a sample those that agree without it, and with it; None where these make no
        map.
    """
    if usual is None or (share or 0) <= usual + BETTER:
        return Concern(f"more scans have a pose with {mark_options(remedy)}", remedy)
    found = f"{usual:.0%} of the hits of a sample of scans lie in occupied cells"
    return Concern(f"{found}, and {share:.0%} with {mark_options(remedy)}", remedy)


def list_others(poser: Poser, topic: TopicSurvey, found: ScanFindings) -> Iterator[tuple[str, str]]:
    """List options, with their values, that may suit the scans of a topic better."""
    options, times = poser.options, found.times
    way = poser.chains.get(next(iter(topic.frames)))
    if topic.stated or way is None or not found.kept:
        return
    if way.interval_s > (options.max_pose_gap_s or math.inf):
        yield "max_pose_gap_s", f"{2 * way.interval_s:.3g}"
    share = found.agreement
    is_poor = topic.posed == 0 or (share is not None and share < DOUBTFUL_AGREEMENT)
    is_timed = abs(times.drift_s) <= DRIFT_S and not times.jumps_back
    if is_poor or not is_timed or topic.posed < WELL_POSED * found.kept:
        yield from (("stamps", each.value) for each in Stamps if each is not options.stamps)
    if times.time_increment_s and options.deskew is not Deskew.ON:
        yield "deskew", Deskew.ON.value
    if is_poor:
        yield from list_other_poses(poser.sources, way)


def list_other_poses(sources: Sources, way: Chain) -> Iterator[tuple[str, str]]:
    """List options that pose scans by what a log holds beside the way that was chosen."""
    used = {"", *(step.topic for step in way.steps)}
    for edge in sources.pose_topics:
        if edge.track.moves and edge.topic not in used:
            yield "poses", edge.topic
    if sources.trajectory:
        return
    for body in (each for each in sources.tree.bodies if each in way.frames):
        above = sources.tree.list_ancestors(body)[1:]
        yield from (("map_frame", frame) for frame in above if frame != way.frames[0])


def pose_sample(
    drive: Drive, topic: TopicSurvey, options: BuildOptions
) -> tuple[Poser, list[PosedScans]]:
    """Pose the sample of a topic by other options; for other scans, the log is read once more."""
    chosen, usual = options.posing, drive.poser.options
    if chosen.stamps != usual.stamps or chosen.max_pose_gap_s != usual.max_pose_gap_s:
        one = (topic.stream.topic,)
        options = replace(options, selection=replace(options.selection, topics=one))
        again = Drive(drive.log, read_poser(drive.log, options.posing, one), options)
        return again.poser, again.sample()
    sources = drive.poser.sources
    named = (edge for edge in sources.pose_topics if edge.topic == options.posing.poses)
    sources = replace(sources, trajectory=next(named, sources.trajectory))
    poser = Poser(sources, options.posing)
    return poser, pose_again(topic, poser)


def pose_again(topic: TopicSurvey, poser: Poser) -> list[PosedScans]:
    """Pose the sample of a topic by other poses."""
    return [posed for part in topic.sample.parts for posed in poser.attach(part.batch)]


def share_posed(poser: Poser, topic: TopicSurvey) -> float:
    """Find the share of the scans of a topic that have a pose."""
    poser.find_chains(topic.frames)
    if (chain := poser.chains.get(next(iter(topic.frames)))) is None:
        return 0.0
    stamps = poser.options.stamps.choose(topic.stamps.header_ns, topic.stamps.record_ns)
    stamp_ns = np.array(stamps) + round(poser.options.time_offset_s * 1e9)
    in_clouds = topic.stream.role is Role.CLOUD
    return float(np.mean(chain.at(stamp_ns, in_clouds).status == POSED))


def list_coverage(sources: Sources) -> list[Coverage]:
    """Describe the edges of the tree, by name, and then the poses of bodies that are in no edge."""
    chosen = [sources.trajectory] if sources.trajectory else []
    return [
        Coverage(
            parent=edge.parent,
            child=edge.child,
            source=edge.source,
            topic=edge.topic,
            samples=len(edge.track),
            static=edge.track.static,
            moves=edge.track.moves,
            start_ns=int(edge.track.stamp_ns[0]),
            end_ns=int(edge.track.stamp_ns[-1]),
            largest_gap_s=float(edge.track.interval_s.max(initial=0)),
            largest_step_m=float(edge.track.step_m.max(initial=0)),
            largest_step_rad=float(edge.track.step_rad.max(initial=0)),
        )
        for edge in dict.fromkeys([*sources.tree.edges, *chosen, *sources.pose_topics])
    ]


EQUATOR_M, FLATNESS = 6_378_137.0, 0.00669437999014
"""Half the width of the Earth, and the square of its eccentricity (WGS 84)"""
FEWEST_FIXES = 10
OUTLIER = 4.0
"""Times the residual: such fixes were mirrored by a wall, or came too late"""
LEAST_REACH = 3.0
"""Times the residual: where a drive does not reach farther, its fixes do not show its turn"""


def tell_fixes(drive: Drive) -> Iterator[str]:
    """Say where on the globe the map lies, by fixes of satellites beside the scans.

    The receiver is where its frame is; one that no chain leads to is taken to be at the sensor.
    """
    poser, fixes = drive.poser, list(drive.log.fixes())
    frames = {fix.frame for fix in fixes}
    tree, fixed = poser.sources.tree, poser.fixed or ""
    poser.find_chains(frame for frame in frames if tree.find_path(fixed, frame))
    of_sensors = (chain for chain in poser.chains.values() if chain)
    chain = next(filter(None, map(poser.chains.get, sorted(frames))), next(of_sensors, None))
    if not fixes or chain is None:
        return
    stamp_ns, _, *globe = (np.array(each) for each in zip(*fixes, strict=True))
    found = chain.at(stamp_ns + round(poser.options.time_offset_s * 1e9))
    place = place_logs(replace(poser.options, align=None)).then(found).position[:, :2]
    known = np.column_stack([place, *globe])[found.status == POSED]
    if len(known) < FEWEST_FIXES:
        yield f"only {count(len(known), 'satellite position')} came while poses are known"
        return
    *_, error = fit_globe(known)
    zero, yaw, error = fit_globe(known[error <= OUTLIER * np.median(error)])
    residual, reach = float(np.median(error)), math.hypot(*known[:, :2].std(axis=0))
    if reach <= LEAST_REACH * residual:
        yield f"satellite positions lie {residual:.2f} m off a way that reaches {reach:.2f} m"
        return
    positions = count(len(error), "satellite position")
    where = f"`georeference=({zero[0]:.8f},{zero[1]:.8f},{yaw:.2f})`"
    yield f"{where} lays the way within {residual:.2f} m of half of {positions}"


def fit_globe(known: Float64) -> tuple[tuple[float, float], float, Float64]:
    """Lay places (N, 2) onto the globe by a turn and a shift.

    The plane that touches the globe in their middle has x to the east and y to the north, as
    complex numbers here, by which the best turn is an angle (Umeyama 1991, without a scale).

    Parameters
    ----------
    known
        (N, 4) x and y in the map (m), latitude and longitude (degrees).

    Returns
    -------
    zero, yaw, error
        Latitude and longitude of the map's zero, and how far its x axis points north of east
        (degrees); and (N,) how far each place is off (m).
    """
    latitude, longitude = np.median(known[:, 2:], axis=0).tolist()
    bend = 1 - FLATNESS * math.sin(math.radians(latitude)) ** 2
    north_m = math.radians(1) * EQUATOR_M * (1 - FLATNESS) / bend**1.5
    east_m = math.radians(1) * EQUATOR_M / math.sqrt(bend) * math.cos(math.radians(latitude))
    here = known[:, 0] + 1j * known[:, 1]
    there = (known[:, 3] - longitude) * east_m + 1j * (known[:, 2] - latitude) * north_m
    angle = float(np.angle(np.vdot(here - here.mean(), there - there.mean())))
    turn = np.exp(1j * angle)
    at = there.mean() - here.mean() * turn
    zero = latitude + at.imag / north_m, longitude + at.real / east_m
    return zero, math.degrees(angle), np.abs(here * turn + at - there)


def sum_up_poses(topic: TopicSurvey, plan: PosePlan) -> PoseFindings:
    """Sum up how the scans of a topic get their poses."""
    chain = None if topic.stated else plan.poser.chains.get(next(iter(topic.frames)))
    faults = [plan.faults[frame] for frame in topic.frames if frame in plan.faults]
    return PoseFindings(
        stated=topic.stated,
        chain=chain.frames if chain else (),
        posed=topic.posed,
        dropped=dict(plan.poser.count_lost(topic.stream.topic)),
        problem="; ".join(map(str, faults)),
        assumed=format_mount(plan.assumed) if plan.assumed and faults else "",
        is_guess=plan.is_guess and bool(faults),
    )


def sum_up_mount(poser: Poser, topic: str, misfit: Concern | None) -> MountFindings | None:
    """Sum up how the sensor of a topic sits; None where no scan has a pose."""
    if (stance := poser.find_stance(topic)) is None:
        return None
    better = " ".join(f"{name}={value}" for name, value in misfit.remedy.items()) if misfit else ""
    return MountFindings(stance.upside_down, stance.tilt, stance.height, better)


LEAST_TILT_DEG = 0.5
"""Poses are off by less, at times."""
MOST_TILT_DEG = 10.0
"""More is no small error, and linear no more."""
MOST_SWAY_DEG = 1.5
"""Clouds that are tilted by a degree are laid flat"""


def enclose_clouds(drive: Drive, ground: Ground) -> CellBox | None:
    """Read clouds once more, and find the cells that their points observe; None: they do none."""
    from occmap.clouds import engine  # noqa: PLC0415  late: it brings numba
    from occmap.clouds.kernels.heights import list_clouds  # noqa: PLC0415  likewise
    from occmap.clouds.kernels.laying import lay_columns  # noqa: PLC0415  likewise

    options = drive.options
    band = engine.make_band(options.clouds, options.returns)
    extent = engine.Extent(Lattice(options.resolution), lay_columns(ground), band)
    for posed in drive.read(Tally()):  # it knows by now what leaps away
        for cloud in list_clouds(posed):
            extent.add(cloud)
    return extent.box


def list_cloud_concerns(
    some: Mapping[str, Clouds], drive: Drive, ground: Ground | None
) -> Iterator[Doubt]:
    """List what some clouds say against mounts and poses."""
    poser, options = drive.poser, drive.options
    yield from poser.suspect_axes(ground)
    for topic, every in sorted(some.items()):
        clouds = [drive.drop_own(posed) for posed in every]
        is_known = poser.sources.lidar is not None  # what the floor tells comes after it
        mount = None if is_known else mounts.find_mount(poser, clouds[0].batch.frame, in_3d=True)
        wrong = mount and find_misplaced(mount, clouds)
        if mount and ground and not wrong:
            wrong = find_tilted(mount, clouds, ground, options)
        if wrong:
            yield topic, wrong
        if ground is None:
            continue
        if not wrong and not is_known:  # which would be a reason for all that follows
            conflicts = [Concern(text) for text in list_conflicts(clouds, ground, options)]
            turned = mount and conflicts and find_turned(mount, clouds, options)
            others = [turned] if turned else conflicts or find_leaning(clouds, ground, options)
            yield from ((topic, concern) for concern in others)


FLAT_RAD, TURN_ROUNDS = 0.0035, 12
"""A floor is flat that leans by less, and so often the ground is found anew"""


def find_tilted(
    mount: mounts.Mount, clouds: Clouds, ground: Ground, options: BuildOptions
) -> Concern | None:
    """Find out if a mount is wrong by a small turn, by which the floor would lie flat.

    Of tilted clouds the ground is smeared, and hides a part of the tilt: so it is found anew of
    clouds that are turned by what it showed, until it shows no tilt. A turn by which clouds
    contradict each other is none.
    """
    turn = IDENTITY
    for _ in range(TURN_ROUNDS):
        tilts = measure_tilts(clouds, ground)
        if tilts is None or np.linalg.norm(tilts.sensor) < FLAT_RAD:
            break
        small = Pose.from_xyzrpy((0.0, 0.0, 0.0), tilts.sensor.tolist())
        turn = mounts.turn_mount(turn, small)
        clouds = [mounts.mount_scans(each, small) for each in clouds]
        ground = find_own_ground(clouds, options) or ground
    angle = 2 * math.degrees(math.atan2(np.linalg.norm(turn[3:6]), turn.qw))
    left = np.linalg.norm([*tilts.sensor, *tilts.upright]) if tilts else math.inf
    is_better = angle > LEAST_TILT_DEG > math.degrees(left)
    if not is_better or list_conflicts(clouds, ground, options):
        return None
    mended = mount.write(mounts.turn_mount(mount.pose, turn))
    found = f"the floor is tilted by {angle:.1f} deg in the sensor's own frame, wherever it goes"
    return Concern(f"{found}: its mount is wrong by that", mended)


def find_leaning(clouds: Clouds, ground: Ground, options: BuildOptions) -> Iterator[Concern]:
    """Say if the poses' up is wrong by a small angle, or sways."""
    # What is left of a drift looks alike.
    tilts = None if options.posing.height_drift else measure_tilts(clouds, ground)
    angle = math.degrees(np.linalg.norm(tilts.upright)) if tilts and not tilts.is_mount else 0.0
    if LEAST_TILT_DEG < angle < MOST_TILT_DEG:
        found = f"the floor is tilted by about {angle:.1f} deg against the poses"
        yield Concern(f"{found}: their up is wrong, which is mended up to a degree")
    elif tilts and (sway := math.degrees(tilts.sway)) > MOST_SWAY_DEG:
        found = f"the floor of half of the clouds is tilted by {sway:.1f} deg or more"
        why = "the poses' up sways, and floor may be called occupied: give poses of SLAM in 3D"
        yield Concern(f"{found}, each in its own way: {why}")


def list_conflicts(clouds: Clouds, ground: Ground, options: BuildOptions) -> list[str]:
    """Say that clouds contradict each other, if they do."""
    engine = make_engine(replace(options, update=Update.CLOUD), Keep(ground=ground))
    found = list[str]()
    with suppress(MapError):  # it gets too large, which is a problem by itself
        for posed in clouds:
            engine.add(posed)
        found += list_contradictions(count_steady(engine.finish().tiles), {})
    return found


def warn_of_body(body: Box) -> Concern:
    """Say that the robot stands in a box around the sensor (m), and what leaves it out."""
    box = {"footprint": ",".join(f"{edge:g}" for edge in body)}
    found = "the robot is in its own scans: some of it is at the same place wherever it goes"
    return Concern(f"{found}; {mark_options(box)} leaves it out", box)


def find_misplaced(mount: mounts.Mount, clouds: Clouds) -> Concern | None:
    """Find out if a sensor sits in another way than its poses say: by far, as in another frame."""
    body = Transforms.fixed(mount.pose).invert().first
    on_body = [mounts.mount_scans(each, body) for each in clouds]
    if (seat := find_seat(on_body, Transforms.fixed(mount.pose).rotation[0])) is None:
        return None
    up = Transforms.fixed(seat.mount).rotation[0, 2]
    angle, of_body = find_angle(clouds, up), find_angle(on_body, np.array([0.0, 0.0, 1.0]))
    if angle < MOST_TILT_DEG or of_body > MOST_TILT_DEG:
        return None
    found = f"the floor stands askew by {angle:.0f} deg in the map, wherever the sensor goes"
    return propose(mount, Pose(*mount.pose[:3], *seat.mount[3:]), found, "lays it flat")


def find_turned(mount: mounts.Mount, clouds: Clouds, options: BuildOptions) -> Concern | None:
    """Find by which quarter turn of their sensor clouds do not contradict each other any more."""
    body = Transforms.fixed(mount.pose).invert().first
    for turn in mounts.TURNS[1:4]:
        pose = Pose(*mount.pose[:3], *mounts.turn_mount(turn, mount.pose)[3:])
        turned = [mounts.mount_scans(each, mounts.turn_mount(body, pose)) for each in clouds]
        ground = find_own_ground(turned, options)
        if ground and not list_conflicts(turned, ground, options):
            return propose(mount, pose, "clouds contradict each other", "mends that")
    return None


def propose(mount: mounts.Mount, pose: Pose, found: str, effect: str) -> Concern:
    """Propose another mount by what was found with the one that is given."""
    mended = mount.write(pose)
    return Concern(f"{found}: its mount is another; {mark_options(mended)} {effect}", mended)


def find_own_ground(clouds: Clouds, options: BuildOptions) -> Ground | None:
    """Find the ground that clouds show by themselves; None where they show none."""
    from occmap.clouds.counting import count_clouds  # noqa: PLC0415  late: it brings numba
    from occmap.clouds.ground import derive_ground  # noqa: PLC0415  likewise

    with suppress(MapError):
        counted = count_clouds(clouds, min_range=options.returns.min_range)
        return derive_ground(counted, options.clouds)[0]
    return None


def find_angle(scans: Clouds, axis: Float64) -> float:
    """Find how far from upright an axis of the sensor (3,) is in most scans (degrees)."""
    rise = np.concatenate([each.at_first_beam[1][:, 2] @ axis for each in scans])
    return math.degrees(math.acos(float(np.clip(np.median(rise), -1, 1))))
