"""The page of `check`, and what commands say and find, as sections of any page."""

import shlex
from collections.abc import Iterator
from pathlib import Path

from occmap.evidence.manifest import describe_files
from occmap.inspection import telling
from occmap.inspection.findings import Inspection, LogFindings
from occmap.page.document import Block, Page, Section, describe_maker, name_logs, write_page
from occmap.readers import Role
from occmap.report.notes import Noted
from occmap.report.words import count

MOST_LOGS = 20
"""With all that is found in them; warnings and problems are those of all logs."""


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the page of an inspection.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    logs = [Path(log.path) for log in inspection.logs]
    names = name_logs(log.name for log in logs)
    verdict = "can be mapped" if inspection.buildable else "cannot be mapped as it is"
    sections = list(tell_findings(inspection))
    if inspection.map is not None:
        facts = [("size", telling.describe_map(inspection.map))]
        sections.append(Section("The map that they would make", [Block("facts", facts)]))
    inputs = [entry for log in logs if log.exists() for entry in describe_files(log)]
    page = Page(f"Check of {names}", verdict, [*sections, describe_maker(inputs)])
    write_page(path, page)


def tell_findings(found: Inspection) -> Iterator[Section]:
    """Say what `check` finds in logs."""
    nothing = [] if found.problems or found.warnings else ["No problems, no warnings."]
    blocks = [
        Block("list", texts=found.problems, tone="problem"),
        Block("list", texts=found.warnings, tone="warning"),
        Block("list", texts=nothing),
    ]
    if found.command:
        blocks.append(Block("code", title="Recommended", texts=[shlex.join(found.command)]))
    yield Section("What check finds", blocks)
    for log in found.logs[:MOST_LOGS]:
        yield Section(f"In {log.path}", list(list_log(log)))
    if others := len(found.logs[MOST_LOGS:]):
        rest = [Block("list", texts=[f"{count(others, 'more log')}: see `occmap check`"])]
        yield Section("And", rest)


def list_log(log: LogFindings) -> Iterator[Block]:
    """All about one log."""
    yield Block("list", title="Damage", texts=log.damage, tone="problem")
    yield Block("list", title="Notes", texts=log.other_notes)
    streams = [
        (each.topic, each.type, f"{each.count:,}", each.role.replace(Role.OTHER, ""))
        for each in log.streams
    ]
    yield Block("table", streams, ("topic", "type", "#messages", "used as"), title="Topics")
    for topic in log.scans:
        facts = [*telling.list_scan_facts(topic), ("ranges", telling.tell_ranges(topic.ranges))]
        if crossed := telling.tell_crossed(topic.ranges):
            facts.append(("", crossed))
        facts += telling.list_pose_facts(topic)
        yield Block("facts", facts, title=f"Scans on {topic.topic}")
        kinds = list(telling.list_kinds(topic.ranges))
        for metres, share, meaning in telling.list_repeated(topic.ranges):
            kinds.append((f"{metres} m, repeated", "", share, meaning))
        yield Block("table", kinds, ("range", "#values", "#share", "what it means"))
    yield Block("list", title="Pose sources", texts=telling.tell_sources(log.coverage))


def tell_notes(result: Noted) -> Section:
    """Say what the command said beside its numbers."""
    others = result.other_notes if result.notes else ["Nothing: no damage and no warnings."]
    blocks = [Block("list", texts=result.damage, tone="problem"), Block("list", texts=others)]
    return Section("What the command said", blocks)
