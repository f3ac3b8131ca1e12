"""Find run directories: all of an experiment, or one by its path, its MLflow run id or `latest`."""

from pathlib import Path

from parking_exp.config.paths import directory_path
from parking_exp.errors import RunNotFoundError, did_you_mean, plural
from parking_exp.runs.directory import STATUS_FILE, RunDirectory


def find_runs(output_dir: Path, experiment: str | None = None) -> list[Path]:
    """Return the run directories under an output directory, of one experiment or of all, sorted."""
    return sorted(file.parent for file in output_dir.glob(f"{experiment or '*'}/*/seed=*/{STATUS_FILE}"))


def find_run(name: str, output_dir: Path, having: str) -> RunDirectory:
    """Find a run by its directory, its MLflow run id, or `latest`: the last worked on that has the file `having`.

    Raises:
        RunNotFoundError: there is none.
    """
    if (Path(name).expanduser() / STATUS_FILE).exists():
        return RunDirectory(directory_path(name))
    files = sorted(output_dir.glob(f"*/*/*/{STATUS_FILE}"), key=lambda file: file.stat().st_mtime)
    if not files:
        raise RunNotFoundError(f"run={name}: there are no runs in {output_dir}; train one first, or set output_dir")
    if name == "latest":
        usable = [file for file in files if (file.parent / having).exists()]
        if not usable:
            done = any(RunDirectory(file.parent).status == "done" for file in files)
            hint = "; where a run is done and it is gone, its training command typed again makes it" if done else ""
            there = plural(len(files), "run")
            raise RunNotFoundError(f"run=latest: of {there} in {output_dir}, none has {having} yet{hint}")
        return RunDirectory(usable[-1].parent.absolute())
    ids = {run_id: file.parent for file in files if (run_id := RunDirectory(file.parent).run_id)}
    if name in ids:
        return RunDirectory(ids[name].absolute())
    hint = did_you_mean(name, ["latest", *ids, *(str(file.parent) for file in files)])
    raise RunNotFoundError(
        f"run={name}: no run directory, and no MLflow run id of {plural(len(files), 'run')} in {output_dir}"
        + (hint or f"; the latest is {files[-1].parent}")
    )
