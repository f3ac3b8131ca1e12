"""The resolved config in a run directory: written with paths relative to it, read back as data."""

import json
import re
from pathlib import Path

import yaml

from parking_exp.config.paths import absolute, relative
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import check
from parking_exp.errors import ConfigError
from parking_exp.runs.atomic_files import read_plain_yaml, write_atomically

CONFIG_FILE = "config.yaml"
OUTPUT_DIR = "../../.."  # from a run directory


def write_config(directory: Path, config: RunConfig, *, durable: bool) -> None:
    """Write a run's config into its directory, which is made if need be.

    Raises:
        OSError: it can't be written.
    """
    uri = config.tracking.uri and relative(config.tracking.uri, config.output_path)
    tracking = config.tracking.model_copy(update={"uri": uri})
    plain = config.model_copy(update={"output_dir": OUTPUT_DIR, "tracking": tracking}).plain()
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / CONFIG_FILE, yaml.safe_dump(plain, sort_keys=False), durable=durable)


def read_config(directory: Path, output_dir: Path) -> RunConfig:
    """Read a run's config, with the output directory and store of where the run is now.

    It is data: values were resolved when it was written, and nothing in it is resolved again.

    Raises:
        ConfigError: it can't be read, has an interpolation, or does not fit this version of the package.
    """
    path = directory / CONFIG_FILE
    try:
        stored = read_plain_yaml(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} can't be read: {str(error).splitlines()[0]}") from error
    if not isinstance(stored, dict):
        raise ConfigError(f"{path} can't be read: it is no config, but a {type(stored).__name__}")
    if interpolation := re.search(r'[^"]*\$\{[^"]*', json.dumps(stored)):
        raise ConfigError(f"{path} has the interpolation {interpolation[0]}; stored configs have values only")
    try:
        config = check(RunConfig, stored)
    except ConfigError as error:
        raise ConfigError(f"{path} does not fit this version of parking_exp: {error}") from error
    uri = config.tracking.uri and absolute(config.tracking.uri, output_dir)
    tracking = config.tracking.model_copy(update={"uri": uri})
    return config.model_copy(update={"output_dir": str(output_dir), "tracking": tracking})
