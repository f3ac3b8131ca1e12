"""Find run directories: all of an experiment, or one by its path, its MLflow run id or `latest`."""

from collections.abc import Sequence
from pathlib import Path

from parking_exp.config.paths import directory_path, resolved
from parking_exp.errors import OutputDirectoryError, RunNotFoundError, did_you_mean, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import STATUS_FILE

LATEST = "latest"


def find_runs(output_dir: Path, experiment: str | None = None) -> list[Path]:
    """Return the run directories under an output directory, of one experiment or of all, sorted."""
    directories = _distinct(output_dir, "*/*/seed=*")
    return [
        path for path in directories if experiment in (None, path.parents[1].name)
    ]  # a name is not a pattern


def find_runs_below(folder: Path) -> list[Path]:
    """Return the run directories in a folder, such as an experiment's or a cell's, sorted."""
    return _distinct(folder, "*", "*/*", "*/*/*")


def _distinct(folder: Path, *patterns: str) -> list[Path]:
    """Return the run directories that match, sorted; one that links reach as well occurs once,
    without the link.
    """
    real_folder, by_place = resolved(folder), dict[Path, Path]()
    try:
        for pattern in patterns:
            for file in folder.glob(f"{pattern}/{STATUS_FILE}"):
                path, place = file.parent, resolved(file.parent)
                if place not in by_place or place == real_folder / path.relative_to(folder):
                    by_place[place] = path
    except OSError as error:
        raise OutputDirectoryError(
            f"{folder} can't be searched for runs: {error.strerror}"
        ) from error
    return sorted(by_place.values())


def find_run(name: str, output_dir: Path, having: str, others: Sequence[str] = ()) -> RunDirectory:
    """Find a run by its directory, its MLflow run id, or `latest`: the one whose file `having` was
    written last.

    Raises:
        RunNotFoundError: no run matches; the message suggests the closest valid name, `others`
            among them.
    """
    folder = directory_path(name)
    if (folder / STATUS_FILE).exists():
        return RunDirectory(folder)
    runs = find_runs(output_dir)
    usable = [path for path in runs if (path / having).exists()]
    usable.sort(
        key=lambda path: (path / having).stat().st_mtime
    )  # a sync or an evaluation changes status.json
    if name == LATEST and usable:
        return RunDirectory(usable[-1].absolute())
    if name == LATEST and runs:
        raise RunNotFoundError(
            f"run=latest: of {plural(len(runs), 'run')} in {output_dir}, none has {having} yet"
        )
    ids = {run_id: path for path in runs if (run_id := RunDirectory(path).run_id)}
    if name in ids:
        return RunDirectory(ids[name].absolute())
    choices = [*([LATEST] if usable else []), *others, *ids, *map(str, runs)]
    hint = did_you_mean(name, choices) or (
        f"; write run={choices[0]}" if choices else "; train one first"
    )
    raise RunNotFoundError(
        f"run={name} is neither a run directory nor the MLflow run id of a run in "
        f"{output_dir}{hint}"
    )
