"""Summary of a cell over its seeds: means, learning curve, times to 90 %, scene map."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.evaluation.metrics import METRICS, Metric
from parking_exp.reports.curves import EvaluationCurve, RunEvaluations
from parking_exp.reports.formats import finite
from parking_exp.reports.lot_map import slot_rates
from parking_exp.reports.report_data import Cell, Curve, Interval, Seed, Share, Survival
from parking_exp.reports.selection import Group
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
STAGES = {"interrupted": "pending"}  # as MLflow's index has it, and as a run directory
REPORTED: dict[str, Metric] = {
    metric.name if metric.is_rate else metric.run_column: metric for metric in METRICS if metric.in_reports
}
"""Metrics of reports by their names in `Cell` and `Seed`."""
FURTHER = [name for name in REPORTED if name not in {field.name for field in fields(Seed)}]
"""Those without a field of their own."""
RUN_COLUMNS = ["run_id", "run_dir", "seed", "n_scenes", "cpu_s", *(metric.run_column for metric in REPORTED.values())]


def summarise(
    group: Group,
    number: int,
    evaluations: RunEvaluations,
    horizons: tuple[float | None, float | None],
    unfinished: bool,
) -> Cell:
    """Return a cell's numbers.

    Args:
        group: its runs.
        number: of the cell in the report.
        evaluations: curves and final episodes of the runs.
        horizons: up to which env step, and CPU-second, times to 90 % are averaged; see `shared_horizons`.
        unfinished: whether learning curves show runs that are not done, too.
    """
    runs: list[dict[str, Any]] = group.done[RUN_COLUMNS].to_dict("records")  # type: ignore[assignment]
    seeds = [_seed(run, evaluations) for run in runs]
    means = _means(runs)
    own: dict[str, Any] = {name: mean for name, mean in means.items() if name not in FURTHER}
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
        **own,
        cpu_s=_mean([seed.cpu_s for seed in seeds], bounds=None),
        area=_mean([seed.area for seed in seeds]),
        reaching_90=_reaching([seed.success for seed in seeds]),
        seeds=seeds,
        curve=_curve(group.runs if unfinished else group.done, evaluations),
        survival=_survival("env steps", times, horizons[0]),
        survival_cpu=_survival("CPU-seconds", cpu_times, horizons[1]),
        slots=slot_rates([evaluations.final[seed.run_id] for seed in seeds if seed.run_id in evaluations.final]),
        note=_note([seed.success for seed in seeds]),
        further={name: mean for name, mean in means.items() if name in FURTHER},
    )


def shared_horizons(groups: Sequence[Group], evaluations: RunEvaluations) -> tuple[float | None, float | None]:
    """Return the env step and the CPU-second up to which every finished run was watched."""
    ids = [run for group in groups for run in group.done["run_id"].tolist()]
    curves = [evaluations.curves[run] for run in ids if run in evaluations.curves]
    ends = [curve.watched(HOLD) for curve in curves]
    cpu_s = [seconds for _, seconds in ends if np.isfinite(seconds)]
    return min((step for step, _ in ends), default=None), min(cpu_s, default=None)


def real_share(group: Group, evaluations: RunEvaluations) -> float | None:
    """Return the mean share of real transitions in a cell's batches, as the buffer measured it."""
    curves = [evaluations.curves[run].real_share for run in group.done["run_id"].tolist() if run in evaluations.curves]
    last = [float(known[-1]) for curve in curves if len(known := curve[~np.isnan(curve)])]
    return float(np.mean(last)) if last else None


def _seed(run: dict[str, Any], evaluations: RunEvaluations) -> Seed:
    values = _values(run)
    episodes, curve = evaluations.final.get(run["run_id"]), evaluations.curves.get(run["run_id"])
    n_scenes = len(episodes.scene) if episodes is not None else _whole(run["n_scenes"])
    low = high = None
    if values["success"] is not None and n_scenes:
        low, high = wilson_interval(round(values["success"] * n_scenes), n_scenes)
    steps, reached, cpu_s, area = _evaluation_curve(curve) if curve is not None else (None, False, None, None)
    return Seed(
        seed=int(run["seed"]),
        run_id=run["run_id"],
        run_dir=run["run_dir"] if isinstance(run["run_dir"], str) else None,
        **{name: value for name, value in values.items() if name not in FURTHER},
        n_scenes=n_scenes,
        low=low,
        high=high,
        cpu_s=finite(run["cpu_s"]),
        steps_to_90=steps,
        reached_90=reached,
        cpu_s_to_90=cpu_s,
        area=area,
        further={name: value for name, value in values.items() if name in FURTHER},
    )


