"""Findings of an inspection as text: aligned lines for people; programs read the JSON."""

import math
from collections.abc import Iterator

from occmap.cli.console import write_command
from occmap.inspection.findings import (
    Inspection,
    LogFindings,
    MapFindings,
    MountFindings,
    PoseFindings,
    RangeFindings,
    ScanFindings,
    Shape,
    TimeFindings,
)
from occmap.posing.coverage import Coverage
from occmap.readers import Role
from occmap.remarks import hint_at_tune
from occmap.wording import count, write_box, write_counts, write_duration, write_span

LABEL = 10
"""Width of the first column."""
Row = tuple[str, str]
"""A label, "" where it is that of the row before, and the text."""


def format_inspection(inspection: Inspection) -> list[str]:
    """Write all findings; problems and the recommended command come last."""
    lines = [line for log in inspection.logs for line in list_log(log)]
    if inspection.map is not None:
        lines += [label("map", format_map(inspection.map))]
    lines += [label("warning", text) for text in inspection.warnings]
    lines += [label("problem", text) for text in inspection.problems]
    if inspection.command:
        lines += ["", write_command(inspection.command)]
    return lines


def label(name: str, text: str) -> str:
    """Put a text beside its label."""
    return f"{name:<{LABEL}}{text}"


def list_log(log: LogFindings) -> Iterator[str]:
    """Write all about one log, and a blank line."""
    rows = [*list_streams(log), *(row for topic in log.scans for row in list_topic(topic))]
    notes = [text for text in log.notes if text not in log.damage]  # damage is a warning
    rows += [*list_sources(log), *_label_first("note", notes)]
    yield log.path
    yield from (label(f"  {name}", text).rstrip() for name, text in rows)
    yield ""


def list_streams(log: LogFindings) -> Iterator[Row]:
    """List the topics with their types and counts, and what each is good for."""
    width = max((len(stream.topic) for stream in log.streams), default=0)
    kinds = max((len(stream.type) for stream in log.streams), default=0)
    for index, stream in enumerate(log.streams):
        role = "" if stream.role is Role.OTHER else f"  {stream.role}s"
        text = f"{stream.topic:<{width}}  {stream.type:<{kinds}}  {stream.count:>8,}{role}"
        yield "" if index else "topics", text


def list_topic(topic: ScanFindings) -> Iterator[Row]:
    """Write all about the scans of one topic."""
    frames = ", ".join(topic.frames)
    duration = f"{topic.times.duration_s:.6g} s, {topic.times.rate_hz:.3g} a second"
    yield "", ""
    left = f"{topic.kept:,} of " if topic.left_out else ""
    yield "scans", f"{topic.topic}: {left}{topic.scans:,} in {duration}, frame {frames}"
    if topic.left_out:
        yield "dropped", write_counts(topic.left_out)
    yield from _label_first("shape", list(list_shapes(topic)))
    yield from list_ranges(topic.ranges)
    yield "stamps", write_span(topic.times.start_ns, topic.times.end_ns)
    yield "", format_times(topic.times)
    yield "poses", format_poses(topic)
    if topic.agreement is not None:
        share = f"{topic.agreement:.0%} of the hits of a sample lie in cells called occupied"
        yield "", share + hint_at_tune(topic.agreement)
    if topic.mount is not None:
        yield "sensor", describe_mount(topic.mount, topic.poses)


def list_shapes(topic: ScanFindings) -> Iterator[str]:
    """List the beams and limits that the scans have, the most frequent first."""
    for shape in topic.shapes:
        scans = "" if topic.shape_count == 1 else f"{count(shape.scans, 'scan')}: "
        yield scans + format_shape(shape)
    if topic.shape_count > len(topic.shapes):
        yield f"and {topic.shape_count - len(topic.shapes)} more"


def format_shape(shape: Shape) -> str:
    """Say where the beams point and how far they reach."""
    start, step = math.degrees(shape.angle_min), math.degrees(shape.angle_increment)
    limit = "without limit" if math.isinf(shape.range_max) else f"to {shape.range_max:.6g} m"
    return (
        f"{count(shape.beams, 'beam')} over {math.degrees(shape.field_of_view):.4g} deg, from "
        f"{start:.4g} deg every {step:.3g} deg, ranges from {shape.range_min:.3g} {limit}"
    )


