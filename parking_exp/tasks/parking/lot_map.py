"""Data of the map of the lot: outcomes by goal slot, where failed episodes ended, sampled trajectories."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd

from parking_exp.errors import ResultsError
from parking_exp.tasks.parking.geometry import N_SLOTS
from parking_exp.tasks.parking.scenes import Scenes

OUTCOMES = ("success", "crash", "timeout")
PATHS_AN_OUTCOME = 4
SEEDS = 10  # of a cell, whose trajectories are looked at
MOST_FAILURES = 200  # of a cell, of which a report has the ends
LONG, EVERY = 100, 5  # of a trajectory with more steps than LONG, a report has every EVERYth position
Runs = Sequence[tuple[int, str]]
"""(seed, run id) of the finished runs of a cell."""
Recording = Callable[[str], pd.DataFrame]
"""Run id -> what the run recorded of final episodes."""
COLUMNS = ["scene", "step", "x_m", "y_m", "heading_rad"]
ADDED = ["run_id", "seed", "outcome", "end", "rank", "failed"]


@dataclass(frozen=True)
class SlotRate:
    """Rates of the `n` episodes of all seeds whose goal is one slot, 0 ... 27."""

    slot: int
    n: int
    success: float | None
    crash: float | None
    timeout: float | None


@dataclass(frozen=True)
class Path:
    """One episode seen from above: poses at the start and after each step; of a long one, after every fifth."""

    seed: int
    scene: int
    outcome: str
    slot: int
    x_m: Sequence[float]
    y_m: Sequence[float]
    heading_rad: Sequence[float]
    steps: int
    parked_slots: Sequence[int] = ()


def slot_rates(runs: Sequence[pd.DataFrame]) -> list[SlotRate]:
    """Return the rates of outcomes by goal slot, over the final episodes (scene, outcome) of several runs."""
    if not runs:
        return []
    episodes = pd.concat(runs)
    slots = np.array([_goal(scene) for scene in episodes["scene"].tolist()])
    counts = np.zeros((N_SLOTS, len(OUTCOMES)), int)
    np.add.at(counts, (slots, pd.Categorical(episodes["outcome"].astype(object), OUTCOMES).codes), 1)
    return [SlotRate(slot, int(row.sum()), *(row / row.sum()).tolist()) for slot, row in enumerate(counts) if row.any()]


@cache
def _goal(scene: int) -> int:
    return int(Scenes.from_seeds([scene]).goal[0])


def sample(
    runs: Runs, recording: Recording, final: Mapping[str, pd.DataFrame], vehicles_count: int
) -> tuple[list[Path], list[tuple[float, float, str]], list[str]]:
    """Return some trajectories of each outcome, where crashes and timeouts ended [m], and unreadable recordings.

    With parked cars, which belong to one episode, it is one trajectory of each outcome. `runs` are (seed, run id) of
    the finished runs of a cell.
    """
    rows, problems = _sampled(runs, recording, final)
    drawn = rows[rows["rank"] < (1 if vehicles_count else PATHS_AN_OUTCOME)]
    paths = [_path(episode, vehicles_count) for _, episode in drawn.groupby(["outcome", "rank"], observed=True)]
    ends = rows[rows["failed"].astype(bool)].drop_duplicates(["run_id", "scene"], keep="last")
    failures = zip(ends["x_m"].round(2).tolist(), ends["y_m"].round(2).tolist(), ends["outcome"], strict=True)
    return paths, list(failures), problems


def sampled_rows(
    runs: Runs, recording: Recording, final: Mapping[str, pd.DataFrame]
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Return the rows of trajectories that `sample` needs to draw the same ones, by run id, and its problems."""
    rows, problems = _sampled(runs, recording, final)
    columns = rows.columns.difference(ADDED, sort=False)
    return {str(run_id): part[columns].reset_index(drop=True) for run_id, part in rows.groupby("run_id")}, problems


def _sampled(runs: Runs, recording: Recording, final: Mapping[str, pd.DataFrame]) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows of trajectories that figures show, and problems.

    These are the thinned rows of episodes to draw, and the last row of failed ones. They also have the columns ADDED:
    `rank` of an episode to draw among those of its outcome, else NaN; `failed` where its end is shown.
    """
    tables, problems = [], []
    for seed, run_id in runs[:SEEDS]:
        try:
            rows = recording(run_id)
        except ResultsError as error:
            problems.append(str(error))
            continue
        if run_id in final and len(rows):
            outcome = final[run_id].set_index("scene")["outcome"].astype(object)
            tables.append(rows.assign(run_id=run_id, seed=seed, outcome=rows["scene"].map(outcome)))
    if not tables:
        return pd.DataFrame(columns=[*COLUMNS, *ADDED]), problems
    rows = pd.concat(tables, ignore_index=True).dropna(subset="outcome")
    rows["end"] = rows.groupby(["run_id", "scene"])["step"].transform("max")
    rows = rows.merge(_chosen(rows.drop_duplicates(["run_id", "scene"])), on=["run_id", "scene"])
    drawn, last = rows["rank"].notna(), rows["step"] == rows["end"]
    thinned = (rows["end"] <= LONG) | (rows["step"] % EVERY == 0) | last
    return rows[(drawn & thinned) | (rows["failed"] & last)], problems


def _chosen(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return `rank` and `failed` of episodes, given by their first rows.

    Episodes are ordered by a hash, so the same ones are drawn again from a part of them.
    """
    episodes = episodes.iloc[pd.util.hash_pandas_object(episodes[["seed", "scene"]], index=False).argsort()]
    whole = episodes[episodes["step"] == 0]
    # Each run's first before any run's second.
    whole = whole.iloc[whole.groupby(["run_id", "outcome"]).cumcount().argsort(kind="stable")]
    rank = whole.groupby("outcome").cumcount()
    failed = episodes.index[episodes["outcome"] != "success"][:MOST_FAILURES]
    episodes = episodes.assign(rank=rank[rank < PATHS_AN_OUTCOME], failed=episodes.index.isin(failed))
    return episodes[["run_id", "scene", "rank", "failed"]]


def _path(rows: pd.DataFrame, vehicles_count: int) -> Path:
    last = rows.iloc[-1]
    start = Scenes.from_seeds([int(last["scene"])], vehicles_count)
    x, y, heading = (rows[name].astype(float).round(2).tolist() for name in ("x_m", "y_m", "heading_rad"))
    return Path(
        seed=int(last["seed"]),
        scene=int(last["scene"]),
        outcome=last["outcome"],
        slot=int(start.goal[0]),
        x_m=x,
        y_m=y,
        heading_rad=heading,
        steps=int(last["step"]),
        parked_slots=start.parked[0].tolist(),
    )
