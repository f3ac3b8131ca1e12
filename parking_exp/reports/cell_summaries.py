"""Summary of a cell over its seeds: means, learning curve, times to 90 %."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.report_data import CellSummary, Curve, RunSummary
from parking_exp.reports.reported_metrics import OF_EVERY_TASK, ReportedMetric, reported_metrics
from parking_exp.results.frames import CONFIG_PREFIX, TEXT, Results
from parking_exp.runs.run_state import STAGES
from parking_exp.statistics import (
    HOLD,
    Interval,
    finite_or_none,
    interquartile_mean,
    mean_interval,
    normalised_area,
    steps_to,
    wilson_interval,
)
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.registry import FAILURES, task_reports

RELIABLE = 0.95  # final success of a seed
FINAL_EPISODES = f"{CONFIG_PREFIX}evaluation.final_n_scenes"
"""Column of runs, which runs with a damaged config lack."""


@dataclass(frozen=True)
class RunEvaluations:
    """Rows of `Results.curves` and `Results.episodes`, split by run id.

    They are split once, since selecting rows for each run is slow.
    """

    curves: dict[str, pd.DataFrame]
    final: dict[str, pd.DataFrame]  # the final episodes
    n_evaluations: pd.Series  # in each run's curve, also those without a rate
    paths: pd.DataFrame  # `Results.paths`, with the outcome of each episode


def split_by_run(results: Results) -> RunEvaluations:
    """Split the evaluations of some results."""
    n_evaluations = results.curves["run_id"].value_counts()
    curves = results.curves.dropna(subset=["success_rate"])
    # Each task has one of the failures.
    failures = curves.reindex(columns=[f"{name}_rate" for name in FAILURES])
    curves = curves.assign(failure_rate=failures.bfill(axis=1).iloc[:, 0])
    final = results.episodes[results.episodes["phase"] == "final"]
    outcomes = final[["run_id", EPISODE_SEED, "outcome"]].astype({"run_id": TEXT})
    paths = results.paths.merge(outcomes, on=["run_id", EPISODE_SEED])
    return RunEvaluations(_group_by_run(curves), _group_by_run(final), n_evaluations, paths)


def _group_by_run(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {str(run): rows for run, rows in frame.groupby("run_id", sort=False, observed=True)}


def summarise_cell(cell: CellRuns, evaluations: RunEvaluations, *, unfinished: bool) -> CellSummary:
    """Return a cell's numbers; with `unfinished`, its learning curve includes runs not done."""
    reported = reported_metrics(cell.done.columns)
    seeds = [_summarise_run(run, reported, evaluations) for run in cell.done.to_dict("records")]
    success = [seed.success for seed in seeds if seed.success is not None]
    total_timesteps = _to_int(cell.config.get("total_timesteps"))
    curve_runs = cell.runs if unfinished else cell.done
    return CellSummary(
        id=cell.id,
        label=cell.label,
        experiment=cell.experiment,
        name=cell.name,
        settings=cell.settings,
        counts=_count_stages(cell.runs["status"]),
        total_timesteps=total_timesteps,
        metrics=_average_metrics(seeds, reported, is_trained=total_timesteps != 0),
        cpu_s=_mean([seed.cpu_s for seed in seeds]),
        area=_mean_rate([seed.area for seed in seeds]),
        seeds=seeds,
        curve=_average_curves(curve_runs, evaluations),
        **_summarise_task(cell, seeds, evaluations),
        **_describe_success(success),
        **_measure_time_to_90(seeds),
    )


def _average_metrics(
    seeds: Sequence[RunSummary], reported: Sequence[ReportedMetric], *, is_trained: bool
) -> dict[str, Interval]:
    """Return the mean of each metric over seeds, by its name."""
    n_episodes = min((seed.n_episodes or 0 for seed in seeds), default=0) or None
    means = {}
    for metric in reported:
        values = [seed.metrics.get(metric.name) for seed in seeds]
        mean = _mean_rate(values, n_episodes) if metric.is_rate else _mean(values)
        if metric.is_rate and not is_trained:
            mean = _episode_interval(mean, n_episodes)
        means[metric.name] = mean
    return _without_other_tasks(means)


def _describe_success(rates: Sequence[float]) -> dict[str, Any]:
    """Return the fields of a cell about the success of its seeds, beside its mean."""
    if not rates:
        return {}
    return {
        "lowest": min(rates),
        "iqm": interquartile_mean(rates),
        "reaching_95": sum(rate >= RELIABLE for rate in rates),
    }


def _summarise_run(
    run: Mapping[Any, Any], reported: Sequence[ReportedMetric], evaluations: RunEvaluations
) -> RunSummary:
    metrics = {metric.name: finite_or_none(run[metric.column]) for metric in reported}
    run_id = run["run_id"]
    run_dir = run["run_dir"] if isinstance(run["run_dir"], str) else None
    n_episodes = len(evaluations.final.get(run_id, ())) or _to_int(run.get(FINAL_EPISODES))
    return RunSummary(
        seed=int(run["seed"]),
        run_id=run_id,
        run_dir=run_dir,
        metrics=_without_other_tasks(metrics),
        n_episodes=n_episodes,
        cpu_s=finite_or_none(run["cpu_s"]),
        **_measure_curve(evaluations.curves.get(run_id)),
    )


