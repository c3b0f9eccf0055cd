"""What a report says, in words that a terminal and a page lay out: labels, and a text for each."""

from occmap.remarks import hint_at_tune
from occmap.report import MapSummary, Report
from occmap.wording import count, write_box, write_counts

Row = tuple[str, str]


def tell_map(grid: MapSummary) -> list[Row]:
    """Say how large a map is, what its cells are, how well scans fit it, and how it was made."""
    size = f"{grid.columns:,} x {grid.rows:,} cells of {grid.resolution:g} m"
    turned = f", turned by {grid.align:g} degrees" if grid.align else ""
    # Between occupied and free there may be undecided cells.
    shares = {name: getattr(grid, name) for name in ("occupied", "free", "unknown", "undecided")}
    cells = ", ".join(f"{share:.1%} {name}" for name, share in shares.items() if share > 5e-4)
    rows = [("map", f"{size}, {write_box(grid.extent)}{turned}"), ("cells", cells)]
    if grid.agreement is not None:
        found = f"{grid.agreement:.1%} of the hits lie in occupied cells"
        rows.append(("agree", found + hint_at_tune(grid.agreement)))
    passes = "" if grid.min_passes is None else f", hits of {grid.min_passes} visits or more"
    return [*rows, ("update", f"{grid.update}, model {grid.model}{passes}")]


def tell_scans(report: Report) -> list[Row]:
    """Say how many scans were used, what they were added to, and why others were not used."""
    used = f"{report.scans.used:,} of {report.scans.read:,} used"
    if report.resumed:
        past = f"{report.resumed.used:,} of {report.resumed.read:,}"
        used = f"{used}, added to {past} in {report.resumed.file}"
    elif report.builds > 1:
        if report.scans.wanted < report.scans.read:  # most leave out what is in another one
            used = f"{report.scans.used:,} used of {report.scans.wanted:,} asked for"
        used = f"{used}, in {count(report.builds, 'build')}"
    dropped = write_counts(report.scans.dropped)
    return [("scans", used), *([("dropped", dropped)] if dropped else [])]


def tell_beams(report: Report) -> Row:
    """Say what the beams of the used scans meant."""
    return "beams", f"{sum(report.beams):,}: {write_counts(report.beams.by_name)}"