def _values(run: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the metrics of a run by their names in reports."""
    return {name: finite(run[metric.run_column]) for name, metric in REPORTED.items()}


def _means(runs: Sequence[Mapping[str, Any]]) -> dict[str, Interval]:
    """Return the means of metrics over runs, rates with intervals inside 0 ... 1."""
    found = [_values(run) for run in runs]
    bounds = {name: (0.0, 1.0) if metric.is_rate else None for name, metric in REPORTED.items()}
    return {name: _mean([one[name] for one in found], bounds[name]) for name in REPORTED}


def _evaluation_curve(curve: EvaluationCurve) -> tuple[float, bool, float | None, float | None]:
    """Return time to 90 % in env steps, whether it was reached, the same in CPU-seconds, and the area."""
    time, reached = steps_to(curve.step, curve.success, GOOD, HOLD)
    cpu_s = curve.cpu_s[np.searchsorted(curve.step, time)] if reached else curve.watched(HOLD)[1]
    area = normalised_area(curve.step, curve.success) if np.count_nonzero(~np.isnan(curve.success)) > 1 else None
    return time, reached, finite(cpu_s), area


def _curve(runs: pd.DataFrame, evaluations: RunEvaluations) -> Curve | None:
    """Return the learning curve over all runs that have one."""
    pairs = zip(runs["run_id"].tolist(), runs["seed"].tolist(), strict=True)
    known = {int(seed): evaluations.curves[run] for run, seed in pairs if run in evaluations.curves}
    if not known:
        return None
    steps = np.unique(np.concatenate([curve.step for curve in known.values()]))
    success, crash = np.full((2, len(known), len(steps)), np.nan)
    for row, curve in enumerate(known.values()):
        at = np.searchsorted(steps, curve.step)
        success[row, at], crash[row, at] = curve.success, curve.crash
    means = [_interval(point) for point in mean_band(success)]
    crashed = [column[~np.isnan(column)] for column in crash.T]
    return Curve(
        step=steps.tolist(),
        mean=[mean.value for mean in means],
        low=[mean.low for mean in means],
        high=[mean.high for mean in means],
        n=[mean.n for mean in means],
        crash=[float(column.mean()) if len(column) else None for column in crashed],
        seeds=[(seed, curve.step.tolist(), [finite(rate) for rate in curve.success]) for seed, curve in known.items()],
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
        mean = Interval(found.mean, finite(found.low), finite(found.high), found.n, found.method)
    return Survival(
        unit=unit,
        time=[*start, *estimate.times],
        reached=[*start, *estimate.reached],
        low=[*start, *map(finite, estimate.low)],
        high=[*start, *map(finite, estimate.high)],
        censored=sorted(time for time, reached in known if not reached),
        n=len(known),
        k=int(observed.sum()),
        median=estimate.median,
        restricted_mean=mean,
        horizon=horizon,
    )


def _mean(values: Sequence[float | None], bounds: tuple[float, float] | None = (0.0, 1.0)) -> Interval:
    known = [value for value in values if value is not None]
    return _interval(mean_interval(known, bounds=bounds)) if known else Interval(None)


def _interval(estimate: Estimate) -> Interval:
    return Interval(finite(estimate.mean), finite(estimate.low), finite(estimate.high), estimate.n, estimate.method)


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
    pruned = ["pruned"] if "pruned" in stages else []  # by a search
    return {stage: stages.count(stage) for stage in ("done", "running", "failed", "pending", *pruned)}


def _whole(value: Any) -> int | None:
    return None if (number := finite(value)) is None else int(number)
