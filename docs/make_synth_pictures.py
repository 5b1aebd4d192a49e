"""Draws the picture of synthesis.md: the README's commands on a few rows of the example's plan.

    python docs/make_synth_pictures.py            # into docs/pictures
    python docs/make_synth_pictures.py --folder F # elsewhere

Needs the package and the extra synth.
"""

import argparse
import tempfile
from pathlib import Path

from dronepose.synth import make_plan, read_anchors, read_flight, read_plan, write_example
from dronepose.synth.dataset import write_dataset
from dronepose.synth.inputs import cameras_of, read_drone, read_panoramas, read_scene
from dronepose.synth.sheet import draw_sheet
from dronepose.synth.studio import Studio

ROOT = Path(__file__).resolve().parent.parent
ROWS = 5


def main() -> None:
    """Render a few rows and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "pictures")
    folder = parser.parse_args().folder
    studio = Studio(read_scene("example")[0], [read_drone("example")[0]], samples=4)
    with tempfile.TemporaryDirectory() as name:
        paths = write_example(name)
        plan = make_plan(read_flight(paths["flight"]), read_anchors(paths["anchors"]), scene="hall")
        plan.some(3 * ROWS).write(Path(name) / "plan.csv")
        table = read_plan(Path(name) / "plan.csv")
        write_dataset(
            Path(name) / "set", table, studio, cameras_of(table), building="hall",
            environments=read_panoramas(None)[0],
        )  # fmt: skip
        sheet = draw_sheet(Path(name) / "set", rows=ROWS, width=128)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "synth_sheet.png").write_bytes(sheet)
    print(folder / "synth_sheet.png")


if __name__ == "__main__":
    main()
