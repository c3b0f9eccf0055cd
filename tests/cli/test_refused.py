"""What a command cannot do is one clear line and an exit code, and every file stays as it was.

The code is 2 where the command line can never work, and 1 where a file is at fault.
"""

from pathlib import Path

import pytest

from tests.cli.runner import occmap, read_error
from tests.samples import PLAIN_WORDS, SAMPLE_LOGS, write_csv

SUFFIXES = "occmap writes .csv, .ground.tif, .html, .keepout.pgm"

KNOWS_NO_HITS = "quadratic sums up log-odds and knows no hits; leave it out, or build with --model "

REFUSED = [
    ("build none.csv -o m.pgm", 1, "none.csv: no such file or directory; check the path"),
    ("build lgo.csv -o m.pgm", 1, "lgo.csv: no such file or directory; did you mean log.csv?"),
    ("build *.bag -o m.pgm", 1, "*.bag: no file matches; check the pattern and its folder"),
    ("build file:///log.csv -o m.pgm", 1, "an address, where a file or a folder belongs; leave"),
    ("build a.npz -o m.pgm", 1, "a.npz: "),
    ("build polgon log.csv -o m.pgm", 2, "'polgon' is neither a log nor an update"),
    ("build Beam log.csv -o m.pgm", 2, "did you mean 'beam'?"),
    ("build beam -o m.pgm", 2, "no log is given; type: occmap build LOG -o map.pgm"),
    ("build log.csv", 2, "where to write the map is not given; add -o map.pgm"),
    ("build log.csv -o log.csv/m.pgm", 1, "log.csv is a file, not a folder"),
    ("build none.csv -o no/m.pgm", 1, "no/m.pgm: the folder no does not exist"),
    ("build none.csv -o m.jpg", 2, f"m.jpg: unknown suffix '.jpg'; {SUFFIXES}"),
    (f"build none.csv -o {'n' * 251}.pgm", 1, ": cannot be written (File name too long)"),
    ("build none.csv -o -.zarr", 2, "a folder, which stdout cannot take"),
    ("build log.csv -o - -o -.png", 2, "stdout takes one map and nothing else"),
    ("build none.csv -o m.pgm -o m.pgm", 2, "m.pgm: would be written twice"),
    ("build log.csv -o m.pgm --resolution 0", 2, "a resolution of 0.0 m is not possible"),
    ("build log.csv -o m.pgm --extent 0,0,1e9,1", 2, "reaches too far; give numbers up to 1e+08"),
    ("build log.csv -o m.pgm --poses=", 2, "--poses is empty; give a name, or leave it out"),
    ("build log.csv -o m.pgm --poses none.tum", 1, "--poses takes a trajectory file"),
    ("build log.csv -o m.pgm --model simple:p_hit", 2, "write NAME:KEY=NUMBER,KEY=NUMBER"),
    ("build log.csv -o m.pgm --epsilon 1", 2, "'epsilon'; choose --model quadratic, which has it"),
    ("build log.csv -o m.pgm --p-hit x", 2, "--p-hit is 'x'; give a number"),
    ("build log.csv -o m.pgm --edits=", 2, "--edits is ''; give a path"),
    ("build log.csv -o m.pgm --model quadratic --epsilon 1e9", 2, "--epsilon 1000000000.0 is not"),
    ("build log.csv -o m.pgm --occupied-thresh 0.2 --free-thresh 0.6", 2, "0 < free < occ"),
    ("build log.csv -o m.pgm --min-range 5 --max-range 2", 2, "--min-range 5.0 and --max-"),
    ("build log.csv -o m.pgm --min-range 1", 1, "no beam of any scan observed a cell"),
    ("build log.csv -o m.pgm --start 5 --end 2", 2, "--start 5.0 is not before --end 2.0"),
    ("build log.csv -o m.pgm --start 7", 1, "1 outside --start and --end"),
    ("build log.csv -o m.pgm --scan-topic /x", 1, "no scans on the topic /x; it has scans on scan"),
    ("build log.csv -o m.pgm --max-cells 0", 2, "--max-cells 0 is not possible; give 1 or more"),
    ("build log.csv -o m.pgm --max-cells 2", 1, "more than --max-cells 2"),
    ("build log.csv -o m.pgm --modle x", 2, "--model"),
    ("build log.csv -o m.tif --georeference 91,0,0", 2, "no place has latitude 91 and longitude 0"),
    ("build log.csv -o m.pgm -o m.keepout.pgm", 2, "m.keepout.pgm: a keepout mask is of edits"),
    ("build log.csv -o m.pgm --edits log.csv", 2, "log.csv: line 4: "),
    ("build log.csv -o edits.csv --edits edits.csv", 2, "edits.csv: is an input"),
    ("build b.csv --resume none.npz -o m.npz", 1, "none.npz: no such file"),
    ("build b.csv --resume b.csv -o m.npz", 1, "is not an evidence file"),
    ("build b.csv --resume a.npz -o m.npz", 1, "a.npz: its update is beam, that"),
    ("build b.csv --resume a.npz --resume-if-there a.npz -o m.npz", 2, "leave one out"),
    ("render", 2, "Missing argument"),
    ("render a.npz", 2, "where to write is not given; add -o map.pgm"),
    ("render none.npz -o m.pgm", 1, "none.npz: no such file"),
    ("merge *.npz -o m.pgm", 1, "*.npz: no such file; leave out its quotes"),
    ("merge . -o m.pgm", 1, "is not a store of evidence; merge ./*.npz"),
    ("render log.csv -o m.pgm", 1, "log.csv: is not an evidence file; build one"),
    ("render a.npz -o no/m.pgm", 1, "the folder no does not exist"),
    ("render a.npz -o m.pgm --max-cells 3", 1, "more than --max-cells 3"),
    ("render a.npz -o m.pgm --extent 0,0,0,1", 2, "is not a box"),
    ("render a.npz -o m.pgm --extent 5,5,6,6", 1, "no cell of the map lies in"),
    ("render a.npz -o m.pgm --model counting --p-hit 0.8", 2, "'p_hit'; choose --model simple"),
    ("render a.npz -o m.pgm --model quadratic", 1, "quadratic"),
    ("render a.npz -o m.pgm --since noon", 2, "--since is 'noon'; give seconds, or a date such as"),
    ("render a.npz -o m.pgm --since 2024", 2, "--since 2024: this may be a year, or seconds"),
    ("render a.npz -o m.pgm --since 2040-01-01", 1, "nothing was observed, or lasts, of the time"),
    ("render q.npz -o m.pgm --model simple", 1, "q.npz: was summed up for"),
    ("merge -o m.npz", 2, "'NPZ|ZARR...'; write, for example, occmap merge monday.npz"),
    ("merge a.npz", 2, "add -o merged.npz"),
    ("merge a.npz b.npz --fit -o m.npz", 1, "not sure how b.npz lies on it"),
    ("merge a.npz q.npz -o m.npz", 1, "q.npz: its kind is log_odds"),
    ("merge a.npz --subtract b.npz -o m.npz", 1, "cells that a.npz lacks"),
    ("explain a.npz", 2, "'X'; write, for example, occmap explain map.npz 1.5 -0.25"),
    ("explain a.npz 0 north", 2, "`Y` is 'north'; give a number"),
    ("explain a.npz 0 nan", 2, "the point (0, nan) is in no map; give x and y in metres"),
    ("explain a.npz -inf 0", 2, "-i"),
    ("explain a.npz 0 0 --log b.csv", 1, "b.csv: a.npz was not made of it, or it was"),
    ("explain a.npz 0 0 --log none.csv", 1, "none.csv: cannot be read (No such file"),
    ("explain a.npz 0 0 --poses b.csv", 2, "--poses goes with a log; add --log LOG"),
    ("explain a.npz 0 0 --model quadratic", 1, "which quadratic cannot read"),
    ("explain a.npz 0 0 --min-passes 0", 2, "--min-passes 0 is not possible"),
    ("explain a.npz 0 0 --free-thresh 0.9", 2, "0 < free < occupied < 1"),
    ("explain q.npz 0 0 --min-passes 2", 2, KNOWS_NO_HITS),
    ("compare", 2, "Missing argument 'LOG...'; write, for example, occmap compare drive.mcap"),
    ("compare none.csv -o m.pgm", 2, "m.pgm: is not a picture; give it a name that ends in"),
    ("compare none.csv -o a.png -o a.html", 2, "--output takes one file, and is given 2: a.png,"),
    ("compare log.csv --update polygn", 2, '; give "beam" or "polygon" or "surface"'),
    ("compare log.csv --update cloud", 2, "choose of beam, polygon, surface"),
    ("compare log.csv --model simpel", 2, "did you mean 'simple'?"),
    ("compare log.csv -o m.png", 1, "give more scans: every fifth"),
    ("tune drive.csv --fail-if agreement>2%", 2, "no measure is called 'agreement'"),
    ("build drive.csv --update beam", 2, "has no --update, which is an option of `occmap compare`"),
    ("diff none.pgm a.pgm", 1, "none.pgm: no such file; check the path"),
    ("diff a.pgm a.log", 2, "a.log: the suffix '.log' is not that of a map"),
    ("diff a.pgm", 2, "Missing argument 'B'"),
    ("check log.csv -o d.png", 2, "d.png: is not a page; give it a name that ends in .html"),
    ("diff a.pgm a.pgm --fail-above 5", 2, "5 is not a share; write 5%"),
    ("diff a.pgm a.pgm --edits none.csv", 2, "none.csv: cannot be read"),
    ("score a.pgm", 2, "add --log LOG or --truth MAP"),
    ("score none.pgm --log log.csv", 1, "none.pgm: no such file"),
    ("score a.pgm --truth log.csv", 2, "is not that of a map"),
    ("score a.pgm --truth a.pgm --fail-if share<1%", 2, "add --log LOG"),
    ("score a.pgm --log log.csv --fail-if edges_found<1%", 2, "give the truth"),
    ("score a.pgm --log log.csv -o s.png", 2, "add --truth MAP"),
    ("score a.pgm --truth a.pgm --within -1", 2, "give 0 to 1"),
    ("score lonely.png --truth a.pgm", 1, "YAML"),
    ("build log.csv polygon -o m.pgm", 2, "type: occmap build polygon LOG -o map.pgm"),
    ("buidl x.log", 2, "no command is called 'buidl'; did you mean 'build'?"),
    ("zzz", 2, "no command is called 'zzz'; there are build, "),
    ("log.csv", 2, "to map a log: occmap build log.csv -o map.pgm"),
    ("--verison", 2, "--version"),
    ("schema bild", 2, "'bild' is not one of 'build', 'check'"),
    ("demo log.csv", 1, "log.csv"),
]


@pytest.fixture(autouse=True, scope="module")
def _files(workplace: Path) -> None:
    """Three logs, edits, evidence of two logs and of another model, a map, and half of another."""
    write_csv(workplace / "log.csv", [(0.0, 0.0, 0.0)], [0.3])
    write_csv(workplace / "b.csv", [(0.0, 1.0, 0.0)], [0.4])
    (workplace / "drive.csv").symlink_to(SAMPLE_LOGS / "drive.csv")
    (workplace / "edits.csv").write_text("free,box,1,2,3,4\n")
    plain = " ".join(PLAIN_WORDS)
    for line in (
        f"{plain} log.csv -o a.npz -o a.pgm",
        f"{plain} b.csv -o b.npz",
        "beam log.csv --model quadratic -o q.npz",
        "log.csv -o lonely.png",
    ):
        assert occmap(f"build {line}").code == 0


@pytest.mark.parametrize(("line", "code", "found"), REFUSED)
def test_it_is_one_line_and_leaves_every_file_as_it_was(line: str, code: int, found: str) -> None:
    before = {path: path.read_bytes() for path in Path().iterdir()}
    assert found in read_error(occmap(line), code)
    assert {path: path.read_bytes() for path in Path().iterdir()} == before
