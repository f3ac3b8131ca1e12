"""Progress of a training: a rich bar on a terminal, ten lines a run elsewhere, and the heartbeat."""

import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from parking_exp.terminal import Screen

LINES = 10  # lines a run, where there is no terminal
HEARTBEAT_S = 1.0
BESIDE_FIGURES = 36  # columns of the bar at its shortest, its description, both times, and gaps
Heartbeat = Callable[..., None]


class TrainingProgress:
    """Progress of one run, with its success rate, return and speed.

    Args:
        total_steps, start: env steps in all, and done before.
        enabled: whether anything is shown.
        console: where; None: the standard error stream.
        heartbeat: told every second how far the run is, whatever is shown.
    """

    def __init__(
        self,
        total_steps: int,
        start: int,
        enabled: bool,
        console: Console | None = None,
        heartbeat: Heartbeat | None = None,
    ) -> None:
        self.console = console or Screen(stderr=True)
        self.total, self.start, self.enabled = total_steps, start, enabled
        self._started = time.monotonic()
        self._heartbeat, self._next_heartbeat, self._step = heartbeat, 0.0, start
        self._next_line = start + max(1, total_steps // LINES)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=not (enabled and self.console.is_terminal),
            transient=True,
        )
        self._task = self._bar.add_task("train", total=total_steps, completed=start, figures="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, step: int, success_rate: float | None, episode_return: float | None) -> None:
        """Show the step, and the mean of the last training episodes."""
        self._step = step
        rate = (step - self.start) / max(time.monotonic() - self._started, 1e-9)
        if time.monotonic() >= self._next_heartbeat:
            self._send_heartbeat("train", rate)
        if not self.enabled:
            return
        known = [f"{rate:.0f} steps/s"]
        if success_rate is not None and episode_return is not None:
            known = [f"success {success_rate:4.0%}", f"return {episode_return:6.1f}", *known]
        self._bar.update(self._task, completed=step, figures=self._fitting(known), description="train")
        if not self.console.is_terminal and step >= self._next_line:
            self._next_line += max(1, self.total // LINES)
            self.say(f"train  {step}/{self.total} steps  {'  '.join(known)}")

    def busy(self, what: str) -> None:
        """Say what goes on besides training."""
        self._send_heartbeat(what, 0.0)
        self._bar.update(self._task, description=what, figures="")

    def _fitting(self, figures: Sequence[str]) -> str:
        """Return as many figures as there is room for beside the times: without the return, or the speed alone."""
        room = self.console.width - BESIDE_FIGURES - len(f"{self.total}/{self.total}")
        choices = ["  ".join(some) for some in (figures, [figures[0], figures[-1]], figures[-1:])]
        return next((text for text in choices if len(text) <= room), "")

    def _send_heartbeat(self, doing: str, rate: float) -> None:
        if self._heartbeat is not None:
            self._next_heartbeat = time.monotonic() + HEARTBEAT_S
            self._heartbeat(step=self._step, steps_per_s=rate, doing=doing)

    def say(self, text: str) -> None:
        """Print a line, above the bar where there is one."""
        if self.enabled:
            self._bar.console.print(text, highlight=False, soft_wrap=True)
