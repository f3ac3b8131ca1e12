"""Work on a search: claim trials one after the other, train each on its seeds, prune, and record the objective.

An objective is a number in 0 ... 1 for each run of a trial, the higher the better.
"""

import errno
import os
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING, Literal

from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, OutputDirectoryError, StoreError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import read_metrics
from parking_exp.runs.run_state import read_state
from parking_exp.statistics import normalised_area
from parking_exp.sweeps.hydra_launcher import train_run
from parking_exp.sweeps.local import Train
from parking_exp.sweeps.supervisor import Stop, WorkerResult, stop_of_job, supervise
from parking_exp.tuning.search import Search
from parking_exp.tuning.search_config import Objective
from parking_exp.tuning.study import CHANGES, CPU_S, REASON, RUNS, SEED_VALUES, STEPS, claim

if TYPE_CHECKING:
    from omegaconf import DictConfig
    from optuna import Study, Trial

ATTEMPTS = 3  # at a run whose process is killed
POLL_S = 0.5
FINAL_METRICS = {"final_success": "final/success_rate", "final_parked": "final/parked_rate"}
Outcome = Literal["done", "pruned", "failed", "stopped"]


def do_job(config: "DictConfig") -> WorkerResult | None:
    """Train the run of a directory, or work on the search of a folder; Hydra's task function.

    Raises:
        KeyboardInterrupt: a signal to the job stopped it; what was under way is saved.
    """
    if not config.get("study"):
        return train_run(config)
    with stop_of_job() as is_stopped:

        def train(path: Path, stop: Stop) -> WorkerResult | None:
            return None if is_stopped() else supervise(path, lambda: is_stopped() or stop())

        work(Path(config.study), config.n_trials, train, config.get("storage"))
    return None


def work(folder: Path, n_trials: int, train: Train, storage: str | None = None) -> None:
    """Train the first `n_trials` trials until none is left, or until `train` returns that it was stopped.

    The study is the journal in the folder, or is in `storage`.
    """
    from optuna.exceptions import OptunaError
    from optuna.pruners import MedianPruner, NopPruner
    from sqlalchemy.exc import SQLAlchemyError

    search = Search.load(folder, storage)
    opened, settings = search.open(), search.request.search
    opened.study.pruner = MedianPruner(n_startup_trials=5) if settings.pruner else NopPruner()
    try:
        while (claimed := claim(opened, settings, n_trials)) is not None:
            trial, lock = claimed
            try:
                if _TrialTraining(search, opened.study, trial, train).run() == "stopped":
                    return
            finally:
                lock.release()
    except (OptunaError, SQLAlchemyError) as error:
        line = str(error).splitlines()[0]
        raise StoreError(f"the study {folder.name} can't be used: {line}; rerun the same command to resume") from error


