"""Find run directories: all of an experiment, or one by its path, its MLflow run id or `latest`."""

from collections.abc import Sequence
from pathlib import Path

from parking_exp.config.paths import absolute_path, resolved
from parking_exp.errors import OutputDirectoryError, RunNotFoundError
from parking_exp.phrases import did_you_mean, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import STATUS_FILE

LATEST = "latest"


def experiment_of(run_dir: Path) -> str:
    """Return the name of the experiment that a run directory belongs to."""
    return run_dir.parents[1].name


def find_runs(output_dir: Path, experiment: str | None = None) -> list[Path]:
    """Return the run directories under an output directory, of one experiment or of all, sorted."""
    directories = _distinct(output_dir, "*/*/seed=*")
    return [path for path in directories if experiment in (None, experiment_of(path))]


def find_runs_below(folder: Path) -> list[Path]:
    """Return the run directories in a folder, such as an experiment's or a cell's, sorted."""
    return _distinct(folder, "*", "*/*", "*/*/*")


def _distinct(folder: Path, *patterns: str) -> list[Path]:
    """Return the run directories that match any of the patterns, sorted.

    A directory that links also reach is listed once, by its own path.
    """
    real_folder = resolved(folder)
    by_place: dict[Path, Path] = {}
    try:
        for pattern in patterns:
            for file in folder.glob(f"{pattern}/{STATUS_FILE}"):
                path = file.parent
                place = resolved(path)
                if place not in by_place or place == real_folder / path.relative_to(folder):
                    by_place[place] = path
    except OSError as error:
        raise OutputDirectoryError(
            f"{folder} can't be searched for runs: {error.strerror}"
        ) from error
    return sorted(by_place.values())


def find_run(
    name: str, output_dir: Path, required_file: str, other_names: Sequence[str], key: str = "run"
) -> RunDirectory:
    """Find a run by its directory, its MLflow run id, or `latest`.

    Args:
        name: the name of the run.
        output_dir: the output directory to search.
        required_file: a file of runs; `latest` is the run whose file was written last.
        other_names: at least one other valid name, for suggestions.
        key: the config key that names the run, for messages.

    Raises:
        RunNotFoundError: no run matches; the message suggests the closest valid name.
    """
    folder = absolute_path(name)
    if (folder / STATUS_FILE).exists():
        return RunDirectory(folder)
    runs = find_runs(output_dir)
    usable = [path for path in runs if (path / required_file).exists()]
    if name == LATEST and usable:
        # A sync or an evaluation changes status.json, and not this file.
        latest = max(usable, key=lambda path: (path / required_file).stat().st_mtime)
        return RunDirectory(latest.absolute())
    for path in runs:
        if RunDirectory(path).run_id == name:
            return RunDirectory(path.absolute())

    choices = [*other_names, *map(str, runs)]
    if usable:
        choices.insert(0, LATEST)
    hint = did_you_mean(name, choices) or f"; write {key}={choices[0]}"
    raise RunNotFoundError(
        f"{key}={name}: there is no such run directory or MLflow run id; {output_dir} has "
        f"{plural(len(runs), 'run')}, {len(usable)} with {required_file}{hint}"
    )
