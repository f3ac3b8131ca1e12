"""The seam between tasks and the rest: what is specific to parking stands in one package."""

import re
from pathlib import Path

from support.runs import ROOT

PACKAGE = ROOT / "parking_exp"
PARKING_WORDS = re.compile(r"\b(slots?|crash(es|ed|ing)?|cars?|scenes?|parked)\b", re.IGNORECASE)
NAMES = {  # public names of columns, which were there before the second task
    Path("results/__init__.py"): "columns of `episodes.csv` and of exports",
    Path("tasks/metrics.py"): 'EPISODE_SEED = "scene"',
}


def test_only_the_parking_task_names_slots_crashes_cars_and_scenes():
    found = {}
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE)
        lines = [line for line in path.read_text().splitlines() if PARKING_WORDS.search(line)]
        if lines and not place.is_relative_to("tasks/parking"):
            found[place] = lines
    assert set(found) == set(NAMES)
    assert found[Path("tasks/metrics.py")] == [NAMES[Path("tasks/metrics.py")]]
