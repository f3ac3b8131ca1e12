"""Show runs live: a line for each event and, on a terminal, a line for each running run."""

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live

from parking_exp.errors import ParkingError
from parking_exp.runs.run_state import NO_REASON, RunState, read_state
from parking_exp.runs.state_tables import format_duration, run_name, state_lines
from parking_exp.terminal import make_console

POLL_S = 1.0


class Monitor:
    """Context manager that reads the states of runs every second, and shows what changes.

    Args:
        find_run_dirs: returns the run directories that exist now.
        n_runs: how many there will be at most.
        console: None: the standard error stream.
    """

    def __init__(
        self,
        find_run_dirs: Callable[[], Sequence[Path]],
        n_runs: int,
        console: Console | None = None,
    ) -> None:
        self._find_run_dirs = find_run_dirs
        self._n_runs = n_runs
        self._console = console or make_console(stderr=True)
        self._states = {path: read_state(path) for path in find_run_dirs()}
        self._live = Live(
            get_renderable=self._render, console=self._console, refresh_per_second=1, transient=True
        )
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._look()
        self._live.stop()

    def say(self, text: str) -> None:
        """Print a line, above the running runs."""
        self._console.print(text, soft_wrap=True)

    def _watch(self) -> None:
        while not self._over.wait(POLL_S):
            self._look()

    def _look(self) -> None:
        """Read the states that may have changed, and print a line for each change of stage."""
        with suppress(OSError, ParkingError):  # a folder is being deleted, for example
            self._print_changes()

    def _print_changes(self) -> None:
        for path in self._find_run_dirs():
            before = self._states.get(path)
            if before and before.stage == "done":
                continue
            state = self._states[path] = read_state(path)
            if state.stage != (before.stage if before else "pending"):
                self._print_event(state)

    def _print_event(self, state: RunState) -> None:
        run = run_name(state)
        match state.stage:
            case "done":
                result = format_duration(state.wall_s or 0.0)
                if state.success_rate is not None:
                    result = f"success {state.success_rate:.0%}, {result}"
                self.say(f"done     {run}: {result}  ({self._progress()})")
            case "failed":
                self.say(f"failed   {run}: {state.reason or NO_REASON}  ({self._progress()})")
            case "running":
                place = f"  on {state.host}" if state.host else ""
                self.say(f"started  {run}{place}")
            case _:
                moment = f"at step {state.step}" if state.step else "before its first checkpoint"
                self.say(f"stopped  {run}, {moment}")

    def _render(self) -> RenderableType:
        return Group(*state_lines(list(self._states.values()), "running"), self._progress())

    def _progress(self) -> str:
        over = sum(state.stage in ("done", "failed") for state in list(self._states.values()))
        return f"{over} of {self._n_runs}"
