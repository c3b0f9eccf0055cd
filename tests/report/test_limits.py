"""Limits as they are typed: what they mean, when they hold, and what is said of them."""

import pytest

from occmap.errors import UsageError
from occmap.report.limits import COUNT, SHARE, Measure, parse_limit

MEASURES = (
    Measure("lost", SHARE, lambda result: result["lost"]),
    Measure("scans", COUNT, lambda result: result["scans"]),
    Measure("gap", "s", lambda result: result["gap"]),
)


def fails(text: str, **result: float) -> list[str]:
    failed = parse_limit(text, MEASURES).find_failure(result)
    return [failed.sentence] if failed else []


@pytest.mark.parametrize(
    ("sign", "low", "same", "high"),
    [
        ("<", True, False, False),
        ("<=", True, True, False),
        (">", False, False, True),
        (">=", False, True, True),
        ("==", False, True, False),
        ("!=", True, False, True),
    ],
)
def test_every_sign_below_at_and_above_the_bound(
    sign: str, low: bool, same: bool, high: bool
) -> None:
    assert [bool(fails(f"scans {sign} 5", scans=n)) for n in (4, 5, 6)] == [low, same, high]


@pytest.mark.parametrize("text", ["lost > 5%", "lost>5%", " lost  >  0.05 ", "lost > 5e-2"])
def test_a_share_is_a_part_or_a_percentage(text: str) -> None:
    assert fails(text, lost=0.051)
    assert not fails(text, lost=0.05)


@pytest.mark.parametrize(
    ("text", "result", "sentence"),
    [
        ("lost > 5%", {"lost": 0.072}, "lost is 7.2%, and `limits` says > 5%"),
        ("lost > 0.05", {"lost": 0.072}, "lost is 7.2%, and `limits` says > 5%"),
        ("lost > 5%", {"lost": 0.0500012}, "lost is 5.00012%, and `limits` says > 5%"),
        ("lost>=0%", {"lost": 0.0}, "lost is 0%, and `limits` says >= 0%"),
        ("lost > 7%", {"lost": 1 / 3}, "lost is 33.3%, and `limits` says > 7%"),
        ("scans < 1234568", {"scans": 1234567}, "scans is 1234567, and `limits` says < 1234568"),
        ("gap > 2", {"gap": 2.25}, "gap is 2.25, and `limits` says > 2"),
        ("gap > -1.5", {"gap": -1.25}, "gap is -1.25, and `limits` says > -1.5"),
        ("gap != 1", {"gap": 1 + 2**-50}, "gap is 1.0000000000000009, and `limits` says != 1"),
    ],
)
def test_the_sentence_tells_the_value_from_the_bound(
    text: str, result: dict[str, float], sentence: str
) -> None:
    assert fails(text, **result) == [sentence]


@pytest.mark.parametrize("text", ["0.1%", "7%", "12.5%", "100%"])
def test_a_limit_is_written_as_it_is_read(text: str) -> None:
    assert parse_limit(f"lost > {text}", MEASURES).condition == f"> {text}"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", 'is not a limit; write NAME, one of < <= > >= == != and a number, such as "lost > '),
        ("lost", "is not a limit"),
        ("lost 5%", "is not a limit"),
        ("lost = 5%", "is not a limit"),
        ("lost => 5%", "is not a limit"),
        ("lost > 5% or scans < 3", "is not a limit"),
        ("lost > five", "'five' is not a number"),
        ("lost > nan", "'nan' is not a number"),
        ("gap > inf", "'inf' is not a number"),
        ("lots > 5%", "no measure is called 'lots'; did you mean 'lost'? there are lost, scans"),
        ("zzz > 5", "no measure is called 'zzz'; there are lost, scans, gap"),
        ("scans > 5%", "scans is not a share; leave out the %"),
        ("lost > 1", "1 is not a share; write 1% or 0.01"),
        ("lost < 1", "1 is not a share"),
        ("lost > 500", "500 is not a share; write 0% to 100%"),
        ("lost > -1%", "-1% is not a share"),
    ],
)
def test_what_is_no_limit_is_refused(text: str, found: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_limit(text, MEASURES)
    assert str(caught.value).startswith(f"`limits` {text!r}: ")
    assert found in str(caught.value)
