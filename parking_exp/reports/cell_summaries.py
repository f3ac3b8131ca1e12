"""Summary of a cell over its seeds: means, learning curve, times to 90 %."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.report_data import Cell, Curve, RunSummary
from parking_exp.results.frames import Results
from parking_exp.statistics import (
    Interval,
    Proportion,
    coverage_note,
    finite_or_none,
    interquartile_mean,
    kaplan_meier,
    mean_interval,
    normalised_area,
    share_reaching,
    steps_to,
    wilson_interval,
)
from parking_exp.tasks.metrics import EPISODE_SEED, Metric
from parking_exp.tasks.registry import FAILURES, METRICS, task_reports

SUCCESS_THRESHOLD = 0.9
RELIABLE = 0.95  # final success of a seed
HOLD = 3  # evaluations in a row
STAGES = {"interrupted": "pending"}
REPORTED: dict[str, Metric] = {
    metric.name if metric.is_rate else metric.run_column: metric
    for metric in METRICS
    if metric.in_reports
}
"""Metrics of reports by their names in `Cell` and `RunSummary`."""
FURTHER = [name for name in REPORTED if name not in {field.name for field in fields(RunSummary)}]
"""Those without a field of their own, which only some tasks have."""
RUN_COLUMNS = [
    "run_id",
    "run_dir",
    "seed",
    "n_scenes",
    "cpu_s",
    *(metric.run_column for metric in REPORTED.values()),
]
CURVE_COLUMNS = ["run_id", "step", "success_rate", "failure_rate", "cpu_s"]


@dataclass(frozen=True)
class RunEvaluations:
    """Rows of `Results.curves` and `Results.episodes` by run id: selecting them for each run is
    slow.
    """

    curves: dict[str, pd.DataFrame]  # of the runs that have a success rate
    final: dict[str, pd.DataFrame]  # seed and outcome of the final episodes

    @staticmethod
    def of(results: Results) -> "RunEvaluations":
        """Split the frames of some results."""
        rated = results.curves.loc[results.curves["success_rate"].notna(), "run_id"].unique()
        curves = results.curves[results.curves["run_id"].isin(rated)]
        by_task = curves.reindex(
            columns=[f"{name}_rate" for name in FAILURES]
        )  # a task has one of them
        curves = curves.assign(failure_rate=by_task.bfill(axis=1).iloc[:, 0])[CURVE_COLUMNS]
        final = results.episodes.loc[
            results.episodes["phase"] == "final", ["run_id", EPISODE_SEED, "outcome"]
        ]
        by_run = [
            {str(run): rows for run, rows in frame.groupby("run_id", sort=False, observed=True)}
            for frame in (curves, final)
        ]
        return RunEvaluations(*by_run)


def summarise(cell: CellRuns, number: int, evaluations: RunEvaluations, unfinished: bool) -> Cell:
    """Return a cell's numbers; with `unfinished`, learning curves include runs that are not
    done.
    """
    runs: list[dict[str, Any]] = cell.done[RUN_COLUMNS].to_dict("records")  # type: ignore[assignment]
    seeds = [_summarise_run(run, evaluations) for run in runs]
    success = [seed.success for seed in seeds if seed.success is not None]
    n_episodes = min((seed.n_episodes or 0 for seed in seeds), default=0) or None
    means = {
        name: _average(
            [finite_or_none(run[metric.run_column]) for run in runs], metric.is_rate, n_episodes
        )
        for name, metric in REPORTED.items()
    }
    return Cell(
        id=f"c{number}",
        label=cell.label,
        experiment=cell.experiment,
        name=cell.name,
        settings=cell.settings,
        counts=_count_stages(cell.runs["status"]),
        total_timesteps=_to_int(cell.config.get("total_timesteps")),
        cpu_s=_average([seed.cpu_s for seed in seeds]),
        area=_average([seed.area for seed in seeds], is_rate=True),
        lowest=min(success, default=None),
        iqm=interquartile_mean(success) if success else None,
        reaching_95=share_reaching(success, RELIABLE) if success else Proportion(0, 0, None, None),
        seeds=seeds,
        curve=_average_curves(cell.runs if unfinished else cell.done, evaluations),
        task_data=_summarise_task(
            cell, [evaluations.final[s.run_id] for s in seeds if s.run_id in evaluations.final]
        ),
        note=coverage_note(success) if success else None,
        **_measure_time_to_90(seeds),
        **_metric_fields(means),
    )


def _metric_fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a seed or a cell that hold these metrics; those of other tasks are left
    out.
    """
    own = {name: value for name, value in values.items() if name not in FURTHER}
    return {
        **own,
        "further": {
            name: values[name] for name in FURTHER if values[name] not in (None, Interval(None))
        },
    }


