"""The scene map: outcomes by goal slot, where failed episodes ended, sampled trajectories."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd

from parking_exp.envs.geometry import N_SLOTS
from parking_exp.envs.outcomes import OUTCOMES, Outcome
from parking_exp.envs.scenes import Scenes
from parking_exp.errors import ResultsError
from parking_exp.reports.curves import FinalEpisodes
from parking_exp.reports.report_data import Path, SlotRate
from parking_exp.results.frames import Results

PATHS_AN_OUTCOME = 4
SEEDS = 10  # whose trajectories are looked at


@dataclass(frozen=True)
class LotMap:
    """Where episodes of a cell went.

    Attributes:
        paths: some of each outcome.
        failures: (x_m, y_m, outcome) where crashes and timeouts ended.
        problems: a sentence for each recording that can't be read.
    """

    paths: list[Path]
    failures: list[tuple[float, float, str]]
    problems: list[str]


def slot_rates(runs: Sequence[FinalEpisodes]) -> list[SlotRate]:
    """Return what happened in the scenes with each goal slot, over the episodes of several runs."""
    if not runs:
        return []
    slots = goals(np.concatenate([run.scene for run in runs]))
    counts = np.zeros((N_SLOTS, len(OUTCOMES)), int)
    np.add.at(counts, (slots, np.concatenate([run.outcome for run in runs])), 1)
    there = [(slot, int(row.sum()), row) for slot, row in enumerate(counts) if row.any()]
    return [SlotRate(slot, n, *(row / n).tolist()) for slot, n, row in there]


def goals(scenes: np.ndarray) -> np.ndarray:
    """Return the goal slots of scenes, both of shape (n,)."""
    unique, place = np.unique(scenes, return_inverse=True)
    return np.array([_goal(int(scene)) for scene in unique])[place]


@cache
def _goal(scene: int) -> int:
    return int(Scenes.from_seeds([scene]).goal[0])


def sample(
    runs: Sequence[tuple[int, str]], results: Results, final: Mapping[str, FinalEpisodes], vehicles_count: int
) -> LotMap:
    """Return some trajectories of each outcome, and where crashes and timeouts ended.

    Which ones is drawn at random, the same ones each time: of a few runs, from as many different ones as there are.
    With parked cars, which belong to one episode, it is one of each outcome.

    Args:
        runs: (seed, run id) of the finished runs of a cell.
        results: where their trajectories are.
        final: their final episodes, by run id.
        vehicles_count: parked cars in each scene.
    """
    rng = np.random.default_rng(0)
    found = LotMap([], [], [])
    drawn: dict[Outcome, list[tuple[int, Path]]] = {outcome: [] for outcome in OUTCOMES}
    wanted = 1 if vehicles_count else PATHS_AN_OUTCOME
    for index in rng.permutation(len(runs))[:SEEDS]:
        seed, run_id = runs[index]
        try:
            table = results.trajectories(run_id)
        except ResultsError as error:
            found.problems.append(str(error))
            continue
        if run_id not in final or not len(table):
            continue
        ways = dict(list(table.groupby("scene")))
        for scene, code in zip(final[run_id].scene.tolist(), final[run_id].outcome.tolist(), strict=True):
            if scene in ways and (outcome := OUTCOMES[code]) != "success":
                x, y = ways[scene][["x_m", "y_m"]].to_numpy()[-1]
                found.failures.append((round(float(x), 2), round(float(y), 2), outcome))
        for code, outcome in enumerate(OUTCOMES):
            scenes = final[run_id].scene[final[run_id].outcome == code]
            recorded = [scene for scene in scenes.tolist() if scene in ways]
            for rank, scene in enumerate(rng.permutation(recorded)[:wanted].tolist()):
                drawn[outcome].append((rank, _path(ways[scene], seed, scene, outcome, vehicles_count)))
    for paths in drawn.values():  # each run's first before any run's second
        found.paths.extend(path for _, path in sorted(paths, key=lambda one: one[0])[:wanted])
    return found


def _path(rows: pd.DataFrame, seed: int, scene: int, outcome: Outcome, vehicles_count: int) -> Path:
    x, y, heading = ([round(float(value), 3) for value in rows[name]] for name in ("x_m", "y_m", "heading_rad"))
    start = Scenes.from_seeds([scene], vehicles_count)
    return Path(seed, scene, outcome, int(start.goal[0]), x, y, heading, start.parked[0].tolist())
