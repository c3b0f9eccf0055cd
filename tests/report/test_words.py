"""One of a thing is written in the singular, and a stamp as a date where it is one."""

import pytest

from occmap.report import count, join_names, write_box, write_span, write_time


@pytest.mark.parametrize(
    ("number", "text"),
    [(0, "0 beams"), (1, "1 beam"), (2, "2 beams"), (1234567, "1,234,567 beams")],
)
def test_things_are_counted(number: int, text: str) -> None:
    assert count(number, "beam") == text


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


def test_a_noun_in_s_gets_es() -> None:
    assert [count(number, "miss") for number in (0, 1, 2)] == ["0 misses", "1 miss", "2 misses"]


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
