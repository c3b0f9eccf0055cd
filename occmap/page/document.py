"""The document: texts, tables and plots as one HTML file that asks for nothing else."""

import json
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any, Literal

from occmap.options import spell_flags
from occmap.report.words import join_names, name_stdin
from occmap.writers.atomic import open_atomic

HERE = Path(__file__).parent
MOST_NAMES = 3
"""Logs that a title names at most"""


@dataclass(frozen=True)
class Block:
    """A part of a section; one that holds nothing is not shown."""

    kind: Literal["facts", "table", "list", "code", "plot"]
    rows: Sequence[Sequence[Any]] = ()
    """The rows of a table, or names and values"""
    head: Sequence[str] = ()
    """Names of the columns of a table; one that begins with # holds numbers"""
    texts: Sequence[str] = ()
    """Items of a list, or lines of code"""
    tone: Literal["", "warning", "problem"] = ""
    title: str = ""
    plot: Any = None
    """A Bokeh figure"""


@dataclass(frozen=True)
class Section:
    """A card of the page."""

    title: str
    blocks: Sequence[Block]
    wide: bool = True
    """Whether it is as wide as the page"""


@dataclass(frozen=True)
class Stage:
    """Maps to look at, beside what there is under the pointer."""

    plots: Sequence[Any]
    """Bokeh figures, which are called map-0, map-1 ..."""
    titles: Sequence[str]
    data: Mapping[str, Any]
    """What the script knows of them; see page.js"""
    arrays: Mapping[str, str]
    """Packed arrays as text, by their name"""
    note: str = ""
    """What of the map is not shown as it is"""


@dataclass(frozen=True)
class Page:
    """What is on a page."""

    title: str
    subtitle: str
    sections: Sequence[Section]
    stage: Stage | None = None


def write_page(path: Path, page: Page) -> None:
    """Write a page.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    with open_atomic(path) as (file,):
        file.write(compose(page).encode("utf-8", "replace"))


def compose(page: Page) -> str:
    """Compose the HTML; whatever logs and files are called, it is text and nothing else."""
    from bokeh.embed import components  # noqa: PLC0415  an extra, and late: it takes long to load
    from bokeh.resources import Resources  # noqa: PLC0415  likewise
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415  likewise

    of_sections = [b.plot for each in page.sections for b in each.blocks if b.kind == "plot"]
    figures = [*(page.stage.plots if page.stage else ()), *of_sections]
    script, divs = components(figures) if figures else ("", ())
    of_stage = len(page.stage.plots) if page.stage else 0
    resources = Resources("inline", components=["bokeh"], minified=True)
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["spell"] = spell_flags
    html = environment.get_template("page.html").render(
        page=page,
        maps=divs[:of_stage],
        plots=iter(divs[of_stage:]),
        bokeh=resources.render() + script if figures else "",
        style=(HERE / "page.css").read_text(),
        script=(HERE / "page.js").read_text(),
        data=to_script(page.stage.data if page.stage else {}),
    )
    return name_stdin(html)


def to_script(value: Any) -> str:
    """Write JSON that ends no script, whatever names are in it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def name_logs(names: Iterable[str]) -> str:
    """Name logs in a title; of a folder, the inputs are called folder/file."""
    distinct = dict.fromkeys(name.partition("/")[0] for name in names)
    return join_names(distinct, MOST_NAMES)


def describe_maker(inputs: Iterable[Mapping[str, Any]]) -> Section:
    """Say which command made the page, with which versions, of which files."""
    blocks = []
    program = Path(sys.argv[0])
    if "occmap" in {program.stem, program.parent.name}:  # else a program of somebody else's
        blocks.append(Block("code", texts=[shlex.join(["occmap", *sys.argv[1:]])]))
    versions = ", ".join(f"{name} {version(name)}" for name in ("occmap", "numpy", "bokeh"))
    blocks.append(Block("facts", rows=[("versions", f"{versions}, Python {python_version()}")]))
    files = [(each["name"], f"{each['bytes']:,}", each["sha256"]) for each in inputs]
    blocks.append(Block("table", files, ("file", "#bytes", "SHA-256")))
    return Section("How it was made", blocks)
