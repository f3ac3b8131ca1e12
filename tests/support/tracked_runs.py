"""Run directories as trainings with a store leave them, without a training."""

import sqlite3
from contextlib import closing

from parking_exp.config.paths import default_uri
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_provenance import provenance_tags
from support.runs import smoke_config
from support.sync_processes import grow


def written_run(output_dir, seed=0, uri=None, started_ms=1_700_000_000_000):
    """A run directory as at the start of a training."""
    smoke = smoke_config()
    tracking = smoke.tracking.model_copy(update={"uri": uri})
    config = smoke.model_copy(
        update={"output_dir": str(output_dir), "seed": seed, "tracking": tracking}
    )
    directory = RunDirectory(config.run_dir)
    directory.write_config(config)
    write_json(
        directory.path / "provenance.json", {"started_ms": started_ms, "tags": provenance_tags()}
    )
    directory.update_status(status="running", tracking_uri=uri or default_uri(output_dir))
    return directory


def finish(directory):
    (directory.path / "episodes.csv").write_text("phase,step\n")
    directory.finish(1, {})


def finished_run(output_dir, seed=0, **changes):
    directory = written_run(output_dir, seed, **changes)
    grow(directory, rows=20)
    finish(directory)
    return directory


def files_below(folder):
    """Every file below a folder with its content, by its relative path."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def rows(output_dir, query, *values):
    """Run a statement in the database of an output directory's own store."""
    with closing(sqlite3.connect(output_dir / "mlflow.db")) as database, database:
        return database.execute(query, values).fetchall()
