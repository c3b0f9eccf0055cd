"""Comparing variants: what is held out, what is shared, and the scores of rooms known by heart."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from occmap.options import DEFAULT_UPDATE, BuildOptions, Selection
from occmap.pipeline import build
from occmap.scans.tally import Tally
from occmap.scoring import MOST_SCANS, Score, Trial, estimate_error, hold_out
from occmap.scoring.compare import (
    ScoredVariant,
    Variant,
    VariantComparison,
    choose_best,
    combine,
    compare,
)
from occmap.sensor import ReturnOptions
from occmap.sensor.models import CountingModel, SensorModel, SimpleModel, parse_model
from occmap.types import Rays, Update
from tests.csv_logs import write_scans
from tests.grid.scans import make_rays
from tests.samples import PLAIN, SAMPLE_LOGS, find_real, write_csv
from tests.writers.maps import map_of

DRIVE = SAMPLE_LOGS / "drive.csv"


LATE_KERNELS = """
import sys
import occmap
from occmap import jit
from occmap.scans.tracing import Reading

loaded = []
load, read = jit.Kernel._load, Reading.list_rays

def load_and_note(self, *args):
    loaded.append(self.name)
    return load(self, *args)

def forget_and_read(self):
    loaded.clear()
    return read(self)

jit.Kernel._load, Reading.list_rays = load_and_note, forget_and_read
occmap.compare(sys.argv[1], stride=10)
print(*(name for name in loaded if not name.startswith("cast.")))
"""
"""Prints the kernels that are loaded or compiled while variants are traced and timed."""


def make_scans(scans: int) -> Rays:
    """Scans that are told apart by their x."""
    origin = np.zeros((scans, 1, 2))
    origin[:, 0, 0] = np.arange(scans)
    return make_rays(origin, (1, 0), 1.0)


class Taken(list[Rays]):
    """What was given to an engine."""

    add = list[Rays].append


def list_x(batches: list[Rays]) -> list[float]:
    return [float(x) for rays in batches for x in rays.origin[:, 0, 0]]


@pytest.mark.parametrize("sizes", [[20], [1] * 20, [2, 3, 7, 8]])
def test_every_fifth_scan_is_held_out_however_they_are_batched(sizes: list[int]) -> None:
    everything, mapped = make_scans(20), Taken()
    ends = np.cumsum(sizes)
    parts = [
        np.isin(np.arange(20), range(end - n, end)) for n, end in zip(sizes, ends, strict=True)
    ]
    held_out = hold_out((everything.take(part) for part in parts), [mapped], jobs=1)
    assert list_x(held_out.parts) == [2, 7, 12, 17]
    assert held_out.scans == 4
    assert sorted(list_x(mapped) + list_x(held_out.parts)) == list(range(20))


def test_of_many_held_out_scans_some_are_asked_and_none_is_mapped() -> None:
    mapped = Taken()
    sample = hold_out((make_scans(500) for _ in range(60)), [mapped], jobs=1)
    assert [len(rays.kind) for rays in mapped] == [400] * 60
    assert sample.seen == 6000
    assert MOST_SCANS / 2 < sample.scans < MOST_SCANS
    (note,) = sample.list_notes("held-out scans")
    assert note.startswith(f"{sample.scans:,} of 6,000 held-out scans")


def test_no_variant_is_charged_for_loading_or_compiling_kernels() -> None:
    words = [sys.executable, "-c", LATE_KERNELS, str(SAMPLE_LOGS / "drive.mcap")]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == "\n"


def test_variants_are_every_update_with_every_model_once() -> None:
    usual = {"beam": "counting", "polygon": "counting:cut=0.4,spread=0", "surface": "counting"}
    expected = [
        f"{update} {model}"
        for update, counting in usual.items()
        for model in (counting, "simple", "quadratic")
    ]
    assert [variant.name for variant in combine([], [])] == expected
    models = [parse_model(text) for text in ("simple:p_hit=0.9", "simple:p_hit=0.90", "counting")]
    names = [variant.name for variant in combine([Update.POLYGON], models)]
    assert names == ["polygon simple:p_hit=0.9", "polygon counting"]


def test_what_only_a_map_depends_on_needs_no_evidence_of_its_own() -> None:
    assert len({variant.evidence for variant in combine([], [])}) == 6
    texts = ["quadratic", "quadratic:clamp_max=0.9", "quadratic:prior=0.4", "quadratic:p_min=0.3"]
    variants = combine([Update.BEAM], [parse_model(text) for text in texts])
    assert len(variants) == 4
    assert len({variant.evidence for variant in variants}) == 2


LONE = Variant(Update.BEAM, PLAIN.model)


def test_the_scores_of_a_wall(tmp_path: Path) -> None:
    """Ten scans of the same wall, from one place."""
    log = write_csv(tmp_path / "wall.csv", [(0.025, 0.025, 0.0)] * 10, [1.0])
    comparison = compare([log], [LONE], PLAIN)
    score = comparison.results[0].score
    wall, free = (1 / (1 + math.exp(-8 * math.log(p / (1 - p)))) for p in (0.7, 0.4))
    assert comparison.scans.held_out == 2
    assert (score.beams, score.share) == (2, 1.0)
    assert score.occupied_cost == pytest.approx(-math.log(wall), rel=1e-4)
    assert score.free_cost == pytest.approx(-math.log(1 - free), rel=1e-4)
    # 18 cells lie before those near the range, two near it are free; of two unknown ones
    # behind the wall each stops half of what passed it.
    stopped = (1 - free) ** 18 * (1 - (1 - free) ** 2 * (1 - wall) / 4)
    assert score.log_likelihood == pytest.approx(math.log(0.95 * stopped + 0.0025), rel=1e-3)


def test_a_map_is_scored_by_scans_that_it_was_not_made_from(tmp_path: Path) -> None:
    ranges = [[1.0], [1.0], [2.0], [1.0], [1.0]]  # the third is held out, and sees no wall at 1 m
    shape = {"angle_min": 0, "angle_increment": 0}
    log = write_scans(tmp_path / "wall.csv", range(5), ranges, [(0.025, 0.025, 0)] * 5, **shape)
    (result,) = compare([log], [LONE], PLAIN).results
    assert (result.score.beams, result.score.share) == (1, 0.0)
    assert result.map.shape == (1, 21)
    assert result.score.log_likelihood < math.log(0.2)


def test_scans_that_all_differ_in_geometry_are_held_out_one_by_one(tmp_path: Path) -> None:
    log = tmp_path / "turning.csv"
    head = "# angle_increment: 0\nstamp,x,y,yaw,angle_min,r0\n"
    log.write_text(head + "".join(f"{i},0.025,0.025,0,{0.001 * i},1.0\n" for i in range(10)))
    comparison = compare([log], combine([Update.BEAM], []), BuildOptions(jobs=2))
    assert comparison.scans.held_out == 2
    assert all(result.score.share == 1 for result in comparison.results)


@pytest.fixture(scope="module")
def drive() -> VariantComparison:
    return compare([DRIVE], combine([], []), BuildOptions(jobs=2))


@pytest.mark.parametrize(
    ("part", "whole", "error"),
    [
        ([2, 1, 0], [2, 2, 2], 0.5 / math.sqrt(3)),  # of 1, 1/2, 0: as of any mean of three
        ([2, 1, 0, 0], [2, 2, 2, 0], 0.5 / math.sqrt(3)),  # a scan of no range is no draw
        ([1, 2, 3], [2, 4, 6], 0.0),
        # The share is 1/2, off by 0, 1 and -1 beams: sqrt(3/2 (0 + 1 + 1)) / 12
        ([4, 2, 0], [8, 2, 2], math.sqrt(3) / 12),
        ([1], [2], math.inf),
    ],
)
def test_the_error_of_a_share_is_that_of_scans(
    part: list[float], whole: list[float], error: float
) -> None:
    assert estimate_error(np.array(part, float), np.array(whole, float)) == pytest.approx(error)


def make_result(
    model: SensorModel, predicted: list[int], log_likelihood: float, beams: int = 10
) -> ScoredVariant:
    """Of scans of so many beams each."""
    by_scan = np.array([(beams, near, 0, 0, 0, 0) for near in predicted], float)
    share = sum(predicted) / (beams * len(predicted))
    score = Score(beams * len(predicted), share, 0.0, log_likelihood, 0.0, 0.0, 0.0)
    variant = Variant(Update.SURFACE, model)
    return ScoredVariant(
        variant=variant,
        map=map_of([[0.5]]),
        trial=Trial(by_scan, np.zeros((1, 3)), None),
        score=score,
        name=variant.name,
        update=variant.update,
        model=model.name,
        columns=1,
        rows=1,
        seconds=0.0,
        bytes=0,
    )


def rank(*results: ScoredVariant) -> VariantComparison:
    ranked = tuple(result.compare_with(results[0]) for result in results)
    return choose_best(ranked, BuildOptions(), Tally(logs=["x"]), held_out=3)


def choose(*results: ScoredVariant) -> str:
    return rank(*results).recommended.variant.name


def test_what_noise_may_have_put_first_does_not_displace_the_default() -> None:
    lucky = make_result(SimpleModel(), [10, 4, 7], -1.0)  # ahead by 2, -1, 0 beams
    default = make_result(CountingModel(), [8, 5, 7], -2.0)
    other = make_result(SimpleModel(p_hit=0.8), [8, 5, 7], -0.5)
    assert choose(lucky, default, other) == "surface counting"
    assert choose(lucky, other) == "surface simple:p_hit=0.8"  # by its log-likelihood
    assert choose(lucky) == "surface simple"


def test_a_lead_in_every_scan_is_no_noise_however_much_scans_differ() -> None:
    ahead = make_result(SimpleModel(), [10, 4, 7], -1.0)
    default = make_result(CountingModel(), [9, 3, 6], -0.5)
    assert choose(ahead, default) == "surface simple"
    behind = default.compare_with(ahead)
    assert [behind.behind, behind.behind_error] == pytest.approx([0.1, 0.0])
    assert not behind.as_good


def test_a_lead_that_nobody_sees_does_not_displace_the_default() -> None:
    """Two beams of 600 in every scan are less than half a percent; four are more."""
    for lead, best in ((2, "surface counting"), (4, "surface simple")):
        ahead = make_result(SimpleModel(), [500] * 3, -1.0, beams=600)
        default = make_result(CountingModel(), [500 - lead] * 3, -2.0, beams=600)
        assert choose(ahead, default) == best


def test_the_likeliest_of_those_as_good_is_named_beside_the_best() -> None:
    default = make_result(CountingModel(), [8, 5, 7], -2.0)
    likely = make_result(SimpleModel(), [8, 4, 8], -0.6)
    far = make_result(CountingModel(prior=0.4), [5, 2, 4], -0.5)
    comparison = rank(default, likely, far)
    assert comparison.recommended.variant == default.variant
    assert comparison.likeliest.variant == likely.variant
    found = comparison.to_json()
    assert (found["best"], found["likeliest"]) == ("surface counting", "surface simple")
    assert "counting" in found["command"]
    assert "simple" in found["likeliest_command"]


def test_a_drive_is_foretold_well_by_every_variant_and_too_short_to_tell_the_best_apart(
    drive: VariantComparison,
) -> None:
    shares = [result.score.share for result in drive.results]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] > 0.9
    assert (drive.scans.used, drive.scans.held_out) == (414, 83)
    assert all(result.bytes > 0 and result.seconds > 0 for result in drive.results)
    first, *others = drive.results
    assert (first.behind, first.behind_error, first.as_good) == (0, 0, True)
    assert all(0 < each.behind_error < each.score.share_error for each in others)
    names = {each.variant.name for each in drive.results if each.as_good}
    assert {drive.recommended.variant.name, first.variant.name} <= names


def test_threads_change_no_score(drive: VariantComparison) -> None:
    alone = compare([DRIVE], combine([], []), BuildOptions(jobs=1))
    for one, other in zip(alone.results, drive.results, strict=True):
        assert (one.variant, one.score) == (other.variant, other.score)
        assert np.array_equal(one.map.log_odds, other.map.log_odds)


def test_a_map_is_what_a_build_of_the_same_scans_makes(tmp_path: Path) -> None:
    rows = DRIVE.read_text().splitlines(keepends=True)
    head = next(i for i, row in enumerate(rows) if not row.startswith("#")) + 1
    kept = [row for i, row in enumerate(rows[head:]) if i % 5 != 2]
    rest = tmp_path / "rest.csv"
    rest.write_text("".join([*rows[:head], *kept]))
    for result in compare([DRIVE], combine([Update.POLYGON], []), BuildOptions()).results:
        options = BuildOptions(update=Update.POLYGON, model=result.variant.model)
        assert np.array_equal(build([rest], options).map.log_odds, result.map.log_odds)


def test_the_command_repeats_what_was_chosen() -> None:
    options = BuildOptions(
        resolution=0.1, jump=0.3, selection=Selection(stride=2), returns=ReturnOptions(max_range=9)
    )
    model = CountingModel(prior=0.4)
    for update in (Update.BEAM, Update.POLYGON):
        comparison = compare([DRIVE], [Variant(update, model)], options)
        jump = " --jump 0.3" if update is Update.POLYGON else ""  # beams know no surfaces
        words = f"--resolution 0.1 --max-range 9 --stride 2{jump} --model counting:prior=0.4"
        expected = f"occmap build {update.value} {DRIVE} {words} -o drive.pgm"
        assert comparison.command == tuple(expected.split())


@pytest.mark.parametrize(
    ("name", "share", "log_likelihood"),
    [("carmen/intel-corrected.log.gz", 0.87, -0.5), ("carmen/csail-corrected.log.gz", 0.795, -0.9)],
)
def test_the_default_build_foretells_real_logs_best_and_likeliest(
    name: str, share: float, log_likelihood: float
) -> None:
    comparison = compare([find_real(name)], combine([], []), BuildOptions())
    best, likeliest = comparison.recommended, comparison.likeliest
    assert best.variant == Variant(DEFAULT_UPDATE, BuildOptions().model)
    assert likeliest.variant == best.variant
    assert best.score.share > share
    assert best.score.log_likelihood > log_likelihood
