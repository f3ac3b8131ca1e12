"""Run a command: parse its command line, call it, and turn errors into sentences and exit statuses.

The command line has Hydra's flags and overrides, where `--dry-run` means `dry_run=true`; Hydra
itself shows `--help`. Commands import torch and mlflow after our own keys are validated.
"""

import argparse
import io
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import NoReturn

import hydra
from omegaconf import OmegaConf

from parking_exp.config.compose import VERSION_BASE, compose_configs, user_options
from parking_exp.config.overrides import conf_dir
from parking_exp.errors import (
    DISK_ERRORS,
    ConfigError,
    InterruptedRunError,
    OutputDirectoryError,
    ParkingError,
)
from parking_exp.terminal import (
    check_output,
    command_of,
    drop_unwritten_output,
    is_script,
    open_standard_streams,
    say,
    unfailing_output,
)

Command = Callable[[list[str], str | None], None]
"""A function of the overrides and Hydra's `--config-dir`."""


def run_command(
    config_name: str, command: Command, read: Callable[[list[str]], list[str]] = list
) -> None:
    """Run the command of this process, or show its help or config.

    Args:
        config_name: root of the command's config.
        command: the function to call.
        read: turns the words of the command line into Hydra's overrides.
    """
    open_standard_streams()
    try:
        with unfailing_output(), errors_as_sentences():
            _run(config_name, command, read)
    finally:
        drop_unwritten_output()


def _run(config_name: str, command: Command, read: Callable[[list[str]], list[str]]) -> None:
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise ConfigError(
            "the working directory does not exist any more; change to one that does"
        ) from error
    options, words = _parse(sys.argv[1:])
    overrides = read(words)
    if options.help:
        _print_help(config_name, user_options(options.config_dir))
    elif options.cfg:
        configs = compose_configs(config_name, overrides, options.config_dir)
        sys.stdout.write("---\n".join(map(OmegaConf.to_yaml, configs)))
        check_output()
    else:
        command(overrides, options.config_dir)


def rename_experiment(words: list[str]) -> list[str]:
    """Replace `experiment=NAME` by `experiment_name=NAME`: in `conf/`, `experiment` is a group."""
    return [re.sub(r"^experiment=", "experiment_name=", word) for word in words]


@contextmanager
def errors_as_sentences() -> Iterator[None]:
    """Print a `ParkingError` without its traceback, and exit with a status."""
    try:
        yield
    except ParkingError as error:
        fail(error)
    except BrokenPipeError:  # `... | head`
        sys.exit(1)
    except OSError as error:  # a full disk, a file in the way
        if error.errno not in DISK_ERRORS:
            raise
        where = f": {error.filename}" if error.filename else ""
        fail(OutputDirectoryError(f"{error.strerror or error}{where}"))
    except KeyboardInterrupt:
        fail(InterruptedRunError("stopped; rerun the same command to resume", signal.SIGINT))


def fail(error: ParkingError) -> NoReturn:
    """Print an error's sentences, and exit with its status."""
    if os.environ.get("HYDRA_FULL_ERROR") == "1":
        raise error
    prefix = "error: "
    status = 2
    if isinstance(error, InterruptedRunError):
        prefix = ""
        status = 128 + error.signal_number
    # Only the lines of a ConfigError are ours; in others, line breaks come from names or libraries.
    text = str(error).strip()
    lines = text.split("\n") if isinstance(error, ConfigError) else [text]
    say(*(f"{prefix}{line}" for line in lines), stderr=True)
    sys.exit(status)


def _print_help(config_name: str, overrides: list[str]) -> None:
    """Print Hydra's help, with the names that commands and `conf/` have in this installation."""
    sys.argv[1:] = ["--help", *overrides]
    output = io.StringIO()
    hydra_app = hydra.main(str(conf_dir()), config_name, VERSION_BASE)(lambda config: None)
    try:
        with redirect_stdout(output):
            hydra_app()  # it exits
    finally:
        text = output.getvalue()
        if not is_script():
            text = re.sub(r"python scripts/(\w+)\.py", lambda match: command_of(match[1]), text)
            text = re.sub(r"\bconf/", lambda _: f"{conf_dir()}/", text)
        sys.stdout.write(text)
        check_output()


def _parse(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return Hydra's flags, and the other words, with `--dry-run` as `dry_run=true`."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--help", "-h", action="store_true")
    parser.add_argument("--cfg", "-c", choices=["job"])
    # `--multirun` is not needed: several values make a sweep.
    parser.add_argument("--multirun", "-m", action="store_true")
    parser.add_argument("--config-dir", "-cd")
    try:
        options, words = parser.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error.argument_name}: {error.message}") from error
    return options, [_as_override(word) for word in words]


def _as_override(word: str) -> str:
    if not word.startswith("--"):
        return word
    key, equals, value = word.removeprefix("--").partition("=")
    if not equals:
        value = "true"
    return f"{key.replace('-', '_')}={value}"
