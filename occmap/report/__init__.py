"""Results as JSON values with the schema of their types, and the words of commands for people.

`occmap schema` works out a JSON Schema from such types, and takes descriptions from the text below
each field.
"""

import ast
import inspect
import math
import re
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias, TypeGuard, cast, get_type_hints

Count: TypeAlias = Annotated[int, ("minimum", 0)]
Share: TypeAlias = Annotated[float, ("minimum", 0), ("maximum", 1)]
Finite: TypeAlias = Annotated[float, ("type", ("number", "null"))]
"""A number that becomes null where it is infinite or not a number."""

HIDDEN = {"printed": ""}
"""Metadata of a dataclass field that is not part of what is printed"""
IN_PLACE = {"printed": "*"}
"""Metadata of a dataclass field whose own fields are printed in its place"""


def printed_as(name: str) -> dict[str, str]:
    """Make the metadata of a dataclass field that is printed by another name."""
    return {"printed": name}


class Printed:
    """What a command finds, and prints: its fields, but for the HIDDEN ones."""

    def to_json(self) -> dict[str, Any]:
        """Give it as values that JSON has; a number that is not finite becomes None."""
        plain: dict[str, Any] = to_plain(self)
        return plain

    def add_notes(self, notes: Iterable[str]) -> Self:
        """Give a result that has notes with others before them."""
        result: Any = self
        return cast(Self, replace(result, notes=(*notes, *result.notes)))


def list_printed(kind: Any) -> dict[str, str]:
    """List the fields of a dataclass that are printed, and by which names."""
    names = {each.name: each.metadata.get("printed", each.name) for each in fields(kind)}
    return {name: printed for name, printed in names.items() if printed}


