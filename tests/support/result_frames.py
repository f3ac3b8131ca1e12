"""Results of made-up runs as frames, as `parking_exp.results.load` gives them: what a report is a
function of.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from parking_exp.results.frames import Results
from parking_exp.tasks.registry import METRICS, OUTCOMES

CONFIG = {
    "env.name": "parking",
    "algorithm.name": "sac",
    "buffer.name": "her_future",
    "buffer.n_sampled_goal": 4,
    "total_timesteps": 400,
    "evaluation.final_n_scenes": 5,
    "evaluation.first_scene": 0,
    "evaluation.n_scenes": 3,
    "evaluation.every_n_steps": 100,
}
ALGORITHMS = {"sac": {}, "td3": {"algorithm.name": "td3"}}
REPLAY = {"buffer.name": "replay", "buffer.n_sampled_goal": None}


@dataclass(frozen=True)
class Run:
    """A made-up run.

    Attributes:
        success, crash, parked: shares of its final episodes; the others are timeouts.
        curve: success of each evaluation, evenly spaced up to `total_timesteps`.
        columns: other columns of `runs`.
    """

    success: float = 0.8
    crash: float = 0.0
    parked: float = 0.2
    curve: Sequence[float] = (0.2, 0.4, 0.6, 0.8)
    status: str = "done"
    error: str | None = None
    cpu_s: float = 300.0
    columns: Mapping[str, object] = field(default_factory=dict)


def results(cells, seeds=range(3), look=lambda label, seed: Run(), experiment="one") -> Results:
    """Return the results of an experiment; cells: name -> dotted keys that differ from CONFIG, None
    for no such key.
    """
    runs, curves, episodes = [], [], []
    for label, changes in cells.items():
        for seed in seeds:
            run, run_id = look(label, seed), f"{experiment}-{label}-{seed}"
            config = {
                key: value for key, value in {**CONFIG, **changes}.items() if value is not None
            }
            runs.append(_row(len(runs), run, run_id, experiment, label, seed, config))
            steps = np.linspace(0, config["total_timesteps"], len(run.curve) + 1).astype(int)[1:]
            curves += [
                (run_id, step, rate, 1 - rate, run.cpu_s * step / steps[-1])
                for step, rate in zip(steps, run.curve, strict=True)
            ]
            if run.status == "done":
                n, first = config["evaluation.final_n_scenes"], config["evaluation.first_scene"]
                good, bad = round(run.success * n), round((run.success + run.crash) * n)
                ends = ["success"] * good + ["crash"] * (bad - good) + ["timeout"] * (n - bad)
                episodes += [
                    (run_id, "final", first + scene, end) for scene, end in enumerate(ends)
                ]
    outcomes = pd.CategoricalDtype(list(OUTCOMES))
    names = ["run_id", "step", "success_rate", "crash_rate", "cpu_s"]
    return Results(
        pd.DataFrame(runs),
        pd.DataFrame(curves, columns=names),
        pd.DataFrame(episodes, columns=["run_id", "phase", "scene", "outcome"]).astype(
            {"outcome": outcomes}
        ),
        "sqlite:///outputs/mlflow.db",
    )


def together(*parts: Results) -> Results:
    """Return the results of several experiments."""
    names = ("runs", "curves", "episodes")
    return Results(
        *(pd.concat([getattr(part, name) for part in parts], ignore_index=True) for name in names),
        "",
    )


def _row(number, run, run_id, experiment, label, seed, config):
    rates = {"success": run.success, "crash": run.crash, "parked": run.parked}
    rates["timeout"] = 1 - run.success - run.crash
    others = {metric.run_column: np.nan if metric.is_outcome else 40.0 for metric in METRICS}
    metrics = others | {f"{name}_rate": value for name, value in rates.items()}
    if run.status != "done":
        metrics = dict.fromkeys(metrics, np.nan)
    return {
        "run_id": run_id,
        "experiment": experiment,
        "cell": f"{config['env.name']}-{label}",
        "seed": seed,
        "status": run.status,
        "error": run.error,
        "n_scenes": config["evaluation.final_n_scenes"],
        **metrics,
        "cpu_s": run.cpu_s,
        "started": pd.Timestamp("2026-11-01", tz="UTC") + pd.Timedelta(seconds=number),
        "ended": pd.Timestamp("2026-11-02", tz="UTC"),
        "run_dir": f"/outputs/{experiment}/{label}/seed={seed}",
        "git_commit": "a" * 40,
        "git_dirty": False,
        "cpu": "a CPU",
        "version.highway-env": "1.12.1",
        **{f"config.{key}": value for key, value in config.items()},
        **run.columns,
    }
