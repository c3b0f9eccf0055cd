"""The page of an inspection: what `check` finds in logs."""

from pathlib import Path

from occmap.evidence.manifest import describe_files
from occmap.inspection import Inspection
from occmap.inspection.telling import describe_map
from occmap.page.document import Block, Page, Section, describe_maker, name_logs, write_page
from occmap.page.findings import tell_findings


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
