"""What commands say, as sections of a page."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from occmap.evidence.manifest import describe_files
from occmap.inspection.findings import Inspection, LogFindings
from occmap.inspection.telling import (
    describe_map,
    list_kinds,
    list_pose_facts,
    list_repeated,
    list_scan_facts,
    tell_crossed,
    tell_ranges,
    tell_sources,
)
from occmap.page.document import (
    Block,
    Page,
    Section,
    Tone,
    describe_maker,
    name_logs,
    write_page,
)
from occmap.readers import Role
from occmap.remarks import drop_damage
from occmap.wording import count

MOST_LOGS = 20
"""With all that is found in them; warnings and problems are those of all logs."""


def tell_notes(notes: Sequence[str], damage: Sequence[str]) -> Section:
    """Say what the command said beside its numbers."""
    plain = drop_damage(notes, damage)
    blocks = [Block("list", texts=damage, tone="problem")] if damage else []
    blocks += [Block("list", texts=plain)] if plain else []
    said = blocks or [Block("list", texts=["Nothing: no damage and no warnings."])]
    return Section("What the command said", said, wide=True)


def tell_findings(found: Inspection) -> Iterator[Section]:
    """Say what `check` finds in logs."""
    said: list[tuple[Tone, Sequence[str]]] = [
        ("problem", found.problems),
        ("warning", found.warnings),
    ]
    blocks = [Block("list", texts=texts, tone=tone) for tone, texts in said if texts]
    if not blocks:
        blocks = [Block("list", texts=["No problems, no warnings."])]
    if found.command:
        blocks.append(Block("code", title="Recommended", texts=[shlex.join(found.command)]))
    yield Section("What check finds", blocks, wide=True)
    for log in found.logs[:MOST_LOGS]:
        yield Section(f"In {log.path}", list(list_log(log)), wide=True)
    if others := len(found.logs[MOST_LOGS:]):
        rest = [Block("list", texts=[f"{count(others, 'more log')}: see `occmap check`"])]
        yield Section("And", rest, wide=True)


def list_log(log: LogFindings) -> Iterator[Block]:
    """All about one log."""
    if log.damage:
        yield Block("list", title="Damage", texts=log.damage, tone="problem")
    if notes := drop_damage(log.notes, log.damage):
        yield Block("list", title="Notes", texts=notes)
    if log.streams:
        streams = [
            (each.topic, each.type, f"{each.count:,}", each.role.replace(Role.OTHER, ""))
            for each in log.streams
        ]
        yield Block("table", streams, ("topic", "type", "#messages", "used as"), title="Topics")
    for topic in log.scans:
        facts = [*list_scan_facts(topic), ("ranges", tell_ranges(topic.ranges))]
        crossed = tell_crossed(topic.ranges)
        facts += [("", crossed)] if crossed else []
        yield Block("facts", [*facts, *list_pose_facts(topic)], title=f"Scans on {topic.topic}")
        repeated = (
            (f"{metres} m, repeated", "", share, meaning)
            for metres, share, meaning in list_repeated(topic.ranges)
        )
        kinds = [*list_kinds(topic.ranges), *repeated]
        if kinds:
            yield Block("table", kinds, ("range", "#values", "#share", "what it means"))
    if log.coverage:
        yield Block("list", title="Pose sources", texts=tell_sources(log.coverage))


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
        facts = [("size", describe_map(inspection.map))]
        sections.append(Section("The map that they would make", [Block("facts", facts)], wide=True))
    inputs = [entry for log in logs if log.exists() for entry in describe_files(log)]
    page = Page(f"Check of {names}", verdict, [*sections, describe_maker(inputs)])
    write_page(path, page)
