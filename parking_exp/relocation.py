"""Artifact locations of an embedded store whose output directory was moved or copied."""

import sqlite3
from contextlib import closing
from pathlib import Path

from parking_exp.locations import ARTIFACTS, local_folder


def relocate(database: Path) -> None:
    """Point experiments and runs of a database to the artifacts beside it, where these were moved along with it.

    MLflow keeps absolute locations: a moved store would go on writing to the old place, a copied one to the original's.

    Raises:
        sqlite3.Error: the database can't be changed.
    """
    with closing(sqlite3.connect(database)) as connection, connection:
        found = connection.execute("SELECT experiment_id, name, artifact_location FROM experiments").fetchall()
        for experiment_id, name, location in found:
            here, there = database.parent / ARTIFACTS / name, local_folder(location or "")
            if there is None or there.parts[-2:] != (ARTIFACTS, name) or not here.is_dir():
                continue
            if there.exists() and there.samefile(here):
                continue
            uri = here.absolute().as_uri()
            connection.execute(
                "UPDATE experiments SET artifact_location = ? WHERE experiment_id = ?", (uri, experiment_id)
            )
            connection.execute(
                "UPDATE runs SET artifact_uri = ? || substr(artifact_uri, ?)"
                " WHERE experiment_id = ? AND substr(artifact_uri, 1, ?) = ?",
                (uri, len(location) + 1, experiment_id, len(location) + 1, f"{location}/"),
            )
