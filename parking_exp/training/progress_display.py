"""Progress of a training: a rich bar on a terminal, ten lines elsewhere, and the heartbeat."""

import math
import time
from collections.abc import Callable

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from parking_exp.terminal import Screen

LINES = 10  # per run, without a terminal
HEARTBEAT_S = 1.0
LINE_S = 10.0  # between two lines of an activity without a terminal


class ProgressDisplay:
    """Progress of one run, with its success rate, return and speed; call `close` after use.

    Args:
        total_steps: env steps in all.
        start: env steps done before.
        enabled: whether anything is shown, on the standard error stream.
        heartbeat: called every second with how far the run is, whatever is shown.
    """

    def __init__(
        self, total_steps: int, start: int, enabled: bool, heartbeat: Callable[..., None]
    ) -> None:
        self._console = Screen(stderr=True)
        self._enabled = enabled
        self._total = total_steps
        self._start = start
        self._step = start
        self._started = time.monotonic()
        self._activity = "train"
        self._next_activity_line = 0.0
        self._heartbeat = heartbeat
        self._next_heartbeat = 0.0
        self._line_interval = max(1, total_steps // LINES)
        self._next_line = start + self._line_interval
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=10),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=not (enabled and self._console.is_terminal),
            transient=True,
        )
        self._task = self._bar.add_task("train", total=total_steps, completed=start, figures="")
        self._bar.start()

    def close(self) -> None:
        """Remove the bar."""
        self._bar.stop()

    def update(self, step: int, success_rate: float, episode_return: float) -> None:
        """Show the step, and the means over the last training episodes; NaN before the first."""
        self._step = step
        rate = (step - self._start) / max(time.monotonic() - self._started, 1e-9)
        if time.monotonic() >= self._next_heartbeat:
            self._send_heartbeat("train", rate)
        success = "" if math.isnan(success_rate) else f"success {success_rate:4.0%}  "
        speed = f"{rate:.0f} steps/s"
        self._bar.update(
            self._task, completed=step, figures=f"{success}{speed}", description="train"
        )
        if not self._console.is_terminal and step >= self._next_line:
            self._next_line += self._line_interval
            mean_return = "" if math.isnan(episode_return) else f"return {episode_return:6.1f}  "
            self.say(f"train  {step}/{self._total} steps  {success}{mean_return}{speed}")

    def show_activity(self, activity: str) -> None:
        """Show an activity other than training."""
        self._activity = activity
        self._next_activity_line = time.monotonic() + LINE_S
        self._send_heartbeat(activity, 0.0)
        self._bar.update(self._task, description=activity, figures="")

    def show_episodes(self, n_finished: int, n_episodes: int) -> None:
        """Show how many episodes of the activity are finished."""
        count = f"{n_finished} of {n_episodes} episodes done"
        self._bar.update(self._task, figures=count)
        now = time.monotonic()
        if now >= self._next_heartbeat:
            self._send_heartbeat(f"{self._activity}, {count}", 0.0)
        if not self._console.is_terminal and now >= self._next_activity_line:
            self._next_activity_line = now + LINE_S
            self.say(f"{self._activity}  {count}")

    def say(self, text: str) -> None:
        """Print a line, above the bar if there is one."""
        if self._enabled:
            self._bar.console.print(text, highlight=False, soft_wrap=True)

    def _send_heartbeat(self, activity: str, rate: float) -> None:
        self._next_heartbeat = time.monotonic() + HEARTBEAT_S
        self._heartbeat(step=self._step, steps_per_s=rate, doing=activity)
