"""Findings of an inspection as text: aligned lines for people; programs read the JSON."""

from collections.abc import Iterator, Sequence

from occmap.cli.console import write_command
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


def format_inspection(inspection: Inspection) -> list[str]:
    """Write all findings; problems and the recommended command come last."""
    lines = [line for log in inspection.logs for line in list_log(log)]
    if inspection.map is not None:
        lines += [label("map", describe_map(inspection.map))]
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
    rows = label_first("topics", list(list_streams(log.streams)))
    for topic in log.scans:
        rows += [("", ""), *list_scan_facts(topic)]
        rows += label_first("ranges", list(list_ranges(topic.ranges)))
        rows += list_pose_facts(topic)
    sources = label_first("sources", tell_sources(log.coverage))
    rows += [("", ""), *sources] if sources else []
    rows += label_first("note", [text for text in log.notes if text not in log.damage])
    yield log.path
    yield from (label(f"  {name}", text).rstrip() for name, text in rows)
    yield ""


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


def label_first(name: str, texts: Sequence[str]) -> list[Row]:
    """Label the first of several rows."""
    return [("" if index else name, text) for index, text in enumerate(texts)]
