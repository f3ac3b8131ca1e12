"""The identity of an output directory, for a store that several directories share."""

import re
import uuid
from pathlib import Path

from filelock import FileLock

from parking_exp.config.paths import refuse_links
from parking_exp.errors import OutputDirectoryError
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.foreign_files import read_object

IDENTITY_FILE = "identity.json"
ID = re.compile(r"[0-9a-f]{32}")


def output_id(output_dir: Path) -> str:
    """Return the id of an output directory; the first call draws it.

    The id is moved and copied with the directory. The path can't identify the directory: in
    containers it is the same on each machine.

    Raises:
        OutputDirectoryError: the file of the id is damaged.
        UntrustedError: the file is a link that leads out of the directory.
    """
    path = output_dir / IDENTITY_FILE
    refuse_links([path], output_dir)
    with FileLock(output_dir / f".{IDENTITY_FILE}.lock"):
        if not path.exists():
            write_json(path, {"output_id": uuid.uuid4().hex})
        stored = read_object(path).get("output_id")
    if not isinstance(stored, str) or not ID.fullmatch(stored):
        raise OutputDirectoryError(
            f"{path} is damaged; restore it, or delete it to send all runs as new ones"
        )
    return stored
