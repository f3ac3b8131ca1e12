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


def outcomes(success: float, crash: float, n: int) -> list[str]:
    """Return the outcomes of n episodes with these shares; the others are timeouts."""
    n_success = round(success * n)
    n_crash = min(round(crash * n), n - n_success)
    n_timeout = n - n_success - n_crash
    return ["success"] * n_success + ["crash"] * n_crash + ["timeout"] * n_timeout


def results(cells, seeds=range(3), look=lambda label, seed: Run(), experiment="one") -> Results:
    """Return the results of an experiment; cells: name -> dotted keys that differ from CONFIG, None
    for no such key.
    """
    runs = []
    curves = []
    episodes = []
    for label, changes in cells.items():
        changed = {**CONFIG, **changes}
        config = {key: value for key, value in changed.items() if value is not None}
        first_scene = config["evaluation.first_scene"]
        for seed in seeds:
            run = look(label, seed)
            run_id = f"{experiment}-{label}-{seed}"
            runs.append(_row(len(runs), run, run_id, experiment, label, seed, config))
            steps = np.linspace(0, config["total_timesteps"], len(run.curve) + 1).astype(int)[1:]
            for step, rate in zip(steps, run.curve, strict=True):
                curves.append((run_id, step, rate, 1 - rate, run.cpu_s * step / steps[-1]))
            if run.status == "done":
                ends = outcomes(run.success, run.crash, config["evaluation.final_n_scenes"])
                for scene, end in enumerate(ends, first_scene):
                    episodes.append((run_id, "final", scene, end))
    episodes = pd.DataFrame(episodes, columns=["run_id", "phase", "scene", "outcome"])
    return Results(
        pd.DataFrame(runs),
        pd.DataFrame(curves, columns=["run_id", "step", "success_rate", "crash_rate", "cpu_s"]),
        episodes.astype({"outcome": pd.CategoricalDtype(list(OUTCOMES))}),
        "sqlite:///outputs/mlflow.db",
    )


def together(*parts: Results) -> Results:
    """Return the results of several experiments."""
    frames = []
    for name in ("runs", "curves", "episodes"):
        frames.append(pd.concat([getattr(part, name) for part in parts], ignore_index=True))
    return Results(*frames, uri="")


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
