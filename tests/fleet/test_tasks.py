"""What tasks leave for each other."""

from pathlib import Path

import pytest

from occmap.fleet.tasks import Job, Setting, add_up_pieces, trace_log
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import text_log
from occmap.scans.tracing import Keep
from tests.grid.scans import are_equal
from tests.samples import write_late


def test_a_log_that_is_read_twice_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory holds next to nothing, so run files are written in both readings."""
    monkeypatch.setattr(text_log, "BLOCK_BYTES", 3000)  # ten scans or so
    log = write_late(tmp_path / "late.csv", scans=60, marked_from=30)
    options = BuildOptions(jobs=1, pass_gap_s=2.0)
    alone = build([log], options)
    folder = tmp_path / "scratch"
    folder.mkdir()
    setting = Setting(options, Keep(slices=True), folder, 1, window_cells=1 << 20, most_bytes=1)
    traced = trace_log(Job(setting, "log", str(log)))
    pieces = [piece for block in sorted(traced.pieces) for piece in traced.pieces[block]]
    grid, _ = add_up_pieces(setting, pieces)
    files = {piece.file for piece in pieces}
    assert len(files) > 1
    assert len(list(folder.glob("*.run"))) > len(files)
    assert traced.tally.scans_used == 60
    assert traced.tally.beams == alone.report.beams
    assert are_equal(grid.tiles, alone.observed.tiles)
    assert any("30 m" in note for note in traced.notes)
