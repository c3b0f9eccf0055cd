"""What an inspection finds, in words that a terminal and a page lay out.

A row is a label, "" where it is that of the row before, and a text.
"""

import math
from collections.abc import Iterator

from occmap.inspection import findings
from occmap.report.results import hint_at_tune
from occmap.report.words import (
    DATES_S,
    Row,
    count,
    write_box,
    write_counts,
    write_duration,
    write_span,
)


def list_scan_facts(topic: findings.ScanFindings) -> Iterator[Row]:
    """Say how many scans a topic has, and what their beams are."""
    duration = f"{topic.times.duration_s:.6g} s, {topic.times.rate_hz:.3g} a second"
    left = f"{topic.kept:,} of " if topic.left_out else ""
    scans = f"{topic.topic}: {left}{topic.scans:,} in {duration}"
    yield "clouds" if topic.is_of_clouds else "scans", f"{scans}, frame {', '.join(topic.frames)}"
    if topic.left_out:
        yield "dropped", write_counts(topic.left_out)
    if topic.is_of_clouds:
        return
    for index, shape in enumerate(topic.shapes):
        scans = "" if topic.shape_count == 1 else f"{count(shape.scans, 'scan')}: "
        yield "" if index else "shape", scans + describe_shape(shape)
    if topic.shape_count > len(topic.shapes):
        yield "", f"and {topic.shape_count - len(topic.shapes)} more"


def list_pose_facts(topic: findings.ScanFindings) -> Iterator[Row]:
    """Say when and where the scans of a topic were taken, and how well they fit each other."""
    yield "stamps", write_span(topic.times.start_ns, topic.times.end_ns)
    yield "", describe_times(topic.times)
    yield "poses", describe_poses(topic)
    if topic.agreement is not None:
        share = f"{topic.agreement:.0%} of the hits of a sample lie in cells called occupied"
        yield "", share + ("" if topic.poses.stated else hint_at_tune(topic.agreement))
    if topic.mount is not None:
        yield "sensor", describe_mount(topic.mount, topic.poses)


def describe_shape(shape: findings.Shape) -> str:
    """Say where the beams point and how far they reach."""
    start, step = math.degrees(shape.angle_min), math.degrees(shape.angle_increment)
    limit = "without limit" if math.isinf(shape.range_max) else f"to {shape.range_max:.6g} m"
    return (
        f"{count(shape.beams, 'beam')} over {math.degrees(shape.field_of_view):.4g} deg, from "
        f"{start:.4g} deg every {step:.3g} deg, ranges from {shape.range_min:.3g} {limit}"
    )


def list_kinds(ranges: findings.RangeFindings) -> Iterator[tuple[str, str, str, str]]:
    """List the kinds of values that are not plain measurements: name, number, share, meaning."""
    for each in ranges.specials:
        advice = f"`no_return={each.no_return}`" if each.no_return else "skipped"
        yield each.name, f"{each.count:,}", f"{each.share:.1%}", f"{each.meaning}: {advice}"


def list_repeated(ranges: findings.RangeFindings) -> Iterator[tuple[str, str, str]]:
    """List the ranges that repeat suspiciously often: the range (m), its share, and its meaning."""
    for each in ranges.repeated:
        meaning = "no return, by the limit" if each.is_no_return else "may mean no return"
        yield f"{each.value:.6g}", f"{each.share:.1%} of the ranges", meaning


def tell_ranges(ranges: findings.RangeFindings) -> str:
    """Say how many of the ranges are measured, and between what they lie."""
    text = f"{ranges.total:,}: {ranges.measured / max(ranges.total, 1):.1%} measured"
    span = f", {ranges.smallest:.3g} to {ranges.largest:.4g} m" if ranges.measured else ""
    return text + span


