"""Work on a search: claim trials one after the other, train each on its seeds, prune, and tell the study."""

import errno
import os
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING, Any, Literal

from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, OutputDirectoryError, ParkingError, StoreError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import read_metrics
from parking_exp.runs.state import read_state
from parking_exp.sweeps.local import Train
from parking_exp.sweeps.supervisor import Stop, WorkerResult, stop_of_job, supervise
from parking_exp.terminal import say
from parking_exp.tuning.claims import Claim, claim
from parking_exp.tuning.objectives import RunCurve, evaluations, partial_value, read_curve, run_value, updates_at
from parking_exp.tuning.search import Search
from parking_exp.tuning.search_config import SearchConfig
from parking_exp.tuning.study import CPU_S, REASON, RUNS, SEED_VALUES, STEPS

if TYPE_CHECKING:
    from optuna import Study
    from optuna.pruners import BasePruner

ATTEMPTS = 3  # at a run whose process is killed
LOOK_S, ELSEWHERE_POLL_S = 0.5, 1.0
Outcome = Literal["done", "pruned", "failed", "stopped"]


def work_job(folder: str, n_trials: int, storage: str | None = None) -> None:
    """Work on the search of a folder as a job of another launcher; see `work`.

    Raises:
        KeyboardInterrupt: a signal to the job stopped it; what was under way is saved.
    """
    with stop_of_job() as asked:

        def train(path: Path, stop: Stop | None) -> WorkerResult | None:
            return None if asked() else supervise(path, stop=lambda: asked() or (stop is not None and stop()))

        work(Path(folder), n_trials, train, storage)


def work(folder: Path, n_trials: int, train: Train, storage: str | None = None) -> None:
    """Train the first `n_trials` trials until none is left, or `train` says that all is stopped.

    The study is the journal in the folder, or lies in `storage`.

    Raises:
        StoreError: the study can't be read or written.
    """
    search = Search.load(folder, storage)
    opened = search.open()
    study = opened.study
    settings = search.request.search
    study.pruner = make_pruner(settings, evaluations(search.base))
    try:
        while (claimed := claim(opened, settings, n_trials)) is not None:
            try:
                if _Trial(search, study, claimed, train).run() == "stopped":
                    return
            finally:
                claimed.release()
    except (ParkingError, OSError):
        raise
    except Exception as error:  # a database may fail in any way
        raise StoreError(
            f"the study {study.study_name} can't be written ({type(error).__name__}: {str(error).splitlines()[0]}); "
            "runs are kept; rerun the same command to resume"
        ) from error


