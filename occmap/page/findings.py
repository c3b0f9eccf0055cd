"""What commands say in JSON, as sections of a page: the figures are those of the JSON."""

import math
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from occmap.page.document import Block, Section, Tone
from occmap.wording import count, write_box, write_span

Json = Mapping[str, Any]
MOST_LOGS = 20
"""With all that is found in them; warnings and problems are those of all logs."""


def tell_map(report: Json) -> Section:
    """Say what a map is, from the JSON of `build` or `render`."""
    grid = report["map"]
    shares = ("occupied", "free", "undecided", "unknown")
    rows = [
        ("size", f"{grid['columns']:,} x {grid['rows']:,} cells of {grid['resolution']:g} m"),
        ("extent", write_box(grid["extent"])),
        ("cells", ", ".join(f"{grid[name]:.1%} {name}" for name in shares if grid[name] > 5e-4)),
    ]
    if grid["agreement"] is not None:
        rows.append(("agreement", f"{grid['agreement']:.1%} of the hits lie in occupied cells"))
    rows += [("update", grid["update"]), ("model", grid["model"])]
    if grid["min_passes"] is not None:
        rows.append(("hits kept", f"of {grid['min_passes']} visits or more"))
    return Section("The map", [Block("facts", rows)])


def tell_scans(report: Json) -> Section:
    """Say what became of scans and beams."""
    scans, beams = report["scans"], report["beams"]
    used = f"{scans['used']:,} of {scans['read']:,} used"
    rows = [("scans", used)]
    rows += [("dropped", f"{number:,} {why}") for why, number in scans["dropped"].items()]
    if report["resumed"]:
        past = report["resumed"]
        rows.append(("added to", f"{past['used']:,} of {past['read']:,} in {past['file']}"))
    rows += [
        (name.replace("_", " "), f"{number:,} beams") for name, number in beams.items() if number
    ]
    return Section("Scans and beams", [Block("facts", rows)])


def tell_notes(notes: Iterable[str], damage: Iterable[str] = ()) -> Section:
    """Say what the command said beside its numbers."""
    damaged = list(damage)
    plain = [note for note in notes if note not in damaged]
    blocks = [Block("list", texts=damaged, tone="problem")] if damaged else []
    blocks += [Block("list", texts=plain)] if plain else []
    said = blocks or [Block("list", texts=["Nothing: no damage, no doubts."])]
    return Section("What the command said", said, wide=True)


def tell_findings(findings: Json) -> Iterator[Section]:
    """Say what `check` finds in logs."""
    tones: tuple[Tone, ...] = ("problem", "warning")
    blocks = [
        Block("list", texts=findings[f"{tone}s"], tone=tone)
        for tone in tones
        if findings[f"{tone}s"]
    ]
    if findings["command"]:
        blocks.append(Block("code", title="Recommended", texts=[shlex.join(findings["command"])]))
    if not (findings["problems"] or findings["warnings"]):
        blocks.insert(0, Block("list", texts=["No problems, no warnings."]))
    yield Section("What check finds", blocks, wide=True)
    others = findings["logs"][MOST_LOGS:]
    for log in findings["logs"][:MOST_LOGS]:
        yield Section(f"In {log['path']}", list(list_log(log)), wide=True)
    if others:
        rest = [Block("list", texts=[f"{count(len(others), 'more log')}: see `occmap check`"])]
        yield Section("And", rest, wide=True)


def list_log(log: Json) -> Iterator[Block]:
    """All about one log."""
    if log["damage"]:
        yield Block("list", title="Damage", texts=log["damage"], tone="problem")
    notes = [note for note in log["notes"] if note not in log["damage"]]
    if notes:
        yield Block("list", title="Notes", texts=notes)
    if log["streams"]:
        rows = [
            (each["topic"], each["type"], f"{each['count']:,}", each["role"].replace("other", ""))
            for each in log["streams"]
        ]
        yield Block("table", rows, ("topic", "type", "#messages", "used as"), title="Topics")
    for topic in log["scans"]:
        yield from list_topic(topic)
    moving = [each for each in log["coverage"] if each["moves"]]
    if moving:
        head = ("transform", "topic", "#samples", "#largest gap (s)", "#largest step (m)", "#(deg)")
        yield Block("table", [list_source(each) for each in moving], head, title="Pose sources")


