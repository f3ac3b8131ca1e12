"""A cell's runs -> its numbers: seeds, means, curves, times to 90 %, scene map, sampled trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.reports.content import Cell, Curve, Interval, Path, Seed, Share, SlotRate, Survival
from parking_exp.reports.selection import Group
from parking_exp.results import Results
from parking_exp.scenes import Scenes
from parking_exp.statistics import (
    Estimate,
    coverage_note,
    kaplan_meier,
    mean_band,
    mean_interval,
    normalised_area,
    restricted_mean,
    share_reaching,
    steps_to,
    wilson_interval,
)

GOOD = 0.9
HOLD = 3
PATHS_AN_OUTCOME = 4
SEEDS_OF_PATHS = 10
OUTCOMES = ("success", "crash", "timeout")
STAGES = {"interrupted": "pending", "killed": "failed"}
RATES = {name: f"{name}_rate" for name in (*OUTCOMES, "parked")}


@dataclass(frozen=True)
class Frames:
    """Curves and certified episodes of every run, by run id."""

    curves: dict[str, pd.DataFrame]
    episodes: dict[str, pd.DataFrame]

    @staticmethod
    def of(results: Results) -> "Frames":
        """Split the frames once: a thousand look-ups in a frame are slow."""
        certified = results.episodes[results.episodes["phase"] == "certified"]
        return Frames(_by_run(results.curves), _by_run(certified))


def summarise(
    group: Group, number: int, frames: Frames, horizons: tuple[float | None, float | None], unfinished: bool
) -> Cell:
    """Return a cell's numbers.

    Args:
        group: its runs.
        number: of the cell in the report.
        frames: see there.
        horizons: up to which env step, and CPU-second, times to 90 % are averaged; see `shared_horizons`.
        unfinished: whether learning curves show runs that are not done, too.
    """
    runs: list[dict[str, Any]] = group.done.to_dict("records")  # type: ignore[assignment]
    seeds = [_seed(run, frames) for run in runs]
    success = _mean([seed.success for seed in seeds])
    times = [(seed.steps_to_90, seed.reached_90) for seed in seeds]
    cpu_times = [(seed.cpu_s_to_90, seed.reached_90) for seed in seeds]
    return Cell(
        id=f"c{number}",
        label=group.label,
        experiment=group.experiment,
        name=group.name,
        settings=group.settings,
        counts=_counts(group.runs["status"]),
        total_timesteps=_whole(group.config.get("total_timesteps")),
        success=success,
        crash=_mean([seed.crash for seed in seeds]),
        timeout=_mean([seed.timeout for seed in seeds]),
        parked=_mean([seed.parked for seed in seeds]),
        episode_steps=_mean([seed.episode_steps for seed in seeds], bounds=None),
        cpu_s=_mean([seed.cpu_s for seed in seeds], bounds=None),
        area=_mean([seed.area for seed in seeds]),
        reaching_90=_reaching([seed.success for seed in seeds]),
        seeds=seeds,
        curve=_curve(group.runs if unfinished else group.done, frames),
        survival=_survival("env steps", times, horizons[0]),
        survival_cpu=_survival("CPU-seconds", cpu_times, horizons[1]),
        slots=_slots([frames.episodes[seed.run_id] for seed in seeds if seed.run_id in frames.episodes]),
        note=_note([seed.success for seed in seeds]),
    )


def shared_horizons(groups: Sequence[Group], frames: Frames) -> tuple[float | None, float | None]:
    """Return the env step and the CPU-second up to which every finished run was watched."""
    curves = [_evaluated(frames.curves.get(run)) for group in groups for run in group.done["run_id"]]
    steps = [float(curve["step"].iloc[-1]) for curve in curves if len(curve)]
    cpu_s = [end for curve in curves if len(curve) and (end := _trained_s(curve)) is not None]
    return min(steps, default=None), min(cpu_s, default=None)


def real_share(group: Group, frames: Frames) -> float | None:
    """Return the mean share of real transitions in a cell's batches, as the buffer measured it."""
    curves = [frames.curves[run]["real_share"].dropna() for run in group.done["run_id"] if run in frames.curves]
    last = [float(known.iloc[-1]) for known in curves if len(known)]
    return float(np.mean(last)) if last else None


