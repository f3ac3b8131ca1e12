"""Send a training to its store; a store that fails does not stop it."""

from collections.abc import Callable

from parking_exp.runs.directory import RunDirectory
from parking_exp.tracking.mirror import sync_hint, try_mirror
from parking_exp.tracking.store import Store


class RunMirror:
    """Mirrors a run to its store; after a failure it tries again only at the end of the run.

    Args:
        uri: of the store; None: the run has none, or another process mirrors it.
        directory: of the run.
        say: shows a line.
    """

    def __init__(
        self, uri: str | None, directory: RunDirectory, say: Callable[[str], None]
    ) -> None:
        self.uri = uri
        self.directory = directory
        self.say = say
        self.problem: str | None = None

    def send_checkpoint(self) -> None:
        """Send a new checkpoint, unless the store has failed: each attempt could take minutes."""
        if self.problem is None:
            self.send()

    def send(self) -> None:
        """Send the run as it is, at its start and after its last status is written."""
        if self.uri is None:
            return
        before = self.problem
        store = Store(self.uri, self.directory.output_dir)
        self.problem = try_mirror(self.directory, store)
        if before and self.problem is None:
            self.say("the store is complete again")
        elif self.problem and before is None:
            self.say(
                f"the store {self.uri} is incomplete ({self.problem}); training continues, and "
                f"{self.hint}"
            )

    @property
    def hint(self) -> str:
        """The command that sends what the store lacks."""
        return sync_hint(self.directory.output_dir, self.uri)
