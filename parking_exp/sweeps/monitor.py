"""Live views: a rich table on a terminal, a line for each event elsewhere.

That of a sweep only reads run directories, so that it is the same for every launcher.
"""

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from parking_exp.runs.directory import STATUS_FILE
from parking_exp.runs.run_state import RunState, counts, read_state
from parking_exp.runs.state_tables import duration, name, under_way
from parking_exp.terminal import console as make_console

POLL_S = 1.0


class LiveView:
    """Base of live views: looks every second, in a thread, until its block is left, and has a table on a terminal.

    Subclasses initialise it last: rich renders the table at once.

    Args:
        console: where to print; None: the standard error stream.
    """

    def __init__(self, console: Console | None) -> None:
        self.console = console or make_console(stderr=True)
        self._live = Live(get_renderable=self._render, console=self.console, refresh_per_second=1, transient=True)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self._look()
        if self.console.is_terminal:
            self._live.stop()

    def say(self, text: str) -> None:
        """Print a line, above the table where there is one."""
        self.console.print(text, soft_wrap=True)

    def _watch(self) -> None:
        while not self._over.wait(POLL_S):
            self._look()

    def _look(self) -> None:
        """Read again what may have changed, and print a line for each event."""
        raise NotImplementedError

    def _render(self) -> RenderableType:
        """Return the table."""
        raise NotImplementedError


class Monitor(LiveView):
    """Watches runs until the sweep is over.

    Args:
        paths: their directories.
        console: where to print; None: the standard error stream.
    """

    def __init__(self, paths: Sequence[Path], console: Console | None = None) -> None:
        self.states = {path: read_state(path) for path in paths}
        self._written = dict.fromkeys(paths, 0)  # when status.json was last written, in ns
        self._done_before = counts(self.states.values())["done"]
        self._begin = time.monotonic()
        self._steps_before = self._steps()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("runs"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
        )
        self._task = self._bar.add_task("sweep", total=len(paths), left="")
        super().__init__(console)

    def _look(self) -> None:
        """Read again the states that may have changed, and print a line for each that has."""
        for path, before in list(self.states.items()):
            written = _written(path)
            if before.stage != "running" and written == self._written[path]:
                continue
            self._written[path] = written
            state = self.states[path] = read_state(path)
            if state.stage != before.stage:
                self._print_event(state)
        found = counts(self.states.values())
        left = self._left_s()
        self._bar.update(
            self._task,
            completed=found["done"] + found["failed"],
            left=f"about {duration(left)} left" if left is not None else "",
        )

    def _print_event(self, state: RunState) -> None:
        over = sum(one.stage in {"done", "failed"} for one in self.states.values())
        which = f"({over} of {len(self.states)})"
        if state.stage == "done":
            rate = f"success {state.success_rate:.0%}, " if state.success_rate is not None else ""
            left = self._left_s()
            rest = f", about {duration(left)} left" if left else ""
            self.say(f"done     {name(state)}: {rate}{duration(state.wall_s or 0.0)}  {which}{rest}")
        elif state.stage == "failed":
            self.say(f"failed   {name(state)}: {state.reason}  {which}")
        elif state.stage == "running":
            self.say(f"started  {name(state)}{f'  on {state.host}' if state.host else ''}")
        else:
            self.say(
                f"stopped  {name(state)}, {f'at step {state.step}' if state.step else 'before its first checkpoint'}"
            )

    def _render(self) -> RenderableType:
        table = Table.grid(padding=(0, 2))
        for state in self.states.values():
            if state.stage == "running":
                done = min(1.0, state.step / state.total_timesteps) if state.total_timesteps else 0.0
                bar = f"{'━' * round(20 * done):<20}"
                table.add_row(name(state), bar, under_way(state), state.host or "")
        return Group(table, self._bar)

    def _steps(self) -> float:
        """Env steps of all runs so far; one that failed counts as gone through."""
        return sum(
            state.step if state.stage in {"running", "pending"} else state.total_timesteps or 0
            for state in self.states.values()
        )

    def _left_s(self) -> float | None:
        """Seconds left for the whole sweep, at the rate so far."""
        steps = self._steps() - self._steps_before
        total = sum(state.total_timesteps or 0 for state in self.states.values())
        if steps <= 0:
            return None
        return (total - self._steps()) * (time.monotonic() - self._begin) / steps


def _written(path: Path) -> int:
    try:
        return (path / STATUS_FILE).stat().st_mtime_ns
    except OSError:
        return 0