def sample(cell: Cell, results: Results, frames: Frames) -> tuple[list[Path], list[tuple[float, float, str]]]:
    """Return some trajectories of each outcome, and where all crashes and timeouts of the cell ended.

    Which ones is drawn at random, the same ones each time: from as many different seeds as there are.
    """
    rng = np.random.default_rng(0)
    paths, ends = [], []
    wanted: dict[str, list[tuple[Seed, int]]] = {outcome: [] for outcome in OUTCOMES}
    for index in rng.permutation(len(cell.seeds)):
        seed = cell.seeds[index]
        episodes = frames.episodes.get(seed.run_id)
        if episodes is None:
            continue
        for outcome in OUTCOMES:
            scenes = episodes.loc[episodes["outcome"] == outcome, "scene"].to_numpy(copy=True)
            wanted[outcome] += [(seed, int(scene)) for scene in rng.permutation(scenes)]
    for outcome, found in wanted.items():
        wanted[outcome] = _spread(found)
    tables: dict[str, pd.DataFrame] = {}
    for seed in cell.seeds:
        table = results.trajectories(seed.run_id)
        if not len(table):
            continue
        tables[seed.run_id] = table
        last = table.drop_duplicates("scene", keep="last").set_index("scene")
        episodes = frames.episodes.get(seed.run_id)
        if episodes is not None:
            failed = episodes[episodes["outcome"] != "success"].set_index("scene")["outcome"]
            both = last.join(failed, how="inner")
            ends += [
                (float(x), float(y), str(o)) for x, y, o in zip(both["x_m"], both["y_m"], both["outcome"], strict=True)
            ]
    for outcome, found in wanted.items():
        usable = [(seed, scene) for seed, scene in found if seed.run_id in tables][:PATHS_AN_OUTCOME]
        paths += [_path(tables[seed.run_id], seed.seed, scene, outcome) for seed, scene in usable]
    return paths, ends


def _path(table: pd.DataFrame, seed: int, scene: int, outcome: Any) -> Path:
    rows = table[table["scene"] == scene]
    x, y, heading = ([round(float(value), 3) for value in rows[name]] for name in ("x_m", "y_m", "heading_rad"))
    goal = int(Scenes.from_seeds([scene]).goal[0])
    return Path(seed, scene, outcome, goal, x, y, heading)


def _spread(found: list[tuple[Seed, int]]) -> list[tuple[Seed, int]]:
    """Order episodes so that each seed's first comes before any seed's second."""
    rank: dict[int, int] = {}
    keyed = []
    for seed, scene in found:
        keyed.append((rank.setdefault(seed.seed, 0), seed, scene))
        rank[seed.seed] += 1
    return [(seed, scene) for _, seed, scene in sorted(keyed, key=lambda one: one[0])]


def _seed(run: dict[str, Any], frames: Frames) -> Seed:
    rates = {name: _number(run.get(column)) for name, column in RATES.items()}
    episodes, curve = frames.episodes.get(run["run_id"]), _evaluated(frames.curves.get(run["run_id"]))
    n_scenes = len(episodes) if episodes is not None else _whole(run.get("n_scenes"))
    low = high = None
    if rates["success"] is not None and n_scenes:
        low, high = wilson_interval(round(rates["success"] * n_scenes), n_scenes)
    steps, reached, cpu_s, area = _course(curve)
    return Seed(
        seed=int(run["seed"]),
        run_id=run["run_id"],
        run_dir=run.get("run_dir"),
        **rates,
        n_scenes=n_scenes,
        low=low,
        high=high,
        episode_steps=_number(run.get("episode_steps")),
        cpu_s=_number(run.get("cpu_s")),
        steps_to_90=steps,
        reached_90=reached,
        cpu_s_to_90=cpu_s,
        area=area,
    )


def _course(curve: pd.DataFrame) -> tuple[float | None, bool, float | None, float | None]:
    """Return time to 90 % in env steps, whether it was reached, the same in CPU-seconds, and the area."""
    if not len(curve):
        return None, False, None, None
    steps, rates = curve["step"].to_numpy(float), curve["success_rate"].to_numpy(float)
    time, reached = steps_to(steps, rates, GOOD, HOLD)
    cpu_s = _number(curve.loc[curve["step"] == time, "cpu_s"].iloc[-1]) if reached else _trained_s(curve)
    return float(time), reached, cpu_s, normalised_area(steps, rates) if len(curve) > 1 else None


def _trained_s(curve: pd.DataFrame) -> float | None:
    """Return the CPU seconds up to which a run was watched. What its last row says includes how the run ended: the
    final evaluation and its certification, which may take longer than the training did.
    """
    return _number(curve["cpu_s"].iloc[-2 if len(curve) > 1 else -1])


