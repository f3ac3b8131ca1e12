"""Draw scene 1 of each lot at level normal for the documentation.

`PYTHONPATH=. python tests/support/lot_picture.py docs/images/lots.png` writes the picture.
"""

import sys
from types import SimpleNamespace

import pandas as pd

from parking_exp.config.compose import compose
from parking_exp.figure_style import report_style
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.lot_figures import DrawnLot, draw_lots, draw_polygons, outlines
from parking_exp.tasks.parking.scenes import NO_SLOT

LOTS = ("parking_parallel", "parking_bays", "parking_angled", "parking_dead_end")


def draw():
    """Return a figure of all lots: the goal is blue, the car green, parked cars grey."""
    cells = []
    for name in LOTS:
        config = compose(f"env={name}", "env.level=normal")
        scene = lot_of(config.env).from_seeds([1])
        shown = DrawnLot(scene, walls=True, paths=pd.DataFrame())
        cells.append(SimpleNamespace(label=name, figure_data=shown))

    figure, panels = draw_lots(cells)
    for axes, cell in zip(panels, cells, strict=True):
        scene = cell.figure_data.scene
        parked = scene.vehicle_pose[0][scene.vehicles[0] != NO_SLOT]
        goal = outlines(scene.goal_pose, *scene.slot_size[0])
        draw_polygons(axes, goal, facecolors="#56B4E9")
        for poses, colour in ((parked, "#b0b4b9"), (scene.start, "#009E73")):
            cars = outlines(poses, CAR_LENGTH_M, CAR_WIDTH_M)
            draw_polygons(axes, cars, facecolors=colour)
    return figure


if __name__ == "__main__":
    with report_style():
        draw().savefig(sys.argv[1])
