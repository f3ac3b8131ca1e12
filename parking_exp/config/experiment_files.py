"""Experiment files from anywhere: `experiment=PATH.yaml` as an option that Hydra finds."""

import atexit
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path

from parking_exp.config.overrides import in_quotes
from parking_exp.errors import ConfigError


def experiment_files(overrides: list[str]) -> tuple[list[str], list[str]]:
    """Replace `experiment=PATH.yaml` by the option of that name; return the overrides, and directories that have it.

    Hydra takes options from directories alone, so that each file gets one, with a link to it.

    Raises:
        ConfigError: there is no such file.
    """
    found, folders = [], []
    for line in overrides:
        if (path := _path_in(line)) is not None:
            if not path.is_file():
                raise ConfigError(f"experiment={path}: there is no such file")
            folders.append(_folder_of(path.resolve()))
            line = f"experiment={in_quotes(path.stem)}"  # noqa: PLW2901
        found.append(line)
    return found, folders


@cache
def _folder_of(path: Path) -> str:
    folder = tempfile.mkdtemp(prefix="parking_exp_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    link = Path(folder) / "experiment" / f"{path.stem}.yaml"
    link.parent.mkdir()
    link.symlink_to(path)
    return folder


def with_absolute_path(line: str) -> str:
    """Return an override, with the path of an experiment file made absolute."""
    path = _path_in(line)
    return line if path is None else f"experiment={in_quotes(str(path.absolute()))}"


def _path_in(line: str) -> Path | None:
    """Return the path of an experiment file in an override; None where it has none."""
    key, _, value = line.partition("=")
    if value[:1] in {"'", '"'}:
        value = re.sub(r"\\(.)", r"\1", value[1:-1])  # what `in_quotes` has escaped
    path = Path(value).expanduser()
    return path if key == "experiment" and path.suffix in (".yaml", ".yml") else None
