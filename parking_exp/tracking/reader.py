"""Read-only access to a store: its runs, and the artifacts that they have."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from parking_exp.config.paths import absolute, database, lies_inside, local_folder
from parking_exp.errors import ParkingError, ResultsError
from parking_exp.tracking.client import connect
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.store import own_directory

if TYPE_CHECKING:
    from mlflow.entities import Run

RUNS_A_PAGE = 10_000  # one request for most stores; MLflow's limit is 50,000
DOWNLOADS_AT_ONCE = 16


class Reader:
    """A read-only connection to a store that exists.

    Args:
        uri: the store.
        artifacts_in: the folder that artifacts have to lie in, since a store may come from elsewhere; None: anywhere.

    Raises:
        ResultsError: there is none, or it does not answer.
    """

    def __init__(self, uri: str, artifacts_in: Path | None = None) -> None:
        self.uri, self._artifacts_in = absolute(uri), artifacts_in
        path = database(self.uri)
        if path is not None and not path.is_file():
            raise ResultsError(f"there is no store {path}; train something first, or name another output_dir or store")
        if path is None and Path(uri).is_file():
            raise ResultsError(f"uri={uri} is a file and no URI; type sqlite:///{uri}")
        with self._asked():
            if artifacts_in is not None:
                own_directory(self.uri, artifacts_in)
            self._client = connect(self.uri)

    def run_dir(self, tag: str | None) -> str | None:
        """Return the run directory that a run's tag means: relative ones lie beside an embedded store."""
        path = database(self.uri)
        return str(path.parent / tag) if path and tag else tag

    def experiments(self) -> dict[str, str]:
        """Return the ids of all experiments that are not deleted, by name."""
        with self._asked():
            found = _pages(lambda token: self._client.search_experiments(page_token=token))
            return {experiment.name: experiment.experiment_id for experiment in found}

    def runs(self, experiment_ids: Sequence[str]) -> "list[Run]":
        """Return all runs of some experiments that are not deleted, the first started first."""
        with self._asked():
            ids = list(experiment_ids)
            found = _pages(lambda token: self._client.search_runs(ids, "", 1, RUNS_A_PAGE, None, token))
            return sorted(found, key=lambda run: run.info.start_time or 0)

    def artifact(self, run_id: str, folder_uri: str, name: str) -> bytes | None:
        """Return the content of a run's artifact, None where it has none of that name.

        Raises:
            Exception: it is there and can't be had; `failures.reason` makes a sentence of it.
        """
        if not isinstance(folder_uri, str):  # missing in a store from elsewhere
            raise ResultsError("the store does not say where its artifacts are")
        folder, within = local_folder(folder_uri), self._artifacts_in
        if within is not None and (folder is None or not lies_inside(folder / name, within)):
            raise ResultsError(f"it lies outside of {within}; tracking.uri={self.uri} reads it there, too")
        if folder is not None:
            try:
                return (folder / name).read_bytes()
            except FileNotFoundError:
                return None
        with TemporaryDirectory() as temporary:
            try:
                return Path(self._client.download_artifacts(run_id, name, temporary)).read_bytes()
            except Exception:
                if any(item.path == name for item in self._client.list_artifacts(run_id)):
                    raise
                return None

    def artifacts(self, places: Sequence[tuple[str, str]], name: str) -> Iterator[bytes | Exception | None]:
        """Yield what `artifact` returns or raises for each (run id, folder URI); from a server several at a time."""

        def one(place: tuple[str, str]) -> bytes | Exception | None:
            try:
                return self.artifact(*place, name)
            except Exception as error:
                if not is_store_failure(error):
                    raise
                return error  # the caller says it

        if not any(isinstance(uri, str) and local_folder(uri) is None for _, uri in places):
            yield from map(one, places)
            return
        with ThreadPoolExecutor(DOWNLOADS_AT_ONCE) as pool:
            yield from pool.map(one, places)

    @contextmanager
    def _asked(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            if isinstance(error, ParkingError) or not is_store_failure(error):
                raise
            raise ResultsError(f"the store {self.uri} can't be read: {reason(error)}") from error


def _pages(page: Callable[[str | None], Any]) -> Iterator[Any]:
    token: str | None = None
    while True:
        found = page(token)
        yield from found
        if not (token := found.token):
            return