def list_ranges(ranges: RangeFindings) -> Iterator[Row]:
    """Write a histogram of the range values that are special, and what each suggests."""
    text = f"{ranges.total:,}: {ranges.measured / max(ranges.total, 1):.1%} measured"
    if ranges.measured:
        text += f", {ranges.smallest:.3g} to {ranges.largest:.4g} m"
    yield "ranges", text
    for special in ranges.specials:
        advice = f": --no-return {special.no_return}" if special.no_return else ": skipped"
        found = f"{special.name:<12} {special.count:>10,} {special.share:>6.1%}"
        yield "", f"{found}  {special.meaning}{advice}"
    for item in ranges.repeated:
        meaning = "no return, by the limit" if item.is_no_return else "may mean no return"
        yield "", f"{item.value:<12.6g} repeated: {item.share:.1%} of the ranges; {meaning}"
    if ranges.crossed is not None:
        text = (
            f"{ranges.crossed:.0%} of beams without return lead through or beyond what others hit"
        )
        advised = any(special.no_return == "clear" for special in ranges.specials)
        yield "", text if advised else f"{text}: leave --no-return as it is"


def format_times(times: TimeFindings) -> str:
    """Say how the stamps run, beside the record times."""
    side = {-1: "before", 0: "from", 1: "after"}[(times.offset_s > 0) - (times.offset_s < 0)]
    offset = f"{write_duration(abs(times.offset_s))} {side} the record times"
    parts = [f"{offset}, drift {times.drift_s:.2g} s"]
    if times.simulated:
        parts = ["simulated time"]
    parts += [f"largest gap {write_duration(times.largest_gap_s)}"]
    if times.time_increment_s:
        parts.append(f"{1e3 * times.time_increment_s:.3g} ms between beams")
    if times.jumps_back:
        jumps = count(times.jumps_back, "jump")
        parts.append(f"{jumps} back, up to {times.largest_jump_back_s:.3g} s")
    if times.duplicates:
        parts.append(f"{count(times.duplicates, 'stamp')} as the one before")
    if times.all_equal:
        parts.append("all zero" if times.all_zero else "all equal")
    return ", ".join(parts)


def format_poses(topic: ScanFindings) -> str:
    """Say how many scans have a pose, and where it comes from."""
    poses = topic.poses
    way = "stated beside the scans" if poses.stated else " > ".join(poses.chain)
    lost = write_counts(poses.dropped)
    share = f"{poses.posed:,} of {count(topic.kept, 'scan')}"
    given = f" with --sensor-pose {poses.assumed}" if poses.assumed else ""
    return f"{share}{given}" + (f", {way}" if way else "") + (f"; {lost}" if lost else "")


def describe_mount(mount: MountFindings, poses: PoseFindings) -> str:
    """Say how the sensor sits."""
    tilt = math.degrees(mount.tilt)
    parts = ["upside down"] if mount.upside_down else []
    parts += [f"tilted {tilt:.1f} deg" if tilt >= 0.05 else "level", f"z {mount.height:.3g} m"]
    if poses.assumed:
        parts.append(
            "turn not known: measure it" if poses.is_guess else "turn found from the scans"
        )
    return ", ".join(parts)


def list_sources(log: LogFindings) -> Iterator[Row]:
    """List the pose sources that move; of the others their number is enough."""
    moving = [source for source in log.coverage if source.moves]
    texts = [format_source(source) for source in moving]
    fixed = len(log.coverage) - len(moving)
    if fixed:
        changes = "changes" if fixed == 1 else "change"
        texts.append(f"{count(fixed, 'transform')} that never {changes}")
    if texts:
        yield "", ""
    yield from _label_first("sources", texts)


def format_source(source: Coverage) -> str:
    """Say what a pose source knows."""
    name = f"{source.parent} > {source.child or 'a body'}"
    step = f"{source.largest_step_m:.3g} m, {math.degrees(source.largest_step_rad):.3g} deg"
    return (
        f"{name} on {source.topic}: {count(source.samples, 'sample')}, "
        f"{source.start_ns / 1e9:.1f} to {source.end_ns / 1e9:.1f} s, "
        f"largest gap {source.largest_gap_s:.3g} s, largest step {step}"
    )


def format_map(grid: MapFindings) -> str:
    """Say how large the map would be."""
    return (
        f"{grid.columns:,} x {grid.rows:,} cells of {grid.resolution:g} m, "
        f"{write_box(grid.extent)}; {format_bytes(grid.file_bytes)} as PGM, "
        f"{format_bytes(grid.memory_bytes)} of memory at most"
    )


def format_bytes(size: float) -> str:
    """Write a number of bytes with a unit."""
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:,.3g} GB"


def _label_first(name: str, texts: list[str]) -> list[Row]:
    """Label the first of several rows."""
    return [("" if index else name, text) for index, text in enumerate(texts)]
