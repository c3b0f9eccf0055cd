"""A report as text: aligned lines for people; programs read the JSON."""

from collections.abc import Iterator

from occmap.report import Report
from occmap.wording import count, write_box, write_counts

LABEL = 9
"""Width of the first column."""


def format_report(report: Report, seconds: float) -> list[str]:
    """Sum up a build in a dozen lines; `seconds` is how long it took on the clock."""
    lines = [
        ("map", format_size(report)),
        ("cells", format_shares(report)),
        ("agree", format_agreement(report)),
        ("update", format_update(report)),
        ("scans", format_scans(report)),
        ("dropped", write_counts(report.dropped)),
        ("beams", format_beams(report)),
        ("time", format_time(report, seconds)),
        *label_files(report),
    ]
    return [f"{label:<{LABEL}}{text}" for label, text in lines if text]


def format_scans(report: Report) -> str:
    """Say how many scans were used, and what they were added to."""
    used = f"{report.scans_used:,} of {report.scans_read:,} used"
    if report.resumed:
        past = f"{report.resumed.scans_used:,} of {report.resumed.scans_read:,}"
        return f"{used}, added to {past} in {report.resumed.file}"
    if report.builds == 1:
        return used
    if report.scans_wanted < report.scans_read:  # most leave out what is in another one
        used = f"{report.scans_used:,} of {report.scans_wanted:,} asked for used"
    return f"{used}, in {count(report.builds, 'build')}"


def format_update(report: Report) -> str:
    """Say how observations came about, and what was made of them."""
    passes = "" if report.min_passes is None else f", hits of {report.min_passes} visits or more"
    return f"{report.update}, model {report.model}{passes}"


def format_size(report: Report) -> str:
    """Say how large the map is and where it lies."""
    cells = f"{report.columns:,} x {report.rows:,} cells of {report.resolution:g} m"
    turned = f", turned by {report.align:g} degrees" if report.align else ""
    return f"{cells}, {write_box(report.extent)}{turned}"


def format_shares(report: Report) -> str:
    """Say what the cells are; between occupied and free there may be undecided ones."""
    names = ("occupied", "free", "unknown", "undecided")
    shares = (*report.shares, report.undecided)
    pairs = zip(names, shares, strict=True)
    return ", ".join(f"{share:.1%} {name}" for name, share in pairs if share > 5e-4)


def format_agreement(report: Report) -> str:
    """Say how well the scans fit each other."""
    if report.agreement is None:
        return ""
    return f"{report.agreement:.1%} of the hits lie in occupied cells"


def format_beams(report: Report) -> str:
    """Say what the beams of the used scans meant."""
    return f"{sum(report.beams):,}: {write_counts(report.beams.by_name)}"


def format_time(report: Report, seconds: float) -> str:
    """Say how long it took, and what took long; the stages of several threads add up."""
    rate = report.scans_used / max(seconds, 1e-9)
    stages = ", ".join(f"{name} {spent:.2f}" for name, spent in report.seconds.items())
    return f"{seconds:.2f} s, {rate:,.0f} scans/s ({stages})"


def label_files(report: Report) -> Iterator[tuple[str, str]]:
    """List the files that were written, one a line."""
    for index, file in enumerate(report.files):
        yield "" if index else "files", file
