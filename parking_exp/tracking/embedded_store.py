"""The store inside of an output directory: can it be used, or has it to be made again from the run
directories?

It can't be used if it is missing, if its creation was interrupted, or if the output directory was
moved or copied: MLflow keeps absolute locations of artifacts, which its client can't change.
`mirror.prepare` makes another. A store that has anything of others, or that a newer MLflow has
made, is never replaced.
"""

import secrets
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from parking_exp.config.paths import ARTIFACTS, SQLITE
from parking_exp.errors import StoreError
from parking_exp.terminal import say
from parking_exp.tracking.client import OUTPUT_DIR_TAG, import_mlflow, open_client, reason

if TYPE_CHECKING:
    from mlflow import MlflowClient

EXPERIMENTS = 50_000  # in one request, MLflow's limit
MOVE_IT = (
    "move it away, and the next command makes one from the run directories; "
    "or name a store with tracking.uri="
)


def is_usable(path: Path, output_dir: Path) -> bool:
    """Return whether a store can be used where it is; if not, it may be replaced.

    Raises:
        StoreError: it has to be replaced, but has something of others.
        Exception: what MLflow, SQLAlchemy or the disk raise where the store is not to blame.
    """
    if not path.exists():
        return False
    import_mlflow()
    try:
        client = open_client(f"{SQLITE}{path}")
    except Exception as error:
        text = reason(error)
        if "out-of-date database schema" in text:  # MLflow adds what an older one lacks
            raise StoreError(
                f"{path} was made by another MLflow; install that, or {MOVE_IT}"
            ) from error
        if text.endswith("already exists"):  # as tables of interrupted migrations do
            return False
        raise
    if _is_where_it_was_made(client, output_dir):
        return True
    _refuse_content_of_others(client, path)
    return False


def set_aside(path: Path, output_dir: Path) -> None:
    """Give a store and its artifacts other names, beside the old ones, and say so."""
    number = 1
    while any(output_dir.glob(f"*.replaced-{number}")):
        number += 1
    for old in (path, output_dir / ARTIFACTS):
        if old.exists():
            kept = old.rename(old.with_name(f"{old.name}.replaced-{number}"))
            say(
                f"{old} can't be used here and is made again; the old one is {kept.name}",
                stderr=True,
            )


def unfinished_path(path: Path) -> Path:
    """Return a name for a store that is being made: a new one, since MLflow remembers which stores
    it has made.
    """
    return path.with_name(f"{path.name}.build-{secrets.token_hex(4)}")


def remove_unfinished(path: Path, output_dir: Path) -> None:
    """Remove stores that processes were making when they were killed, and the artifacts that they
    had written.
    """
    leftovers = list(output_dir.glob(f"*{path.name}.build-*"))
    if any(leftover.suffix != ".lock" for leftover in leftovers):  # else the store was complete
        shutil.rmtree(output_dir / ARTIFACTS, ignore_errors=True)
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)


def _is_where_it_was_made(client: "MlflowClient", output_dir: Path) -> bool:
    """Return whether all experiments of this package have their artifacts in an output
    directory.
    """
    experiments = client.search_experiments(max_results=EXPERIMENTS)
    places = {experiment.tags.get(OUTPUT_DIR_TAG) for experiment in experiments}
    return places <= {None, str(output_dir)}


def _refuse_content_of_others(client: "MlflowClient", path: Path) -> None:
    """Raise StoreError if a store has runs that are not of the run directories beside it."""
    from mlflow.entities import ViewType

    experiments = client.search_experiments(ViewType.ALL, max_results=EXPERIMENTS)
    ids = [experiment.experiment_id for experiment in experiments]
    token = None
    while True:
        page = client.search_runs(
            ids, run_view_type=ViewType.ALL, max_results=10_000, page_token=token
        )
        for run in page:
            run_dir = run.data.tags.get("run_dir")
            if run_dir is None or Path(run_dir).is_absolute():
                raise StoreError(
                    f"{path} can't be used here, and has runs of others, e.g. {run.info.run_id}; "
                    f"{MOVE_IT}"
                )
        if not (token := page.token):
            return