class _TrialTraining:
    """A claimed trial, trained on one seed after the other and pruned on the way."""

    def __init__(self, search: Search, study: "Study", trial: "Trial", train: Train) -> None:
        self.search, self.settings = search, search.request.search
        self.study, self.trial, self.train = study, trial, train
        self.reported = set(study.get_trials(deepcopy=False)[trial.number].intermediate_values)
        self.areas: list[float] = []  # under the curves of its finished runs

    def run(self) -> Outcome:
        """Train the runs that are not done, and record the result in the study."""
        try:
            config = self.search.config(self.trial.user_attrs[CHANGES])
        except ConfigError as error:  # values that can't be combined
            return self._end("failed", [], reason=str(error).replace("\n", "; "))
        runs = [config.model_copy(update={"seed": seed}) for seed in self.settings.tuning_seeds]
        values: list[float] = []
        for number, run in enumerate(runs, 1):
            started, directory = runs[:number], RunDirectory(run.run_dir)
            self.trial.set_user_attr(RUNS, [str(each.run_dir.relative_to(run.output_path)) for each in started])
            was_done = directory.status == "done"
            outcome = self._train_run(run)
            if outcome == "stopped":
                return outcome
            if outcome == "failed":
                reason = read_state(run.run_dir).reason or "it failed"
                return self._end("failed", started, reason=f"seed {run.seed}: {reason}")
            # A run of an earlier process was judged by that process.
            if outcome == "pruned" or (self._is_worse(run) and number < len(runs) and not was_done):
                return self._end("pruned", started)
            self.areas.append(objective_value(directory, "success_auc"))
            values.append(objective_value(directory, self.settings.objective))
        self.trial.set_user_attr(SEED_VALUES, values)
        return self._end("done", runs, value=mean(values))

    def _end(
        self, outcome: Outcome, runs: list[RunConfig], *, reason: str | None = None, value: float | None = None
    ) -> Outcome:
        """Record the resources that the trial used and how it ended."""
        from optuna.trial import TrialState

        self.trial.set_user_attr(CPU_S, sum(_cpu_s(run) for run in runs))
        self.trial.set_user_attr(STEPS, sum(read_state(run.run_dir).step for run in runs))
        if reason is not None:
            self.trial.set_user_attr(REASON, reason)
        states = {"done": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}
        self.study.tell(self.trial, value, states[outcome])
        return outcome

    def _train_run(self, config: RunConfig) -> Outcome:
        """Train a run until it is over, or until its trial is to be pruned."""
        directory, last_check, is_pruned = RunDirectory(config.run_dir), time.monotonic(), False

        def stop() -> bool:
            nonlocal last_check, is_pruned
            if not is_pruned and time.monotonic() - last_check > POLL_S:
                last_check, is_pruned = time.monotonic(), self._is_worse(config)
            return is_pruned

        attempts = 0
        while True:
            state = read_state(directory.path)
            if state.stage == "done":
                return "done"
            if state.stage == "pruned" and self.trial.number > 0:  # trial 0 finishes runs that another trial shares
                return "pruned"
            if state.stage == "failed" or attempts == ATTEMPTS:
                disk_full = os.strerror(errno.ENOSPC) in (state.reason or "")
                if disk_full and attempts:  # the trial stays open
                    raise OutputDirectoryError(f"trial {self.trial.number}: {state.reason}; {state.run_dir}")
                if attempts == ATTEMPTS or not (state.killed or disk_full):
                    return "failed"
            entries = {"search": self.search.folder.name, "trial": self.trial.number}
            directory.freeze(config, f"trial {self.trial.number}", state.started, entries=entries)
            result = self.train(directory.path, stop)
            if result == "stopped" and is_pruned:
                directory.update(status="pruned")
            elif result in (None, "stopped"):
                return "stopped"
            elif result == "elsewhere":  # another trial has the same config
                time.sleep(POLL_S)
            else:
                attempts += 1

    def _is_worse(self, config: RunConfig) -> bool:
        """Report the evaluations of the current run so far, and return whether to prune the trial."""
        if self.settings.pruner is None:
            return False
        (steps, success), n_finished = success_curve(RunDirectory(config.run_dir)), len(self.areas)
        every = config.evaluation.every_n_steps
        n_evaluations = config.total_timesteps // every + 2 if every else 1  # of a run at most, the final one included
        for number, value in enumerate(values_so_far(self.areas, steps, success, config.total_timesteps)):
            step = n_finished * n_evaluations + number  # evaluations are counted through all seeds
            if step not in self.reported:
                self.trial.report(value, step)
                self.reported.add(step)
        if not steps or (not n_finished and updates_at(config, steps[-1]) < self.settings.grace_updates):
            return False
        return self.trial.number > 0 and self.trial.should_prune()


def _cpu_s(config: RunConfig) -> float:
    """Return the CPU seconds of a run up to its last evaluation."""
    times = [record["metrics"].get("time/cpu_s") for record in read_metrics(config.run_dir / "metrics.jsonl")]
    return float(next((cpu_s for cpu_s in reversed(times) if cpu_s is not None), 0.0))


def success_curve(directory: RunDirectory) -> tuple[list[int], list[float]]:
    """Return the env steps of a run's evaluations so far, and their success rates; the last may be the final one."""
    records = read_metrics(directory.path / "metrics.jsonl")
    name = "eval/success_rate"
    rates = {record["step"]: record["metrics"][name] for record in records if name in record["metrics"]}
    result = directory.result()
    if result is not None and "final/success_rate" in result.metrics:
        rates[result.steps] = result.metrics["final/success_rate"]
    steps = sorted(rates)
    return steps, [rates[step] for step in steps]


def objective_value(directory: RunDirectory, objective: Objective) -> float:
    """Return an objective of a finished run."""
    result = directory.result()
    if result is not None and objective in FINAL_METRICS:
        return result.metrics[FINAL_METRICS[objective]]
    return normalised_area(*success_curve(directory))


def values_so_far(
    finished: Sequence[float], steps: Sequence[int], success: Sequence[float], total_timesteps: int
) -> list[float]:
    """Return the mean area of a trial's runs at each evaluation of its current run, which pruning compares.

    The current run's area is weighted by the fraction of the run that is over; `finished` are the areas of the others.
    """
    values = []
    for position, step in enumerate(steps, 1):
        weight = min(1.0, step / total_timesteps)
        area = normalised_area(steps[:position], success[:position])
        values.append((sum(finished) + weight * area) / (len(finished) + weight) if finished or weight else area)
    return values


def updates_at(config: RunConfig, step: int) -> float:
    """Return how many gradient updates a run has made at an env step."""
    steps = max(0.0, step - config.algorithm.arguments.get("learning_starts", 0))
    train_freq, gradient_steps = config.update_rounds()
    if isinstance(train_freq, tuple) or gradient_steps < 0:  # by episodes, with as many updates as steps
        return steps
    return steps * gradient_steps / (train_freq * config.n_envs)
