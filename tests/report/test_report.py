"""Notes tell of damage to the end; one thing is singular, and a stamp a date where it is one."""

import json
import pickle

import pytest

from occmap.inspection.findings import LogFindings
from occmap.report import Note, count, fold_notes, join_names, write_box, write_span, write_time


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


@pytest.mark.parametrize(
    ("number", "beams", "misses"),
    [(0, "0 beams", "0 misses"), (1, "1 beam", "1 miss"), (12345, "12,345 beams", "12,345 misses")],
)
def test_things_are_counted(number: int, beams: str, misses: str) -> None:
    assert (count(number, "beam"), count(number, "miss")) == (beams, misses)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ("", "none"),
        ("a", "a"),
        ("abcdef", "a, b, c, d, e, f"),
        ("abcdefgh", "a, b, c, d, e, f and 2 more"),
    ],
)
def test_of_many_names_the_first_are_listed(names: str, text: str) -> None:
    assert join_names(names) == text


@pytest.mark.parametrize(
    ("stamp_ns", "text"),
    [
        (1_500_000_000, "1.500 s"),
        (-1_500_000_000, "-1.500 s"),
        (631_151_999_999_999_999, "631152000.000 s"),
        (631_152_000_000_000_000, "631152000.000 s (1990-01-01 00:00:00 UTC)"),
        (1_700_000_000_999_000_000, "1700000000.999 s (2023-11-14 22:13:20 UTC)"),
        (2**63 - 1, "9223372036.855 s"),
    ],
)
def test_stamps_are_dates_where_they_can_be(stamp_ns: int, text: str) -> None:
    assert write_time(stamp_ns) == text


def test_a_span_has_the_date_of_its_begin() -> None:
    assert write_span(-1_000_000_000, 2_500_000_000) == "-1.000 to 2.500 s"
    begin = 1_700_000_000_000_000_000
    text = "1700000000.000 to 1700000000.250 s (2023-11-14 22:13:20 UTC)"
    assert write_span(begin, begin + 250_000_000) == text


def test_coordinates_of_a_globe_keep_their_centimetres() -> None:
    box = (499997.9, 4999997.8, 500002.95, 5000002.05)
    assert write_box(box) == "x 499997.9 to 500002.95 m, y 4999997.8 to 5000002.05 m"
    assert write_box((-81 * 0.05, 0.0, 0.1 + 0.2, 7.0)) == "x -4.05 to 0.3 m, y 0 to 7 m"