def _without_other_tasks(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics of a seed or a cell without those that only other tasks have."""
    unknown = (None, Interval(None))
    return {
        name: value
        for name, value in metrics.items()
        if name in OF_EVERY_TASK or value not in unknown
    }


def _measure_curve(curve: pd.DataFrame | None) -> dict[str, Any]:
    """Return the fields of a seed that are computed from its learning curve."""
    if curve is None:
        return {}
    steps = curve["step"].to_numpy()
    success = curve["success_rate"].to_numpy()
    fields: dict[str, Any] = {}
    if len(steps) > 1:
        fields["area"] = normalised_area(steps, success)
    if len(steps) >= HOLD:
        step = steps_to(steps, success)
        fields["reached_90"] = step is not None
        if step is not None:
            cpu_s = curve["cpu_s"].iloc[np.searchsorted(steps, step)]
            fields |= {"steps_to_90": step, "cpu_s_to_90": finite_or_none(cpu_s)}
    return fields


def _average_curves(runs: pd.DataFrame, evaluations: RunEvaluations) -> Curve | None:
    """Return the mean and the range of success over the seeds that have curves."""
    seeds = {}
    for run_id, seed in zip(runs["run_id"], runs["seed"], strict=True):
        if run_id in evaluations.curves:
            seeds[int(seed)] = evaluations.curves[run_id]
    if not seeds:
        return None

    by_step = pd.concat(seeds.values()).groupby("step")
    success = by_step["success_rate"].agg(["mean", "min", "max", "count"])
    return Curve(
        step=success.index.tolist(),
        mean=success["mean"].tolist(),
        low=success["min"].tolist(),
        high=success["max"].tolist(),
        n=success["count"].tolist(),
        failure=[finite_or_none(rate) for rate in by_step["failure_rate"].mean()],
        seeds=[
            (seed, curve["step"].tolist(), curve["success_rate"].tolist())
            for seed, curve in seeds.items()
        ],
    )


def _measure_time_to_90(seeds: Sequence[RunSummary]) -> dict[str, Any]:
    """Return the fields of a cell about the time to 90 %."""
    timed = [seed for seed in seeds if seed.reached_90 is not None]
    n_reached_90 = sum(bool(seed.reached_90) for seed in timed)
    cpu_times = [seed.cpu_s_to_90 for seed in timed]
    n_cpu_times = sum(time is not None for time in cpu_times)
    return {
        "n_timed": len(timed),
        "n_reached_90": n_reached_90,
        "steps_to_90": _median_time([seed.steps_to_90 for seed in timed]),
        # An unknown CPU time does not mean that a seed never reached 90 %.
        "cpu_s_to_90": _median_time(cpu_times) if n_cpu_times == n_reached_90 else None,
    }


def _median_time(times: Sequence[float | None]) -> float | None:
    """Return the time by which half of the seeds reach 90 %; None stands for never."""
    known = sorted(time for time in times if time is not None)
    middle = (len(times) - 1) // 2
    return known[middle] if 0 <= middle < len(known) else None


def _summarise_task(
    cell: CellRuns, seeds: Sequence[RunSummary], evaluations: RunEvaluations
) -> dict[str, Any]:
    """Return the fields of a cell that hold what sections and figures of its task show."""
    task = next(task_reports([cell.task]), None)
    if task is None:
        return {}
    final = [evaluations.final[seed.run_id] for seed in seeds if seed.run_id in evaluations.final]
    paths = evaluations.paths[evaluations.paths["run_id"].isin(cell.done["run_id"])]
    return {
        "task_data": task.cell_data(final, cell.config),
        "figure_data": task.figure_data(paths, cell.config),
    }


def _mean(values: Sequence[float | None]) -> Interval:
    """Return the mean of the values that are known, without an interval."""
    known = [value for value in values if value is not None]
    return Interval(sum(known) / len(known), n=len(known)) if known else Interval(None)


def _mean_rate(rates: Sequence[float | None], n_episodes: int | None = None) -> Interval:
    """Return the mean of the rates that are known, with its interval."""
    known = [rate for rate in rates if rate is not None]
    # Without a number of episodes, equal rates would have an interval without width.
    if not known or (n_episodes is None and len(set(known)) == 1):
        return _mean(known)
    return mean_interval(known, n_episodes)


def _episode_interval(mean: Interval, n_episodes: int | None) -> Interval:
    """Return the rate of a single seed with the interval over its episodes.

    That is for what is not trained: its seeds do not collapse as trainings may.
    """
    if mean.n != 1 or mean.value is None or n_episodes is None:
        return mean
    low, high = wilson_interval(round(mean.value * n_episodes), n_episodes)
    return Interval(mean.value, low, high, 1)


def _count_stages(status: pd.Series) -> dict[str, int]:
    runs = Counter(status)
    runs["pending"] = runs["interrupted"]  # as stores call it
    return {stage: runs[stage] for stage in STAGES}


def _to_int(value: Any) -> int | None:
    number = finite_or_none(value)
    return None if number is None else int(number)
