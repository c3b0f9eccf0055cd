"""The workflow of a pipeline runs through, and fails loudly where something is wrong."""

import subprocess
import sys
from pathlib import Path

from tests.samples import SAMPLE_LOGS

WORKFLOW = Path(__file__).parent / "workflow.py"


def run(log: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(WORKFLOW), str(log)]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )


def test_a_pipeline_runs_through(tmp_path: Path) -> None:
    done = run(SAMPLE_LOGS / "drive.mcap", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    *steps, last = done.stdout.splitlines()
    assert len(steps) >= 15
    assert all(step.startswith("ok: ") for step in steps)
    assert last == "all is as it should be"


def test_a_pipeline_stops_at_a_log_that_is_damaged(tmp_path: Path) -> None:
    log = tmp_path / "cut.mcap"
    data = (SAMPLE_LOGS / "drive.mcap").read_bytes()
    log.write_bytes(data[: len(data) // 2])
    done = run(log, tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(f"not as it should be: check {log}")
    assert "exit code 3, not 0; error: damage is 1, and --fail-if says > 0" in done.stderr


def test_the_workflow_knows_nothing_of_the_inside() -> None:
    assert "import occmap" not in WORKFLOW.read_text(encoding="utf-8")
    assert "from occmap" not in WORKFLOW.read_text(encoding="utf-8")
