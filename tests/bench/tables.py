"""Results as text: one table for each thing that was measured."""

from collections.abc import Iterable, Mapping, Sequence

from tests.bench.engine import Figure
from tests.bench.limits import Row
from tests.bench.logs import WHOLE, Stages
from tests.bench.workloads import Workload


def draw(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column is set left and the others right."""
    lines = [list(head), *map(list, body)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    text = [
        "| " + " | ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) + " |"
        for line in (lines[0], rule, *lines[1:])
    ]
    return "\n".join(text) + "\n"


def draw_engine(workload: Workload, figures: Sequence[Figure]) -> str:
    """Microseconds a scan and cells a second on one workload."""
    title = (
        f"\n{workload.name}: {workload.scans} scans x {workload.sensor.beams} beams, mean range "
        f"{workload.mean_range:.1f} m, {workload.resolution} m cells, one thread\n\n"
    )
    base = figures[0].microseconds
    rows = []
    for figure in figures:
        spent, cells = figure.microseconds, figure.cells_per_second / 1e6
        rows.append((figure.name, f"{spent:.1f}", f"{spent / base:.2f}", f"{cells:.0f}"))
    return title + draw(("", "us a scan", f"/ {figures[0].name}", "M cells/s"), rows)


def draw_stages(scans: int, formats: Mapping[str, Stages]) -> str:
    """Thousand scans a second by stage and format."""
    stages = list(next(iter(formats.values())))
    title = (
        f"\nThousand scans a second by stage: build polygon, {scans} scans x 1081 beams, "
        f"one thread, the shortest of some builds ({WHOLE}: all stages; everything is loaded)\n\n"
    )
    rows = [
        (name, *(f"{scans / found[stage] / 1000:.1f}" for stage in stages))
        for name, found in formats.items()
    ]
    return title + draw(("", *stages), rows)


def draw_rows(rows: Sequence[Row]) -> str:
    """The figures that have a limit."""
    body = []
    for row in rows:
        value = "-" if row.value is None else f"{row.value:.2f}"
        body.append((row.what, value, f"{row.limit:.2f}", row.verdict, row.detail))
    return "\nLimits\n\n" + draw(("", "measured", "at most", "", "from"), body)
