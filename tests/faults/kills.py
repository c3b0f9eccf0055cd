"""Kill commands that write, at random moments, and look at what they leave."""

import random
import signal
import subprocess
import sys
import time

from tests.faults.scene import Scene

ANSWERED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIGNALS = (*ANSWERED, signal.SIGKILL)
LINE = "error: interrupted: nothing more is written\n"
TEMPORARY = ".occmap-"


def kill_once(scene: Scene, kind: signal.Signals, dice: random.Random) -> str:
    """Run a command, kill it, and say what came of it; a fault begins with "FAULT"."""
    scene.reset()
    process = subprocess.Popen(
        [sys.executable, "-m", "occmap", *scene.words],
        cwd=scene.folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if dice.random() < 0.5:  # anywhere; else while files are written, which takes milliseconds
        time.sleep(dice.uniform(0.03, 1.0))
    else:
        while process.poll() is None and not any(scene.folder.glob(f"{TEMPORARY}*")):
            time.sleep(0.0002)
        time.sleep(dice.uniform(0, 0.005))
    process.send_signal(kind)
    out, err = process.communicate(timeout=60)
    if out and not scene.is_done():
        return f"FAULT: {scene.words} reports what is not done: {out!r}"
    return judge(scene, kind, process.returncode, err)


def is_of_python(said: str) -> bool:
    """Whether Python was interrupted while it started, before the first line of occmap's main."""
    return said.endswith("KeyboardInterrupt\n") and "occmap/cli" not in said


def judge(scene: Scene, kind: signal.Signals, code: int, said: str) -> str:
    """Say what came of a run, by what it said and left."""
    wrong = list(scene.list_wrong(TEMPORARY if kind is signal.SIGKILL else ""))
    if "m.pgm" in scene.words and not wrong and kind is not signal.SIGKILL and scene.is_mixed():
        wrong.append("an image and a YAML of two maps")
    if wrong:
        return f"FAULT: {kind.name} in {scene.words}: {wrong}"
    if code == 0:
        return "had ended" if scene.is_done() else f"FAULT: {scene.words} is not done"
    if kind is signal.SIGKILL and code == -kind:
        return kind.name
    if is_of_python(said) or (code == -kind and not said):
        return f"{kind.name}: ended before it listened"
    if kind in ANSWERED and code == 128 + kind and said.endswith(LINE) and said.count("\n") == 1:
        return f"{kind.name}: exit code {code}"
    return f"FAULT: {kind.name} in {scene.words}: exit code {code}, {said!r}"
