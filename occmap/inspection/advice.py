"""From findings to advice: warnings, and the command line that makes the best of the logs."""

import math
from collections.abc import Sequence

from occmap.batching import find_oddity
from occmap.command import compose_build
from occmap.inspection.findings import LogFindings, ScanFindings
from occmap.pipeline import BuildOptions
from occmap.report import LEAST_AGREEMENT
from occmap.wording import count

TILTED_RAD = math.radians(3)
"""A tilted scan plane meets the floor: at three degrees, 30 cm above it, within six metres."""
SHARE_OF_NOTE = 0.05
DRIFT_S = 0.1


def compose_command(logs: Sequence[LogFindings], options: BuildOptions) -> tuple[str, ...]:
    """Compose the command line for logs that can be mapped: the options given, then the advice."""
    paths = [log.path for log in logs if not log.problem]
    return compose_build(paths, options, list_advised(logs, options))


def list_advised(logs: Sequence[LogFindings], options: BuildOptions) -> dict[str, str]:
    """List the options that the findings suggest, where the user has not decided."""
    topics = [topic for log in logs for topic in log.scans]
    advised = {}
    for topic in topics:
        if topic.poses.assumed:
            advised["sensor_pose"] = topic.poses.assumed
        if not topic.poses.stated and topic.times.suggested_stamps != options.posing.stamps:
            advised["stamps"] = topic.times.suggested_stamps
    advice = {special.no_return for topic in topics for special in topic.ranges.specials} - {""}
    if advice == {"clear"}:
        advised["no_return"] = "clear"
    return advised


def list_warnings(log: LogFindings) -> list[str]:
    """List what will spoil a map, or surprise its maker."""
    posed = any(topic.poses.posed for topic in log.scans)  # that none is, is a problem
    lacking = [_warn_poses] if posed else []
    warn = [_warn_shapes, _warn_mount, *lacking, _warn_agreement, _warn_times, _warn_ranges]
    return [
        f"{log.path}: {topic.topic}: {text}"
        for topic in log.scans
        for each in warn
        for text in each(topic)
    ]


def _warn_shapes(topic: ScanFindings) -> list[str]:
    oddities = (find_oddity(shape.angle_increment, shape.beams) for shape in topic.shapes)
    return [oddity for oddity in dict.fromkeys(oddities) if oddity]


def _warn_mount(topic: ScanFindings) -> list[str]:
    mount = topic.mount
    found = []
    if mount is not None and mount.tilt >= TILTED_RAD:
        tilt = math.degrees(mount.tilt)
        found.append(f"the scan plane is tilted by {tilt:.1f} deg: it meets the floor")
    if mount is not None and mount.better_turn:
        turn = f"turned by x,y,yaw[,roll,pitch] = {mount.better_turn}"
        found.append(f"the scans would fit each other better if the laser were {turn}")
    return found


def _warn_poses(topic: ScanFindings) -> list[str]:
    lost = topic.poses.dropped
    if sum(lost.values()) > SHARE_OF_NOTE * topic.kept:
        reasons = ", ".join(f"{scans} {reason}" for reason, scans in lost.items())
        return [f"scans without a pose: {reasons}"]
    return []


def _warn_agreement(topic: ScanFindings) -> list[str]:
    if topic.agreement is None or topic.agreement >= LEAST_AGREEMENT:
        return []
    found = f"only {topic.agreement:.0%} of the hits of a sample of scans lie in occupied cells"
    return [f"{found}: the poses do not fit the scans; try `occmap tune`, or another trajectory"]


def _warn_times(topic: ScanFindings) -> list[str]:
    times = topic.times
    if topic.poses.stated:
        return []  # stamps do not matter where the pose stands beside the scan
    found = []
    if times.all_equal:
        found.append("all stamps are equal")
    if times.jumps_back:
        found.append(f"stamps jump back {count(times.jumps_back, 'time')}")
    if abs(times.drift_s) > DRIFT_S:
        found.append(f"stamps drift by {times.drift_s:.3g} s against the record times")
    return found


def _warn_ranges(topic: ScanFindings) -> list[str]:
    found = [
        f"{item.value:g} m is {item.share:.0%} of the ranges and may mean no return"
        for item in topic.ranges.repeated
        if not item.is_no_return
    ]
    return found if topic.ranges.measured else [*found, "no range value is a measurement"]