def list_source(source: Json) -> tuple[str, ...]:
    """A row of the table of pose sources."""
    name = f"{source['parent']} \u2192 {source['child'] or '?'}"
    step = f"{source['largest_step_m']:.3g}", f"{math.degrees(source['largest_step_rad']):.3g}"
    gap = f"{source['largest_gap_s']:.3g}"
    return name, source["topic"], f"{source['samples']:,}", gap, *step


def list_topic(topic: Json) -> Iterator[Block]:
    """All about the scans of one topic."""
    times, poses, mount = topic["times"], topic["poses"], topic["mount"]
    facts = [
        (
            "scans",
            f"{topic['scans']:,} in {times['duration_s']:.6g} s, "
            f"frame {', '.join(topic['frames'])}",
        ),
        ("rate", f"{times['rate_hz']:.3g} a second, largest gap {times['largest_gap_s']:.3g} s"),
        ("time", write_span(times["start_ns"], times["end_ns"])),
        (
            "clocks",
            f"{times['offset_s']:.3g} s from the record times, drift {times['drift_s']:.2g} s",
        ),
    ]
    if times["jumps_back"]:
        facts.append(
            ("jumps back", f"{times['jumps_back']:,}, up to {times['largest_jump_back_s']:.3g} s")
        )
    way = "stated beside the scans" if poses["stated"] else " \u2192 ".join(poses["chain"])
    facts.append(("poses", f"{poses['posed']:,} of {count(topic['scans'], 'scan')}; {way}"))
    facts += [
        ("left out", f"{n:,} {why}") for why, n in {**topic["left_out"], **poses["dropped"]}.items()
    ]
    if mount is not None:
        turned = "upside down" if mount["upside_down"] else "upright"
        tilt = math.degrees(mount["tilt"])
        facts.append(("mount", f"{turned}, tilted {tilt:.1f} deg, z {mount['height']:.3g} m"))
    if topic["agreement"] is not None:
        facts.append(
            ("agreement", f"{topic['agreement']:.0%} of the hits of a sample lie in occupied cells")
        )
    facts += [("shape", describe_shape(shape)) for shape in topic["shapes"]]
    yield Block("facts", facts, title=f"Scans on {topic['topic']}")
    yield Block(
        "table", list(list_ranges(topic["ranges"])), ("range", "#values", "#share", "what it means")
    )


def describe_shape(shape: Json) -> str:
    """Say where beams point and how far they reach."""
    view = math.degrees(max(shape["beams"] - 1, 0) * abs(shape["angle_increment"] or 0))
    reach = "without limit" if shape["range_max"] is None else f"to {shape['range_max']:.6g} m"
    return f"{shape['scans']:,} of {shape['beams']:,} beams over {view:.4g} deg, ranges {reach}"


def list_ranges(ranges: Json) -> Iterator[Sequence[str]]:
    """The rows of the table of ranges: what is measured, and what else values mean."""
    total = max(ranges["total"], 1)
    if ranges["measured"]:
        span = f"{ranges['smallest']:.3g} to {ranges['largest']:.4g} m"
        yield span, f"{ranges['measured']:,}", f"{ranges['measured'] / total:.1%}", "measured"
    for each in ranges["specials"]:
        advice = f"; `no_return={each['no_return']}`" if each["no_return"] else "; skipped"
        yield each["name"], f"{each['count']:,}", f"{each['share']:.1%}", each["meaning"] + advice
    for each in ranges["repeated"]:
        meaning = "no return, by the limit" if each["is_no_return"] else "may mean no return"
        yield f"{each['value']:.6g} m, repeated", "", f"{each['share']:.1%}", meaning
