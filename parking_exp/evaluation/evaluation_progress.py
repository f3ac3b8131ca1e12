"""Progress of an evaluation on a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import Progress

from parking_exp.phrases import plural
from parking_exp.terminal import Screen


@contextmanager
def evaluation_progress(n_episodes: int, env_name: str) -> Iterator[Callable[[int], None]]:
    """Show a bar on the standard error stream if that is a terminal.

    Yields:
        A function that is called with the number of finished episodes after each step.
    """
    screen = Screen(stderr=True)
    with Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task(f"{plural(n_episodes, 'episode')} of {env_name}", total=n_episodes)

        def update(n_finished: int) -> None:
            bar.update(task, completed=n_finished)

        yield update