def to_plain(value: Any) -> Any:
    """Turn a result into JSON values; a number that is not finite becomes None."""
    if is_dataclass(value):
        parts: dict[str, Any] = {}
        for name, printed in list_printed(value).items():
            part = to_plain(getattr(value, name))
            parts |= part if printed == "*" else {printed: part}
        return parts
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def read_texts(kind: Any) -> dict[str, str]:
    """Read the text below each field of a type and of those that it extends.

    An install without sources has no texts: there each is the name of the field.
    """
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    except OSError:
        return {name: name for name in get_type_hints(kind)}
    assert isinstance(tree, ast.ClassDef)
    known = vars(sys.modules[kind.__module__])
    texts: dict[str, str] = {}
    for base in (known.get(ast.unparse(base)) for base in tree.bases):
        if is_dataclass(base):
            texts |= read_texts(base)
    for field, text in zip(tree.body, tree.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            texts[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return texts


MOST_NAMES = 6
"""How many names a list shows: people do not read longer ones"""
DATES_S = range(631_152_000, 4_102_444_800)
"""Stamps from 1990 to 2100 are dates; others count from some start"""
STDIN_FOLDER = "occmap-stdin-"
"""How the temporary folder is called in which a log from stdin is kept while a command runs"""

Row: TypeAlias = tuple[str, str]
"""A label, "" where it is that of the row before, and a text"""


def label_first(label: str, texts: Iterable[str]) -> list[Row]:
    """Label the first of several rows."""
    return [("" if index else label, text) for index, text in enumerate(texts)]


def count(number: float, noun: str) -> str:
    """Write how many there are: 1 beam, 2,000 beams, 2.875 misses."""
    ending = "" if number == 1 else "es" if noun.endswith("s") else "s"
    return f"{number:,.15g} {noun}{ending}"


def join_names(names: Iterable[str], most: int = MOST_NAMES) -> str:
    """Write names as a list; of many only the first, and how many more there are."""
    names = tuple(names)
    more = f" and {len(names) - most:,} more" if len(names) > most else ""
    return (", ".join(names[:most]) or "none") + more


def write_counts(counts: Mapping[str, int]) -> str:
    """List how many there are of each kind; zeros are left out."""
    return ", ".join(f"{number:,} {name}" for name, number in counts.items() if number)


def write_unused(scans: int, reasons: Mapping[str, int]) -> str:
    """Say why none of so many scans is used."""
    return f"none of {scans:,} scans can be used: {write_counts(reasons)}"


def write_metres(places: Iterable[float]) -> list[str]:
    """Write coordinates (m), with the digits that those of a globe need (UTM)."""
    return [f"{place:.10g}" for place in places]


def write_box(box: Sequence[float]) -> str:
    """Write the edges of a box, given as lowest x and y, highest x and y (m)."""
    low_x, low_y, high_x, high_y = write_metres(box)
    return f"x {low_x} to {high_x} m, y {low_y} to {high_y} m"


def write_duration(seconds: float) -> str:
    """Write a duration in seconds, from an hour on also in hours."""
    if seconds < 100:
        return f"{seconds:.3g} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{seconds:,.0f} s" + (f" ({hours:,} h {minutes} min)" if seconds >= 3600 else "")


def write_time(stamp_ns: int) -> str:
    """Write a stamp in seconds as in the log, and as a date where it is one."""
    return f"{stamp_ns / 1e9:.3f} s{_date(stamp_ns)}"


def write_span(start_ns: int, end_ns: int) -> str:
    """Write two stamps in seconds as in the log, and the first as a date where it is one."""
    return f"{start_ns / 1e9:.3f} to {end_ns / 1e9:.3f} s{_date(start_ns)}"


def _date(stamp_ns: int) -> str:
    if stamp_ns // 1_000_000_000 not in DATES_S:
        return ""
    date = datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC)
    return f" ({date:%Y-%m-%d %H:%M:%S} UTC)"


def name_stdin(text: str) -> str:
    """Call a log that came on stdin `-` in a text that names the file in which it is kept."""
    if STDIN_FOLDER not in text:
        return text
    from tempfile import gettempdir  # noqa: PLC0415  late: few texts need it

    return re.sub(rf"{re.escape(gettempdir())}[/\\]{STDIN_FOLDER}\w+[/\\]-", "-", text)


class Note(str):
    """Something about a log that its user should know: lines passed over, a limit found, damage.

    It is one sentence; that of a reader does not name the log.
    """

    damage: bool
    """True: the log is not as its recorder meant it; the sentence says where, and what is lost."""
    log: str
    """The log that it names; "" where it names none"""
    text: str
    """The sentence without it"""

    def __new__(cls, text: str, damage: bool = False, log: str = "") -> "Note":
        """Make a note of a sentence."""
        made = super().__new__(cls, f"{log}: {text}" if log else text)
        made.damage, made.log, made.text = damage, log, str(text)
        return made

    def placed(self, log: str | Path) -> "Note":
        """Name the log that it is about."""
        return Note(self, self.damage, str(log))


class NoteList(list[Note]):
    """Notes, each once however often the log is read; a damaged log may give very many."""

    def __init__(self, notes: Iterable[Note] = ()) -> None:
        super().__init__(notes)
        self._known = set(self)

    def append(self, note: Note) -> None:
        """Add a note unless it is there."""
        if note not in self._known:
            super().append(note)
            self._known.add(note)

    def add(self, text: str) -> None:
        """Add what the user should know, as one sentence."""
        self.append(Note(text))

    def add_damage(self, text: str) -> None:
        """Add what is damaged, where, and what is lost."""
        self.append(Note(text, damage=True))


class Noted(Printed):
    """A result with notes; those that tell of damage are printed by themselves, too.

    It is a dataclass with the fields `notes`, and `damage`, which is not given but found.
    """

    notes: tuple[str, ...]
    damage: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "notes", fold_notes(self.notes))
        object.__setattr__(self, "damage", tuple(filter(is_damage, self.notes)))

    @property
    def other_notes(self) -> list[str]:
        """The notes that do not tell of damage."""
        return [note for note in self.notes if not is_damage(note)]


def fold_notes(notes: Iterable[str]) -> tuple[str, ...]:
    """Say once what holds for several logs, where it is said first; damage stays as it is."""
    logs: dict[tuple[str, bool], dict[str, None]] = {}
    for note in notes:
        log, text = "", note
        if isinstance(note, Note) and not note.damage:  # each of these stands for itself
            log, text = note.log, note.text
        logs.setdefault((text, is_damage(note)), {})[log] = None
    return tuple(f"{join_names(it)}: {text}" if any(it) else text for (text, _), it in logs.items())


def is_damage(note: str) -> TypeGuard[Note]:
    """Whether a note tells of damage; a plain sentence does not."""
    return isinstance(note, Note) and note.damage
