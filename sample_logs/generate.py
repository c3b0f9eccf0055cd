"""Simulate a drive through an office, in every log format, and one through a hall in 3D.

    python sample_logs/generate.py [OUT_DIR]

writes `drive.csv`, `drive.log` (CARMEN), `drive.bag` (ROS 1), `drive_ros2/` (ROS 2, sqlite3) and
`drive.mcap`, and what their map should show: `floor_plan.pgm` with `floor_plan.yaml`.

All five hold the same scans: 271 beams over 270 degrees, 1 cm noise, 8 m range, and nothing coming
back through the glass front. Every number is chosen so that each format holds it exactly, or so
that the last bits do not matter: ranges are whole millimetres, angles are float32 values, and no
beam ends so near to a rounding step of the 0.05 m lattice that 1e-8 m could move it across.
`hall.mcap` holds clouds of a 3D lidar of 16 rings, with points in whole millimetres.
Sine and cosine differ in the last bit between machines, so what comes of them is rounded.
"""

import sys
from pathlib import Path

from drive import simulate_drive
from formats import write_carmen, write_clouds, write_csv, write_mcap, write_ros1, write_ros2
from hall import simulate_cloud_drive
from office import write_floor_plan


def generate(folder: Path) -> None:
    """Write the floor plan and the logs into a folder; what is there is replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    write_floor_plan(folder / "floor_plan.pgm")
    drive = simulate_drive()
    write_csv(drive, folder / "drive.csv")
    write_carmen(drive, folder / "drive.log")
    write_ros1(drive, folder / "drive.bag")
    write_ros2(drive, folder / "drive_ros2")
    write_mcap(drive, folder / "drive.mcap")
    write_clouds(simulate_cloud_drive(), folder / "hall.mcap")


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
