"""Live view of a search: a table of its trials on a terminal, a line for each trial that is over elsewhere."""

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType

from parking_exp.errors import ParkingError
from parking_exp.runs.run_state import read_state
from parking_exp.runs.state_tables import name, under_way
from parking_exp.sweeps.monitor import LiveView
from parking_exp.tuning.search import Search
from parking_exp.tuning.tables import progress_lines, trial_table
from parking_exp.tuning.trials import TrialRow, rows

if TYPE_CHECKING:
    from optuna import Study


class TrialMonitor(LiveView):
    """Watches the trials of a search until it is over.

    Args:
        search: the search.
        study: a study object of its own.
        console: where to print; None: the standard error stream.
    """

    def __init__(self, search: Search, study: "Study", console: Console | None = None) -> None:
        self.search, self.study = search, study
        self.trials = self._read()
        super().__init__(console)

    def _read(self) -> list[TrialRow]:
        return rows(self.study, self.search.folder, self.search.request.n_trials)

    def _look(self) -> None:
        before = {trial.number: trial.state for trial in self.trials}
        try:
            self.trials = self._read()
        except ParkingError:  # the workers report a failing storage
            return
        for trial in self.trials:
            if before.get(trial.number) != trial.state and trial.state != "pending":
                self._print_event(trial)

    def _print_event(self, trial: TrialRow) -> None:
        if trial.state == "running":
            self.say(f"started  {trial.label}")
            return
        values = zip(self.search.request.search.objective, trial.values, strict=False)
        result = ", ".join(f"{name} {value:.1%}" for name, value in values) or trial.reason or ""
        over = sum(row.state in ("done", "pruned", "failed") for row in self.trials)
        self.say(f"{trial.state:<8} {trial.label}: {result}  ({over} of {self.search.request.n_trials})")

    def _render(self) -> RenderableType:
        request = self.search.request
        running = []
        for trial in self.trials:
            if trial.state == "running" and trial.runs:
                state = read_state(Path(self.search.base.output_path) / trial.runs[-1])
                running.append(f"running  {name(state)}: {under_way(state)}")
        return Group(
            trial_table(self.trials, request.search),
            *running,
            *progress_lines(self.trials, request.search, request.n_trials),
        )
