"""Relocate the artifacts of an output directory's own store after the directory was moved or copied.

In SQL, since MLflow's client can't change an artifact location.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

OUTPUT_DIR_TAG = "parking_exp.output_dir"
"""Tag of experiments in an output directory's own store: where the directory was when artifacts were located last."""


def relocate(database: Path) -> None:
    """Point experiments and runs of a database to artifacts below the output directory that it is in now.

    MLflow keeps absolute locations: a moved store would go on writing to the old place, a copied one to the original's.
    Experiments without the tag, of runs in other output directories, stay as they are.

    Raises:
        sqlite3.Error: the database can't be changed.
    """
    with closing(sqlite3.connect(database)) as connection, connection:
        tagged = "SELECT experiment_id, value FROM experiment_tags WHERE key = ?"
        for experiment_id, written in connection.execute(tagged, (OUTPUT_DIR_TAG,)).fetchall():
            if written == str(database.parent) or not Path(written).is_absolute():
                continue
            old, new = f"{Path(written).as_uri()}/", f"{database.parent.as_uri()}/"
            for table, column in (("experiments", "artifact_location"), ("runs", "artifact_uri")):
                connection.execute(
                    f"UPDATE {table} SET {column} = ? || substr({column}, ?)"
                    f" WHERE experiment_id = ? AND substr({column}, 1, ?) = ?",
                    (new, len(old) + 1, experiment_id, len(old), old),
                )
            renamed = "UPDATE experiment_tags SET value = ? WHERE experiment_id = ? AND key = ?"
            connection.execute(renamed, (str(database.parent), experiment_id, OUTPUT_DIR_TAG))
