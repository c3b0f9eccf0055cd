"""What a pipeline does with a log, by exit codes, JSON and bytes of files alone.

    python tests/workflow.py LOG

It works in the current folder, prints a line for each step, and ends with 1 at the first one that
is not as it should be. Nothing of occmap is imported.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

OCCMAP = [sys.executable, "-m", "occmap"]
DONE, DATA_FAILED, WRONG_USAGE, LIMIT_BROKEN = range(4)
MAP = ("map.pgm", "map.yaml", "map.png", "map.npz")


def main(log: str) -> None:
    """Run all steps on a log."""
    seconds = check(log)
    build(log)
    hold_against_reference(log, seconds)
    render()
    merge_halves(log, seconds)
    change_threads(log)
    follow_the_comparison(log)
    fail_as_told(log)
    tell("all is as it should be")


def call(*words: str, code: int = DONE) -> dict[str, Any]:
    """Run a command with --json; its exit code must be the one given."""
    done = subprocess.run(
        [*OCCMAP, *words, "--json"], capture_output=True, text=True, check=False, timeout=120
    )
    if done.returncode != code:
        give_up(
            f"{' '.join(words)}: exit code {done.returncode}, not {code}; {done.stderr.strip()}"
        )
    try:
        printed: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        give_up(f"{' '.join(words)}: no JSON on stdout, but {done.stdout!r}")
    return printed


def expect(step: str, *, found: object, wanted: object) -> None:
    """Go on where something is as it should be."""
    if found != wanted:
        give_up(f"{step}: {found!r}, not {wanted!r}")
    tell(f"ok: {step}")


def expect_same(step: str, one: Path, other: Path, names: tuple[str, ...] = MAP) -> None:
    """Go on where the files of two folders are the same, byte for byte."""
    for name in names:
        if (one / name).read_bytes() != (other / name).read_bytes():
            give_up(f"{step}: {one / name} and {other / name} differ")
    tell(f"ok: {step}")


def tell(text: str) -> None:
    """Print a line at once, so that a log of the run shows how far it got."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def give_up(text: str) -> NoReturn:
    """End with 1."""
    sys.exit(f"not as it should be: {text}")


def write_into(folder: str, names: tuple[str, ...] = MAP) -> list[str]:
    """Make a folder, and the words that name a map's files in it."""
    Path(folder).mkdir()
    return [word for name in names if name != "map.yaml" for word in ("-o", f"{folder}/{name}")]


def limit(*texts: str) -> list[str]:
    """Make the words of limits."""
    return [word for text in texts for word in ("--fail-if", text)]


def check(log: str) -> float:
    """See that the log is one to map; return how long it is (s)."""
    words = limit("dropped_scans > 5%", "damage > 0", "largest_gap > 2", "warnings > 0")
    found = call("check", log, *words)
    expect("the log can be mapped", found=found["buildable"], wanted=True)
    expect("no limit on the log fails", found=found["failed"], wanted=[])
    return float(found["logs"][0]["scans"][0]["times"]["duration_s"])


def build(log: str) -> None:
    """Make the map that all others are compared with."""
    words = limit("unknown > 80%", "occupied < 1%", "scans_used < 100", "dropped_scans > 5%")
    made = call("build", log, "--strict", *words, *write_into("whole"))
    files = {Path(file).name for file in made["files"]}
    expect("all files are written", found=files, wanted=set(MAP))
    expect("the report names its schema", found=made["schema"], wanted="occmap/build/1")


def hold_against_reference(log: str, seconds: float) -> None:
    """Let the same map pass, and one of half the scene fail."""
    same = call("diff", "whole/map.pgm", "whole/map.npz", "--fail-above", "0")
    expect("nothing changed between a map and itself", found=same["changed"], wanted=0)
    call("build", log, "--end", str(seconds / 4), *write_into("changed", ("map.pgm",)))
    words = ["diff", "whole/map.pgm", "changed/map.pgm", "--fail-above", "2%", "-o", "diff.png"]
    other = call(*words, *limit("occupied_to_neither > 100%"), code=LIMIT_BROKEN)
    expect(
        "a changed scene fails by its limit",
        found=[each["limit"] for each in other["failed"]],
        wanted=["changed > 2%"],
    )
    expect("and is painted", found=Path("diff.png").exists(), wanted=True)


def render() -> None:
    """Make the map again without the log."""
    call("render", "whole/map.npz", *write_into("rendered"), *limit("unknown > 80%"))
    expect_same("what is rendered is what was built", Path("whole"), Path("rendered"))


def merge_halves(log: str, seconds: float) -> None:
    """Build two halves of the log apart, and add them up."""
    middle = f"{seconds / 2 + 0.01:.2f}"  # between two scans
    first = call("build", log, "--end", middle, *write_into("first"))["scans"]["used"]
    second = call("build", log, "--start", middle, *write_into("second"))["scans"]["used"]
    sum_up = ["merge", "first/map.npz", "second/map.npz", *write_into("merged")]
    merged = call(*sum_up)["scans"]["used"]
    expect("no scan is lost between the halves", found=merged, wanted=first + second)
    images = ("map.pgm", "map.yaml", "map.png")
    expect_same("two halves make the whole", Path("whole"), Path("merged"), images)


def change_threads(log: str) -> None:
    """See that the number of threads changes nothing."""
    for jobs in ("1", "2"):
        call("build", log, "--jobs", jobs, *write_into(f"jobs{jobs}"))
        expect_same(f"--jobs {jobs} makes the same bytes", Path("whole"), Path(f"jobs{jobs}"))


def follow_the_comparison(log: str) -> None:
    """Run the command line that a comparison recommends, as it stands."""
    compared = call("compare", log, *limit("share < 50%"))
    names = [variant["name"] for variant in compared["variants"]]
    expect("the best is one of those compared", found=compared["best"] in names, wanted=True)
    program, *words = compared["command"]
    expect("it is a command line of occmap", found=program, wanted="occmap")
    made = call(*words)
    best = compared["variants"][names.index(compared["best"])]
    expect("it builds by that update", found=made["map"]["update"], wanted=best["update"])
    name, _, chosen = best["model"].partition(":")
    used, _, values = made["map"]["model"].partition(":")
    expect("it builds by that model", found=used, wanted=name)
    others = set(filter(None, chosen.split(","))) - set(values.split(","))
    expect("... with all of its parameters", found=others, wanted=set())


def fail_as_told(log: str) -> None:
    """See that failures can be told apart, and leave nothing behind."""
    before = sorted(Path().rglob("*"))
    lost = call("build", "nowhere.mcap", "-o", "lost.pgm", code=DATA_FAILED)["error"]
    expect("a missing log is named", found=lost["where"], wanted="nowhere.mcap")
    wrong = call("build", log, "-o", "lost.gif", code=WRONG_USAGE)["error"]
    expect("so is a format that cannot be written", found=wrong["where"], wanted="lost.gif")
    call("build", log, "-o", "lost.pgm", *limit("dropped > 5%"), code=WRONG_USAGE)
    expect("nothing is left of them", found=sorted(Path().rglob("*")), wanted=before)
    failed = call("check", log, *limit("scans_read >= 1", "topics > 99"), code=LIMIT_BROKEN)
    expect(
        "a limit is told with its value",
        found=[(each["name"], each["value"] >= 1) for each in failed["failed"]],
        wanted=[("scans_read", True)],
    )


if __name__ == "__main__":
    main(sys.argv[1])
