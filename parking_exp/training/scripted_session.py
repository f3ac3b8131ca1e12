"""A run whose policy is not trained."""

import zipfile
from pathlib import Path

from parking_exp.runs.atomic_files import replacing
from parking_exp.runs.run_files import CONFIG_FILE
from parking_exp.tasks.scripted_policy import build_scripted_policy
from parking_exp.training.checkpoints import SavedProgress
from parking_exp.training.run_session import RunContext, RunSession


class ScriptedSession(RunSession):
    """A run that evaluates a scripted policy. It has no checkpoints."""

    step = 0

    def __init__(self, context: RunContext) -> None:
        super().__init__(context, SavedProgress())
        algorithm = self.config.algorithm
        self.policy = build_scripted_policy(
            algorithm.target, algorithm.arguments, self.task, self.config.seed
        )

    def learn(self) -> None:
        """Do nothing."""

    def save_checkpoint(self) -> None:
        """Do nothing: a resumed run starts anew."""

    def save_final(self, path: Path) -> None:
        """Write a file with the run's config, which is all that there is of the policy."""
        config = (self.directory.path / CONFIG_FILE).read_bytes()
        with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            # Without a time, since a clock may be before 1980, of which zip files have none.
            archive.writestr(zipfile.ZipInfo(CONFIG_FILE), config)