def make_pruner(search: SearchConfig, evaluations_a_run: int) -> "BasePruner":
    """Return the pruner of a search; its steps are evaluations, counted through all seeds."""
    from optuna import pruners

    match search.pruner:
        case "median":
            return pruners.MedianPruner(n_startup_trials=5)
        case "hyperband":
            # The first rung is after take-off, and before a whole run has been spent on a trial.
            first_rung = max(1, evaluations_a_run // 3)
            whole = evaluations_a_run * len(search.tuning_seeds)
            return pruners.HyperbandPruner(min_resource=first_rung, max_resource=whole)
    return pruners.NopPruner()


class _Trial:
    """A claimed trial, trained on one seed after the other and pruned on the way."""

    def __init__(self, search: Search, study: "Study", claimed: Claim, train: Train) -> None:
        self.search, self.settings = search, search.request.search
        self.study, self.claimed, self.train = study, claimed, train
        self.areas: list[float] = []  # under the curves of its finished runs
        self.values: list[list[float]] = []  # of the objectives, of its finished runs
        self._reported = set(study.get_trials(deepcopy=False)[claimed.number].intermediate_values)
        self._problem: str | None = None  # why its progress can't be reported

    def run(self) -> Outcome:
        """Train the runs that are not done, and tell the study the result."""
        try:
            config = self.search.config(self.claimed.changes)
        except ConfigError as error:  # values that do not go together
            return self._over("failed", reason=str(error).replace("\n", "; "))
        seeds = self.settings.tuning_seeds
        runs = [config.model_copy(update={"seed": seed}) for seed in seeds]
        before = sum(read_state(run.run_dir).started is not None for run in runs)  # begun by an earlier process
        for number, run in enumerate(runs):
            begun = runs[: max(number + 1, before)]
            self._record(RUNS, [str(one.run_dir.relative_to(one.output_path)) for one in begun])
            outcome = self._run(run, number)
            if outcome == "stopped":
                return outcome
            if outcome == "failed":
                return self._over(outcome, begun, f"seed {run.seed}: {read_state(run.run_dir).reason or 'it failed'}")
            # Only after its newest run: earlier ones were judged before the next one began.
            if outcome == "pruned" or (self._judge_finished(run, number) and number + 1 == len(begun) < len(runs)):
                return self._over("pruned", begun)
        self._record(SEED_VALUES, self.values)
        return self._over("done", runs)

    def _record(self, name: str, value: Any) -> None:
        self.claimed.trial.set_user_attr(name, value)

    def _over(self, outcome: Outcome, runs: Sequence[RunConfig] = (), reason: str | None = None) -> Outcome:
        """Record what the trial took and why it failed, and tell the study that it is over."""
        from optuna.trial import TrialState

        states = [read_state(run.run_dir) for run in runs]
        self._record(CPU_S, sum(_cpu_s(state.run_dir) for state in states))
        self._record(STEPS, sum(state.step for state in states))
        if reason is not None:
            self._record(REASON, reason)
        if outcome == "done":
            self.study.tell(self.claimed.trial, [mean(column) for column in zip(*self.values, strict=True)])
        else:
            self.study.tell(self.claimed.trial, state=TrialState.PRUNED if outcome == "pruned" else TrialState.FAIL)
        return outcome

    def _run(self, config: RunConfig, number: int) -> Outcome:
        """Train the run of the `number`-th seed, unless that is over."""
        directory, looked, prune = RunDirectory(config.run_dir), time.monotonic(), False

        def stop() -> bool:
            nonlocal looked, prune
            if not prune and time.monotonic() - looked > LOOK_S:
                looked = time.monotonic()
                prune = self._judge_running(directory, config, number)
            return prune

        attempts = 0
        while True:
            state = read_state(directory.path)
            if state.stage == "done":
                return "done"
            if state.stage == "pruned" and self.claimed.number > 0:  # trial 0 finishes runs that another trial shares
                return "pruned"
            if state.stage == "failed":
                on_full_disk = os.strerror(errno.ENOSPC) in (state.reason or "")
                if on_full_disk and attempts:  # no fault of the trial's: it stays open
                    raise OutputDirectoryError(f"trial {self.claimed.number}: {state.reason}; {state.run_dir}")
                if attempts == ATTEMPTS or not (state.killed or on_full_disk):
                    return "failed"
            attempts += 1
            entries = {"search": self.search.folder.name, "trial": self.claimed.number}
            directory.freeze(config, f"trial {self.claimed.number}", state.started, entries=entries)
            result = self.train(directory.path, stop)
            if result == "elsewhere":  # another trial has the same config
                time.sleep(ELSEWHERE_POLL_S)
                attempts -= 1
            elif result == "stopped" and prune:
                directory.update(status="pruned")
            elif result in (None, "stopped"):
                return "stopped"

    def _judge_running(self, directory: RunDirectory, config: RunConfig, number: int) -> bool:
        """Report the evaluations so far, and return whether to prune; a failing storage prunes nothing."""
        try:
            return self.settings.pruner is not None and self._judge(config, number, read_curve(directory))
        except Exception as error:  # a database may fail in any way
            if self._problem is None:
                say(f"trial {self.claimed.number}: can't report progress ({error}); training continues", stderr=True)
            self._problem = str(error)
            return False

    def _judge_finished(self, config: RunConfig, number: int) -> bool:
        """Add a finished run to the trial, and return whether to prune the trial after it."""
        curve = read_curve(RunDirectory(config.run_dir))
        pruned = self.settings.pruner is not None and self._judge(config, number, curve)
        self.areas.append(curve.area)
        self.values.append([run_value(name, curve) for name in self.settings.objective])
        return pruned

    def _judge(self, config: RunConfig, number: int, curve: RunCurve) -> bool:
        """Report the evaluations of a run, and return whether to prune its trial."""
        first = number * evaluations(config)
        for position in range(len(curve.steps)):
            so_far = RunCurve(curve.steps[: position + 1], curve.success[: position + 1], {})
            share = min(1.0, curve.steps[position] / config.total_timesteps)
            value = partial_value(self.areas, so_far, share)
            self._report(first + position, value)
        if not curve.steps or (number == 0 and updates_at(config, curve.steps[-1]) < self.settings.grace_updates):
            return False
        return self.claimed.number > 0 and self.claimed.trial.should_prune()

    def _report(self, step: int, value: float) -> None:
        if step not in self._reported:
            self.claimed.trial.report(value, step)
            self._reported.add(step)


def _cpu_s(run_dir: str) -> float:
    """Return the CPU seconds of a run up to its last evaluation."""
    recorded = [record["metrics"].get("time/cpu_s") for record in read_metrics(Path(run_dir) / "metrics.jsonl")]
    return float(next((cpu_s for cpu_s in reversed(recorded) if cpu_s is not None), 0.0))
