"""A note is its sentence, and carries to the end whether it tells of damage."""

import json
import pickle

from occmap.inspection.findings import LogFindings
from occmap.report import Note, fold_notes


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


def test_what_holds_for_several_logs_is_said_once_and_damage_for_each() -> None:
    logs = [f"{number}.csv" for number in range(9)]
    odd, lost = Note("odd"), Note("line 3 is lost", damage=True)
    notes = ["first", *(each.placed(log) for log in logs for each in (odd, lost)), "last"]
    first, folded, *damage, last = fold_notes(notes)
    assert (first, last) == ("first", "last")
    assert folded == "0.csv, 1.csv, 2.csv, 3.csv, 4.csv, 5.csv and 3 more: odd"
    assert damage == [lost.placed(log) for log in logs]
    assert fold_notes([first, folded, *damage, last]) == (first, folded, *damage, last)
    assert fold_notes([odd.placed("a.csv"), odd.placed("a.csv")]) == ("a.csv: odd",)