def tell_crossed(ranges: findings.RangeFindings) -> str:
    """Say whether beams without return lead through open space; "" where that is not known."""
    if ranges.crossed is None:
        return ""
    where = "lead through walls or out of everything that was hit"
    text = f"{ranges.crossed:.0%} of beams without return {where}"
    advised = any(special.no_return == "clear" for special in ranges.specials)
    return text if advised else f"{text}: leave `no_return` as it is"


def describe_times(times: findings.TimeFindings) -> str:
    """Say how the stamps run, beside the record times where the log has any of their own.

    CSV has none. Those of CARMEN count from the start of the recording, and stamps are dates.
    """
    parts = ["simulated time"] if times.simulated else []
    is_comparable = (times.offset_s or times.drift_s) and times.offset_s < DATES_S.start
    if is_comparable and not times.simulated:
        side = "after" if times.offset_s > 0 else "before"
        offset = f"{write_duration(abs(times.offset_s))} {side} the record times"
        parts.append(f"{offset}, drift {times.drift_s:.2g} s")
    parts.append(f"largest gap {write_duration(times.largest_gap_s)}")
    if times.time_increment_s:
        parts.append(f"{1e3 * times.time_increment_s:.3g} ms between beams")
    if times.jumps_back:
        jumps = count(times.jumps_back, "jump")
        parts.append(f"{jumps} back, up to {times.largest_jump_back_s:.3g} s")
    if times.duplicates:
        parts.append(f"{count(times.duplicates, 'scan')} with the stamp of the one before")
    if times.all_equal:
        parts.append("all zero" if times.all_zero else "all equal")
    return ", ".join(parts)


def describe_poses(topic: findings.ScanFindings) -> str:
    """Say how many scans have a pose, and where it comes from."""
    poses = topic.poses
    way = "stated beside the scans" if poses.stated else " > ".join(poses.chain)
    lost = write_counts(poses.dropped)
    share = f"{poses.posed:,} of {count(topic.kept, 'scan')}"
    given = f" with `sensor_pose=({poses.assumed})`" if poses.assumed else ""
    return f"{share}{given}" + (f", {way}" if way else "") + (f"; {lost}" if lost else "")


def describe_mount(mount: findings.MountFindings, poses: findings.PoseFindings) -> str:
    """Say how the sensor sits."""
    tilt = math.degrees(mount.tilt)
    parts = ["upside down"] if mount.upside_down else []
    parts += [f"tilted {tilt:.1f} deg" if tilt >= 0.05 else "level", f"height {mount.height:.3g} m"]
    if poses.assumed:
        parts.append(
            "turn not known: measure it" if poses.is_guess else "turn found from the scans"
        )
    return ", ".join(parts)


def describe_source(source: findings.Coverage) -> str:
    """Say what a pose source knows."""
    name = f"{source.parent} > {source.child or 'a body'}"
    step = f"{source.largest_step_m:.3g} m, {math.degrees(source.largest_step_rad):.3g} deg"
    return (
        f"{name} on {source.topic}: {count(source.samples, 'sample')}, "
        f"{source.start_ns / 1e9:.1f} to {source.end_ns / 1e9:.1f} s, "
        f"largest gap {source.largest_gap_s:.3g} s, largest step {step}"
    )


def tell_sources(sources: tuple[findings.Coverage, ...]) -> list[str]:
    """Say what the pose sources that move know, and how many others there are."""
    moving = [describe_source(source) for source in sources if source.moves]
    fixed = len(sources) - len(moving)
    changes = "changes" if fixed == 1 else "change"
    return moving + ([f"{count(fixed, 'transform')} that never {changes}"] if fixed else [])


def describe_map(grid: findings.MapFindings) -> str:
    """Say how large the map would be."""
    return (
        f"{grid.columns:,} x {grid.rows:,} cells of {grid.resolution:g} m, "
        f"{write_box(grid.extent)}; {write_bytes(grid.file_bytes)} as PGM, "
        f"{write_bytes(grid.memory_bytes)} of memory at most"
    )


def write_bytes(size: float) -> str:
    """Write a number of bytes with a unit."""
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:,.3g} GB"
