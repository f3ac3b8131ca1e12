"""Make the deleted models of a finished run again, from its last checkpoint."""

import json
import zipfile
from pathlib import Path

from parking_exp.algorithms.model_files import BUFFER_ENTRIES, replacing
from parking_exp.errors import DamagedFileError
from parking_exp.evaluation.evaluate import rank
from parking_exp.runs.directory import MODELS, RunDirectory
from parking_exp.training import checkpoints


def make_models(directory: RunDirectory) -> str:
    """Make the final and the best model of a finished run again where they are gone, the same to the last bit.

    Returns:
        What was done, or why it can't be, as a sentence.

    Raises:
        DamagedFileError: the checkpoint's model or progress can't be read.
        OSError: the disk is full.
    """
    gone = [name for name in MODELS if not (directory.models / name).exists()]
    if not gone:
        return f"{directory.models} has all models"
    names, checkpoint = " and ".join(f"models/{name}" for name in gone), directory.final_checkpoint
    if (problem := checkpoints.check(checkpoint)) is not None:
        why = f"{checkpoint} can't be used ({problem})" if checkpoint.exists() else "no checkpoint of its end is left"
        return f"{names}: gone, and can't be made again, since {why}; delete {directory.path} to train it afresh"
    directory.models.mkdir(exist_ok=True)
    for name in gone:
        earlier = name == "best.zip" and not _ends_with_best(directory, checkpoint)
        averaged = (checkpoint / checkpoints.AVERAGED).exists()
        last = checkpoints.AVERAGED if averaged else checkpoints.MODEL
        _copy(checkpoint / (checkpoints.BEST if earlier else last), directory.models / name)
    return f"{names}: gone, and made again from {checkpoint}"


def _ends_with_best(directory: RunDirectory, checkpoint: Path) -> bool:
    """Whether the final model is a run's best one, by the last evaluation, which is made after the last checkpoint."""
    before, result = checkpoints.read_progress(checkpoint).best, directory.result()
    assert result is not None
    last = {key.removeprefix("eval/"): value for key, value in result.metrics.items() if key.startswith("eval/")}
    try:
        return before is None or list(rank(last)) > before
    except (KeyError, TypeError) as error:
        raise DamagedFileError(f"{checkpoint} and {directory.path / 'result.json'} are of no evaluation") from error


def _copy(checkpointed: Path, path: Path) -> None:
    """Write what `save_model` would have written, from the model of a checkpoint: the same weights to the last bit."""
    try:
        with zipfile.ZipFile(checkpointed) as whole:
            members = {member: whole.read(member) for member in whole.infolist()}
            (data,) = (member for member in members if member.filename == "data")
            entries = json.loads(members[data])
            members[data] = json.dumps({k: v for k, v in entries.items() if k not in BUFFER_ENTRIES}, indent=4).encode()
    except (zipfile.BadZipFile, ValueError, AttributeError, NotImplementedError, RecursionError) as error:
        raise DamagedFileError(f"{checkpointed} is no model; delete {checkpointed.parent}") from error
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as copy:
        for member, content in members.items():
            copy.writestr(member, content)
