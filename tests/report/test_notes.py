"""A note is its sentence, and carries to the end whether it tells of damage."""

import json
import pickle

from occmap.inspection.findings import LogFindings
from occmap.report import Note


def test_a_note_is_its_sentence_and_knows_of_damage() -> None:
    note = Note("line 3 is lost", damage=True)
    assert note == "line 3 is lost"
    assert type(note.text) is str
    assert json.dumps([note]) == '["line 3 is lost"]'


def test_damage_stays_damage_on_its_way() -> None:
    note = Note("line 3 is lost", damage=True)
    for sent in (note.placed("a.csv"), pickle.loads(pickle.dumps(note))):  # to a worker and back
        assert sent.damage
    assert note.placed("a.csv") == Note("a.csv: line 3 is lost", damage=True)


def test_a_result_parts_its_notes_by_what_they_are_and_not_by_what_they_say() -> None:
    note = Note("line 3 is lost", damage=True)
    found = LogFindings("a.csv", notes=(note, "line 3 is lost", "odd"))
    assert found.damage == (note,)
    assert found.other_notes == ["line 3 is lost", "odd"]
    plain = found.to_json()
    assert plain["notes"] == ["line 3 is lost", "line 3 is lost", "odd"]
    assert plain["damage"] == ["line 3 is lost"]
