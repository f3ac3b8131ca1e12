"""The scene map: outcomes by goal slot, where failed episodes ended, sampled trajectories."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b

import numpy as np
import pandas as pd

from parking_exp.envs.geometry import N_SLOTS
from parking_exp.envs.outcomes import OUTCOMES, Outcome
from parking_exp.envs.scenes import Scenes
from parking_exp.errors import ResultsError
from parking_exp.reports.report_data import Path, SlotRate
from parking_exp.reports.run_evaluations import FinalEpisodes
from parking_exp.results.frames import Results

PATHS_AN_OUTCOME = 4
SEEDS = 10  # whose trajectories are looked at
MOST_FAILURES = 200  # of a cell, of which a report has the ends
LONG, EVERY = 100, 5  # of a trajectory with more steps than LONG, a report has every EVERYth position


@dataclass(frozen=True)
class LotMap:
    """Where episodes of a cell went.

    Attributes:
        paths: some of each outcome.
        failures: (x_m, y_m, outcome) where crashes and timeouts ended, of MOST_FAILURES at most.
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
    drawn, failed, problems = _drawn(runs, results, final, 1 if vehicles_count else PATHS_AN_OUTCOME)
    failures: list[tuple[float, float, str]] = []
    for one in failed:
        x, y = one.rows[["x_m", "y_m"]].to_numpy()[-1]
        failures.append((round(float(x), 2), round(float(y), 2), one.outcome))
    return LotMap([_path(one, vehicles_count) for one in drawn], failures, problems)


def sampled_rows(
    runs: Sequence[tuple[int, str]], results: Results, final: Mapping[str, FinalEpisodes]
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Return the rows of trajectories that `sample` needs, by run id, and its problems.

    From these alone it draws the same ones again.
    """
    drawn, failed, problems = _drawn(runs, results, final, PATHS_AN_OUTCOME)
    kept = {(one.run_id, one.scene): one.rows.tail(1) for one in failed}
    kept |= {(one.run_id, one.scene): one.rows for one in drawn}
    by_run: dict[str, list[pd.DataFrame]] = {}
    for (run_id, _), rows in sorted(kept.items(), key=lambda item: item[0]):
        by_run.setdefault(run_id, []).append(rows)
    return {run_id: pd.concat(tables, ignore_index=True) for run_id, tables in by_run.items()}, problems


@dataclass(frozen=True)
class _Recorded:
    """A recorded episode; its rows are thinned. `draw` decides which ones are drawn: the lowest."""

    run_id: str
    seed: int
    scene: int
    outcome: Outcome
    rows: pd.DataFrame

    @property
    def draw(self) -> bytes:
        # A hash of the episode itself, not the next number of a generator: what was drawn is drawn again from less.
        return blake2b(f"{self.seed} {self.scene}".encode(), digest_size=8).digest()


def _drawn(
    runs: Sequence[tuple[int, str]], results: Results, final: Mapping[str, FinalEpisodes], wanted: int
) -> tuple[list[_Recorded], list[_Recorded], list[str]]:
    """Return episodes to draw, `wanted` of each outcome; failed ones; a sentence for each unreadable recording."""
    failed: list[_Recorded] = []
    ranked: list[tuple[int, _Recorded]] = []
    problems = []
    for index in np.random.default_rng(0).permutation(len(runs))[:SEEDS]:
        seed, run_id = runs[index]
        try:
            table = results.trajectories(run_id)
        except ResultsError as error:
            problems.append(str(error))
            continue
        if run_id not in final or not len(table):
            continue
        rows = dict(list(_thinned(table).groupby("scene")))
        episodes = [
            _Recorded(run_id, seed, scene, OUTCOMES[code], rows[scene])
            for scene, code in zip(final[run_id].scene.tolist(), final[run_id].outcome.tolist(), strict=True)
            if scene in rows
        ]
        failed += [one for one in episodes if one.outcome != "success"]
        for outcome in OUTCOMES:
            first = sorted((one for one in episodes if one.outcome == outcome), key=lambda one: one.draw)[:wanted]
            ranked += enumerate(first)
    ranked.sort(key=lambda one: one[0])  # each run's first before any run's second
    drawn = [[one for _, one in ranked if one.outcome == outcome][:wanted] for outcome in OUTCOMES]
    lowest = set(sorted(one.draw for one in failed)[:MOST_FAILURES])
    return [one for some in drawn for one in some], [one for one in failed if one.draw in lowest], problems


def _thinned(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of trajectories, of long ones only every fifth step and the end."""
    step = table["step"].to_numpy()
    end = table.groupby("scene")["step"].transform("max").to_numpy()
    return table[(end <= LONG) | (step % EVERY == 0) | (step == end)]


def _path(one: _Recorded, vehicles_count: int) -> Path:
    x, y, heading = ([round(float(value), 2) for value in one.rows[name]] for name in ("x_m", "y_m", "heading_rad"))
    start = Scenes.from_seeds([one.scene], vehicles_count)
    parked = start.parked[0].tolist()
    steps = int(one.rows["step"].iloc[-1])
    return Path(one.seed, one.scene, one.outcome, int(start.goal[0]), x, y, heading, steps, parked)