def _curve(runs: pd.DataFrame, frames: Frames) -> Curve | None:
    """Return the learning curve over all runs that have one."""
    known = {
        int(seed): _evaluated(frames.curves.get(run)) for run, seed in zip(runs["run_id"], runs["seed"], strict=True)
    }
    tables = {seed: table for seed, table in known.items() if len(table)}
    if not tables:
        return None
    success, crash = (
        pd.concat({seed: table.set_index("step")[name] for seed, table in tables.items()}, axis=1).sort_index()
        for name in ("success_rate", "crash_rate")
    )
    means = [_interval(point) for point in mean_band(success.to_numpy(float).T)]
    return Curve(
        step=[int(step) for step in success.index],
        mean=[mean.value for mean in means],
        low=[mean.low for mean in means],
        high=[mean.high for mean in means],
        n=[mean.n for mean in means],
        crash=[_number(value) for value in crash.mean(axis=1)],
        seeds=[
            (seed, [int(step) for step in table["step"]], [_number(rate) for rate in table["success_rate"]])
            for seed, table in tables.items()
        ],
    )


def _survival(unit: str, times: Sequence[tuple[float | None, bool]], horizon: float | None) -> Survival | None:
    known = [(time, reached) for time, reached in times if time is not None]
    if not known:
        return None
    at, observed = np.array([time for time, _ in known]), np.array([reached for _, reached in known])
    estimate = kaplan_meier(at, observed)
    start = [0.0] if estimate.times[0] > 0 else []  # where nobody has reached anything
    mean = Interval(None)
    if horizon:
        found = restricted_mean(at, observed, horizon)
        mean = Interval(found.mean, _number(found.low), _number(found.high), found.n, found.method)
    return Survival(
        unit=unit,
        time=[*start, *estimate.times],
        reached=[*start, *estimate.reached],
        low=[*start, *map(_number, estimate.low)],
        high=[*start, *map(_number, estimate.high)],
        censored=sorted(time for time, reached in known if not reached),
        n=len(known),
        k=int(observed.sum()),
        median=estimate.median,
        restricted_mean=mean,
        horizon=horizon,
    )


def _slots(tables: Sequence[pd.DataFrame]) -> list[SlotRate]:
    """Return what happened in the scenes with each goal slot."""
    if not tables:
        return []
    episodes = pd.concat(tables)
    scenes = np.unique(episodes["scene"])
    goals = pd.Series(Scenes.from_seeds(scenes.tolist()).goal, index=scenes)
    table = pd.crosstab(episodes["scene"].map(goals), episodes["outcome"].astype(str))
    found = []
    for slot, row in table.iterrows():
        n = int(row.sum())
        found.append(SlotRate(int(slot), n, *(float(row.get(outcome, 0)) / n for outcome in OUTCOMES)))  # type: ignore[call-overload]
    return found


def _mean(values: Sequence[float | None], bounds: tuple[float, float] | None = (0.0, 1.0)) -> Interval:
    known = [value for value in values if value is not None]
    return _interval(mean_interval(known, bounds=bounds)) if known else Interval(None)


def _interval(estimate: Estimate) -> Interval:
    return Interval(_number(estimate.mean), _number(estimate.low), _number(estimate.high), estimate.n, estimate.method)


def _reaching(values: Sequence[float | None]) -> Share:
    known = [value for value in values if value is not None]
    if not known:
        return Share(0, 0, None, None)
    share = share_reaching(known, GOOD)
    return Share(share.k, share.n, share.low, share.high)


def _note(values: Sequence[float | None]) -> str | None:
    known = [value for value in values if value is not None]
    return coverage_note(known) if known else None


def _counts(status: pd.Series) -> dict[str, int]:
    stages = [STAGES.get(one, one) for one in status]
    return {stage: stages.count(stage) for stage in ("done", "running", "failed", "pending")}


def _by_run(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {str(run): table.reset_index(drop=True) for run, table in frame.groupby("run_id", sort=False, observed=True)}


def _evaluated(curve: pd.DataFrame | None) -> pd.DataFrame:
    """Return the rows that have a success rate."""
    return pd.DataFrame() if curve is None else curve[curve["success_rate"].notna()]


def _number(value: Any) -> float | None:
    """Return a finite number, else None."""
    return None if value is None or not np.isfinite(value) else float(value)


def _whole(value: Any) -> int | None:
    return None if (number := _number(value)) is None else int(number)
