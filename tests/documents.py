"""The project's pages: their blocks of code, and how to run the commands in them.

A block marked `console` is a session: each `$ command` must print what stands below it, where a
line `...` stands for any lines. A block marked `sh` holds commands that must succeed.
"""

import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from occmap.cli import run
from tests.samples import ROOT

PAGES = ("README.md", *sorted(str(p.relative_to(ROOT)) for p in ROOT.glob("docs/*.md")))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
TIMES = re.compile(r"[\d.,]+(?= s\b)|[\d,]+(?= scans/s)|(?<=[a-z] )\d+\.\d\d(?=[,)])")
"""Seconds and scans a second, which differ from run to run."""

FOR_A_SHELL = frozenset("$`*?~\\{\n();<>|&#")
"""What a command line has that takes more than splitting into words, even where it is quoted."""


class Block(NamedTuple):
    """Code on a page."""

    language: str
    code: str


def read_page(page: str) -> str:
    """The text of a page, by its path from the project's root."""
    return (ROOT / page).read_text(encoding="utf-8")


def list_blocks(page: str, *languages: str) -> list[Block]:
    """List the blocks of a page that are in one of some languages."""
    blocks = (Block(name, code) for name, code in FENCE.findall(read_page(page)))
    return [block for block in blocks if block.language in languages]


@dataclass(frozen=True)
class Step:
    """A command, and what it is to print; None: it is only to succeed."""

    command: str
    expected: str | None = None


def list_steps(block: Block) -> Iterator[Step]:
    """List the commands of a block in their order."""
    if block.language == "sh":
        lines = block.code.replace("\\\n", "").splitlines()
        yield from (Step(line) for line in lines if line.strip())
        return
    for part in re.split(r"^\$ ", block.code, flags=re.MULTILINE)[1:]:
        command, _, expected = part.partition("\n")
        yield Step(command, expected)


class Session:
    """Runs commands as one shell would, in a folder where `occmap` is this package."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.code = 0

    def run(self, command: str) -> str:
        """Run a command line; return what a terminal would show."""
        words = [] if FOR_A_SHELL & {*command} else shlex.split(command)
        return self._call(words[1:]) if words[:1] == ["occmap"] else self._ask_shell(command)

    def _call(self, words: list[str]) -> str:
        """Run occmap in this process: a process of its own takes a second to begin."""
        shown = io.StringIO()
        with chdir(self.folder), redirect_stdout(shown), redirect_stderr(shown):
            self.code = run(words)
        return shown.getvalue()

    def _ask_shell(self, command: str) -> str:
        script = (
            f'occmap() {{ "{sys.executable}" -u -m occmap "$@"; }}; (exit {self.code}); {command}'
        )
        done = subprocess.run(
            ["bash", "-c", script],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            cwd=self.folder,
        )
        self.code = done.returncode
        return done.stdout


def matches(printed: str, expected: str) -> bool:
    """Whether a text is what a page shows, but for times and for what `...` leaves out."""
    pattern = ".*".join(map(re.escape, "".join(blur(expected)).split("...\n")))
    return re.fullmatch(pattern, "".join(blur(printed)), re.DOTALL) is not None


def blur(text: str) -> list[str]:
    """The lines of a text, without times that differ from run to run."""
    return [
        TIMES.sub("#", line) if line.startswith("time ") else line
        for line in text.splitlines(keepends=True)
    ]
