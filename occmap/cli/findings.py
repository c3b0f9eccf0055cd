"""Findings of an inspection as text: aligned lines for people; programs read the JSON."""

from collections.abc import Iterator, Sequence

from occmap.cli.console import label_first, write_command, write_rows
from occmap.inspection.findings import Inspection, LogFindings, RangeFindings
from occmap.inspection.telling import (
    Row,
    describe_map,
    list_kinds,
    list_pose_facts,
    list_repeated,
    list_scan_facts,
    tell_crossed,
    tell_ranges,
    tell_sources,
)
from occmap.readers import Role, Stream

LABEL = 10
"""Width of the first column."""


def format_inspection(inspection: Inspection) -> Iterator[str]:
    """Write all findings; problems and the recommended command come last."""
    for log in inspection.logs:
        yield log.path
        yield from write_rows(((f"  {name}", text) for name, text in list_log(log)), LABEL)
        yield ""
    rows = [] if inspection.map is None else [("map", describe_map(inspection.map))]
    rows += [("warning", text) for text in inspection.warnings]
    rows += [("problem", text) for text in inspection.problems]
    yield from write_rows(rows, LABEL)
    if inspection.command:
        yield from ("", write_command(inspection.command))


def list_log(log: LogFindings) -> Iterator[Row]:
    """List all about one log."""
    yield from label_first("topics", list_streams(log.streams))
    for topic in log.scans:
        yield "", ""
        yield from list_scan_facts(topic)
        yield from label_first("ranges", list_ranges(topic.ranges))
        yield from list_pose_facts(topic)
    if log.coverage:
        yield "", ""
    yield from label_first("sources", tell_sources(log.coverage))
    yield from label_first("note", [text for text in log.notes if text not in log.damage])


def list_streams(streams: Sequence[Stream]) -> Iterator[str]:
    """List the topics with their types and counts, and what each is good for."""
    width = max((len(stream.topic) for stream in streams), default=0)
    kinds = max((len(stream.type) for stream in streams), default=0)
    for stream in streams:
        role = "" if stream.role is Role.OTHER else f"  {stream.role}s"
        yield f"{stream.topic:<{width}}  {stream.type:<{kinds}}  {stream.count:>8,}{role}"


def list_ranges(ranges: RangeFindings) -> Iterator[str]:
    """Write a histogram of the range values that are special, and what each suggests."""
    yield tell_ranges(ranges)
    for name, number, share, meaning in list_kinds(ranges):
        yield f"{name:<12} {number:>10} {share:>6}  {meaning}"
    for value, share, meaning in list_repeated(ranges):
        yield f"{value:<12} repeated: {share}; {meaning}"
    if crossed := tell_crossed(ranges):
        yield crossed
