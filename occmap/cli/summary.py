"""A report as text: aligned lines for people; programs read the JSON."""

from occmap.remarks import hint_at_tune
from occmap.report import MapSummary, Report
from occmap.wording import count, write_box, write_counts

LABEL = 9
"""Width of the first column."""


def format_report(report: Report, seconds: float | None = None) -> list[str]:
    """Sum up a build in a dozen lines; `seconds` is how long it took, None for saved evidence."""
    lines = [
        ("map", format_size(report.map)),
        ("cells", format_shares(report.map)),
        ("agree", format_agreement(report.map)),
        ("update", format_update(report.map)),
        ("scans", format_scans(report)),
        ("dropped", write_counts(report.scans.dropped)),
        ("beams", "" if seconds is None else format_beams(report)),
        ("time", "" if seconds is None else format_time(report, seconds)),
        *(("" if index else "files", file) for index, file in enumerate(report.files)),
    ]
    return [f"{label:<{LABEL}}{text}" for label, text in lines if text]


def format_scans(report: Report) -> str:
    """Say how many scans were used, and what they were added to."""
    used = f"{report.scans.used:,} of {report.scans.read:,} used"
    if report.resumed:
        past = f"{report.resumed.used:,} of {report.resumed.read:,}"
        return f"{used}, added to {past} in {report.resumed.file}"
    if report.builds == 1:
        return used
    if report.scans.wanted < report.scans.read:  # most leave out what is in another one
        used = f"{report.scans.used:,} of {report.scans.wanted:,} asked for used"
    return f"{used}, in {count(report.builds, 'build')}"


def format_update(grid: MapSummary) -> str:
    """Say how observations came about, and what was made of them."""
    passes = "" if grid.min_passes is None else f", hits of {grid.min_passes} visits or more"
    return f"{grid.update}, model {grid.model}{passes}"


def format_size(grid: MapSummary) -> str:
    """Say how large the map is and where it lies."""
    cells = f"{grid.columns:,} x {grid.rows:,} cells of {grid.resolution:g} m"
    turned = f", turned by {grid.align:g} degrees" if grid.align else ""
    return f"{cells}, {write_box(grid.extent)}{turned}"


def format_shares(grid: MapSummary) -> str:
    """Say what the cells are; between occupied and free there may be undecided ones."""
    shares = {name: getattr(grid, name) for name in ("occupied", "free", "unknown", "undecided")}
    return ", ".join(f"{share:.1%} {name}" for name, share in shares.items() if share > 5e-4)


def format_agreement(grid: MapSummary) -> str:
    """Say how well the scans fit each other."""
    if grid.agreement is None:
        return ""
    return f"{grid.agreement:.1%} of the hits lie in occupied cells{hint_at_tune(grid.agreement)}"


def format_beams(report: Report) -> str:
    """Say what the beams of the used scans meant."""
    return f"{sum(report.beams):,}: {write_counts(report.beams.by_name)}"


def format_time(report: Report, seconds: float) -> str:
    """Say how long it took, and what took long; the stages of several threads add up."""
    rate = report.scans.used / max(seconds, 1e-9)
    stages = ", ".join(f"{name} {spent:.2f}" for name, spent in report.seconds.items())
    return f"{seconds:.2f} s, {rate:,.0f} scans/s ({stages})"