def _summarise_task(cell: CellRuns, final: Sequence[pd.DataFrame]) -> dict[str, Any]:
    return {
        key: value
        for task in task_reports([cell.task])
        for key, value in task.rates(final, cell.config).items()
    }


def _summarise_run(run: dict[str, Any], evaluations: RunEvaluations) -> RunSummary:
    metrics = {name: finite_or_none(run[metric.run_column]) for name, metric in REPORTED.items()}
    episodes, curve = evaluations.final.get(run["run_id"]), evaluations.curves.get(run["run_id"])
    n_episodes = len(episodes) if episodes is not None else _to_int(run["n_scenes"])
    success, low, high = metrics["success"], None, None
    if success is not None and n_episodes:
        low, high = wilson_interval(round(success * n_episodes), n_episodes)
    return RunSummary(
        seed=int(run["seed"]),
        run_id=run["run_id"],
        run_dir=run["run_dir"] if isinstance(run["run_dir"], str) else None,
        n_episodes=n_episodes,
        low=low,
        high=high,
        cpu_s=finite_or_none(run["cpu_s"]),
        **(_measure_curve(curve) if curve is not None else {}),
        **_metric_fields(metrics),
    )


def _measure_curve(curve: pd.DataFrame) -> dict[str, Any]:
    """Return the fields of a seed that are computed from its learning curve."""
    step, success = curve["step"].to_numpy(), curve["success_rate"].to_numpy()
    area = normalised_area(step, success) if np.count_nonzero(~np.isnan(success)) > 1 else None
    if len(step) < HOLD:
        return {"area": area}
    time, reached = steps_to(step, success, SUCCESS_THRESHOLD, HOLD)
    return {
        "steps_to_90": time,
        "reached_90": reached,
        "cpu_s_to_90": finite_or_none(curve["cpu_s"].iloc[np.searchsorted(step, time)])
        if reached
        else None,
        "area": area,
    }


def _select_curves(runs: pd.DataFrame, evaluations: RunEvaluations) -> dict[int, pd.DataFrame]:
    """Return the evaluations of each seed that has some."""
    pairs = zip(runs["run_id"], runs["seed"], strict=True)
    return {int(seed): evaluations.curves[run] for run, seed in pairs if run in evaluations.curves}


def _average_curves(runs: pd.DataFrame, evaluations: RunEvaluations) -> Curve | None:
    curves = _select_curves(runs, evaluations)
    if not curves:
        return None
    steps = np.unique(np.concatenate([curve["step"] for curve in curves.values()]))
    success, failure = np.full((2, len(curves), len(steps)), np.nan)
    for row, curve in enumerate(curves.values()):
        at = np.searchsorted(steps, curve["step"])
        success[row, at], failure[row, at] = curve["success_rate"], curve["failure_rate"]
    rates = pd.DataFrame(success)  # unlike NumPy's, its statistics leave out NaN without a warning
    return Curve(
        step=steps.tolist(),
        mean=list(map(finite_or_none, rates.mean())),
        low=list(map(finite_or_none, rates.min())),
        high=list(map(finite_or_none, rates.max())),
        n=rates.count().tolist(),
        failure=list(map(finite_or_none, pd.DataFrame(failure).mean())),
        seeds=[
            (seed, curve["step"].tolist(), [finite_or_none(rate) for rate in curve["success_rate"]])
            for seed, curve in curves.items()
        ],
    )


def _measure_time_to_90(seeds: Sequence[RunSummary]) -> dict[str, Any]:
    """Return the fields of a cell about the time to 90 %."""
    timed = [seed for seed in seeds if seed.steps_to_90 is not None]
    if not timed:
        return {}
    steps = [seed.steps_to_90 or 0.0 for seed in timed]
    cpu_s = sorted(math.inf if seed.cpu_s_to_90 is None else seed.cpu_s_to_90 for seed in timed)
    return {
        "survival": kaplan_meier(steps, [seed.reached_90 for seed in timed]),
        "median_cpu_s": finite_or_none(cpu_s[(len(cpu_s) - 1) // 2]),
    }


def _average(
    values: Sequence[float | None], is_rate: bool = False, n_episodes: int | None = None
) -> Interval:
    known = [value for value in values if value is not None]
    if not known:
        return Interval(None)
    if not is_rate or (
        n_episodes is None and len(set(known)) == 1
    ):  # an interval of areas that are all 1 has no width
        return Interval(sum(known) / len(known), n=len(known))
    return mean_interval(known, n_episodes)


def _count_stages(status: pd.Series) -> dict[str, int]:
    stages = [STAGES.get(stage, stage) for stage in status]
    return {stage: stages.count(stage) for stage in ("done", "running", "failed", "pending")}


def _to_int(value: Any) -> int | None:
    return None if (number := finite_or_none(value)) is None else int(number)
