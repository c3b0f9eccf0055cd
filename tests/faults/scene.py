"""A folder with inputs for every command that writes, and what each command makes of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.cli.runner import occmap
from tests.samples import write_csv

COMMANDS = {
    "build pgm": "build a.csv -o m.pgm --jobs 1",
    "build png": "build a.csv -o m.png --jobs 1",
    "build npz": "build a.csv -o m.npz --jobs 1",
    "build resume": "build a.csv --resume m.npz -o m.npz --jobs 1",
    "render": "render a.npz -o m.pgm -o m.png -o m.npz --prior 0.4",
    "merge": "merge a.npz b.npz -o m.npz -o m.pgm",
    "compare": "compare a.csv -o m.png --jobs 1 --model simple --update beam",
    "diff": "diff a.pgm b.pgm -o m.png",
    "score": "score a.pgm --truth b.pgm -o m.png",
}
"""Every command that writes. In each, m is what it writes and what is there before."""


@dataclass(frozen=True)
class Scene:
    """A command in its folder: what is there before it, and what is there after it."""

    folder: Path
    words: list[str]
    before: dict[str, bytes]
    after: dict[str, bytes]

    def reset(self) -> None:
        """Put everything back as it was before the command."""
        for path in self.folder.iterdir():
            if path.name not in self.before:
                path.unlink()
        for name, content in self.before.items():
            path = self.folder / name
            if not path.exists() or path.read_bytes() != content:
                path.write_bytes(content)

    def list_wrong(self, left_over: str = "") -> Iterator[str]:
        """Name what is neither as before nor as after; temporary files only where they may be."""
        found = read_folder(self.folder)
        for name, content in found.items():
            if left_over and name.startswith(left_over):
                continue
            if content not in (self.before.get(name), self.after.get(name)):
                yield f"{name} is torn" if name in self.after else f"{name} is left over"
        yield from (f"{name} is gone" for name in self.before if name not in found)

    def is_mixed(self) -> bool:
        """Whether an image and its YAML are of two maps."""
        found = read_folder(self.folder)
        return len({found[name] == self.after[name] for name in ("m.pgm", "m.yaml")}) == 2

    def is_done(self) -> bool:
        """Whether the command has written everything."""
        return read_folder(self.folder) == self.after


def read_folder(folder: Path) -> dict[str, bytes]:
    """Read every file of a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def set_up(folder: Path, command: str) -> Scene:
    """Make the inputs, older outputs, and, in the same folder, what the command makes of them.

    The working directory has to be the folder.
    """
    row = [(0.1 * step, 0.0, 0.1 * step) for step in range(10)]
    write_csv(folder / "a.csv", [(-5.0, 0.0, 0.0), *row], [0.3, 0.4, 0.5], 0.1)
    write_csv(folder / "b.csv", [(-3.0, -2.0, 0.0), *row], [0.8, 0.9, 1.0], 0.1)
    for name in ("b", "a"):
        files = [f"-o {stem}{suffix}" for stem in (name, "m") for suffix in (".npz", ".pgm")]
        line = f"build {name}.csv --jobs 1 -o m.png {' '.join(files)}"
        assert occmap(line).code == 0
        if name == "b":  # m is what was made of b
            older = {path.name: path.read_bytes() for path in folder.glob("m.*")}
    before = read_folder(folder) | older
    scene = Scene(folder, COMMANDS[command].split(), before, {})
    scene.reset()
    assert occmap(*scene.words).code == 0
    scene = Scene(folder, scene.words, before, read_folder(folder))
    scene.reset()
    assert not scene.is_done()
    assert not ("m.pgm" in scene.words and scene.is_mixed())
    return scene
