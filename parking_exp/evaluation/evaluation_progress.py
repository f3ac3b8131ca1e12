"""Progress of an evaluation: a rich bar on a terminal; elsewhere a line for each tenth of the
episodes.
"""

import time
from typing import Self

from rich.progress import Progress

from parking_exp.errors import plural
from parking_exp.terminal import Screen, say

QUIET_S = 5.0
"""No lines are printed for an evaluation that is shorter than this."""


class EvaluationProgress:
    """Context manager that shows how many episodes are over, on the standard error stream.

    Episodes are stepped together, so that none may be over for a minute: without a terminal, there
    are also lines after 5, 10, 20, 40, ... seconds.
    """

    def __init__(self, n_episodes: int, env_name: str) -> None:
        screen = Screen(stderr=True)
        self._n_episodes = n_episodes
        self._bar = Progress(console=screen, transient=True, disable=not screen.is_terminal)
        self._name = f"{plural(n_episodes, 'episode')} of {env_name}"
        self._task = self._bar.add_task(self._name, total=n_episodes)
        self._n_steps = 0
        self._next_tenth = 1
        self._start = time.monotonic()
        self._next_line_s = QUIET_S

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, finished: int) -> None:
        """Show the number of finished episodes, after a step of those that are stepped together."""
        self._n_steps += 1
        self._bar.update(
            self._task, completed=finished, description=f"{self._name}, step {self._n_steps}"
        )
        if not self._bar.disable:
            return
        elapsed_s = time.monotonic() - self._start
        is_tenth = 10 * finished >= self._next_tenth * self._n_episodes
        if is_tenth:
            self._next_tenth = 10 * finished // self._n_episodes + 1
        if elapsed_s >= self._next_line_s or (is_tenth and elapsed_s >= QUIET_S):
            self._next_line_s = 2 * max(elapsed_s, QUIET_S)
            say(
                f"evaluation  {finished} of {self._name} over, after {elapsed_s:.0f} s", stderr=True
            )
