"""Notes: what a user should know of a log or a result, from where it is found to where it is told.

A note is its sentence, and knows besides whether it tells of damage.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from occmap.report.printed import Printed


class Note(str):
    """Something about a log that its user should know: lines passed over, a limit found, damage.

    It is one sentence; that of a reader does not name the log.
    """

    damage: bool
    """True: the log is not as its recorder meant it; the sentence says where, and what is lost."""

    def __new__(cls, text: str, damage: bool = False) -> "Note":
        """Make a note of a sentence."""
        made = super().__new__(cls, text)
        made.damage = damage
        return made

    @property
    def text(self) -> str:
        """The sentence alone."""
        return str(self)

    def placed(self, log: str | Path) -> "Note":
        """Name the log that it is about."""
        return Note(f"{log}: {self}", self.damage)

    def __eq__(self, other: object) -> bool:
        is_other = isinstance(other, Note) and other.damage != self.damage
        return str.__eq__(self, other) and not is_other

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = str.__hash__


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

    notes: Sequence[str]
    damage: tuple[str, ...]

    def __post_init__(self) -> None:
        found = tuple(note for note in self.notes if is_damage(note))
        object.__setattr__(self, "damage", found)

    @property
    def other_notes(self) -> list[str]:
        """The notes that do not tell of damage."""
        return [note for note in self.notes if not is_damage(note)]


def is_damage(note: str) -> bool:
    """Whether a note tells of damage; a plain sentence does not."""
    return isinstance(note, Note) and note.damage
