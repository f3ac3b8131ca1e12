"""Parse a command line, run the command, and turn errors into sentences and exit statuses.

The parser is Hydra's own, an argparse parser of flags and `key=value` words, with flags of ours besides. Hydra answers
`--help`, `--cfg job` and the like. Commands import torch and mlflow once a config is known to be good.
"""

import argparse
import io
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import NoReturn

import hydra
from hydra._internal.utils import _run_hydra, get_args_parser
from omegaconf import DictConfig

from parking_exp.config.compose import VERSION_BASE, composed, config_dir
from parking_exp.config.overrides import quoted
from parking_exp.errors import (
    DISK_ERRORS,
    ConfigError,
    InterruptedRunError,
    OutputDirectoryError,
    ParkingError,
    did_you_mean,
)
from parking_exp.terminal import LogFormatter, say

Task = Callable[[DictConfig], object]
Command = Callable[[list[str], str | None], None]
"""What a command does with its overrides and Hydra's `--config-dir`."""


def run_command(
    config_name: str,
    command: Command,
    *,
    flags: Mapping[str, str] | None = None,
    read: Callable[[list[str]], list[str]] = list,
) -> None:
    """Run the command that is typed, or let Hydra show what it is asked for.

    Args:
        config_name: root of the command's config.
        command: what to do.
        flags: `--quick` and such, and the override that each stands for.
        read: writes the words that are typed as Hydra's overrides.
    """
    if logging.lastResort is not None:  # what warnings go through
        logging.lastResort.setFormatter(LogFormatter())
    with errors_as_sentences():
        parser, arguments = _parse(sys.argv[1:], flags or {})
        arguments.overrides = [quoted(override) for override in read(arguments.overrides)]
        if any(getattr(arguments, flag) for flag in ("help", "hydra_help", "cfg", "info", "shell_completion")):
            _run_hydras(parser, arguments, config_name)
        else:
            command(arguments.overrides, arguments.config_dir)


def for_each(config_name: str, check: Task, task: Task) -> Command:
    """Make a command of a task for each config that the overrides stand for; all are checked first."""

    def command(overrides: list[str], extra_config_dir: str | None) -> None:
        configs = composed(config_name, overrides, extra_config_dir)
        for config in configs:
            check(config)
        for config in configs:
            task(config)

    return command


@contextmanager
def errors_as_sentences() -> Iterator[None]:
    """Print errors that a user can meet without their traceback, and leave with an exit status."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except ParkingError as error:
        fail(error)
    except BrokenPipeError:  # `... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:  # a full disk, a file in the way
        if error.errno not in DISK_ERRORS:
            raise
        where = f": {error.filename}" if error.filename else ""
        fail(OutputDirectoryError(f"{error.strerror or error}{where}"))
    except KeyboardInterrupt:
        fail(InterruptedRunError("stopped; type the same command to go on", signal.SIGINT))


def fail(error: ParkingError) -> NoReturn:
    """Print an error's sentences, and leave with its exit status."""
    if os.environ.get("HYDRA_FULL_ERROR") == "1":
        raise error
    prefix = "" if isinstance(error, InterruptedRunError) else "error: "
    # Only a ConfigError has lines of its own; in others they stand in a name or a library's words.
    lines = str(error).strip().split("\n") if isinstance(error, ConfigError) else [str(error).strip()]
    say(*(f"{prefix}{line}" for line in lines), stderr=True)
    sys.exit(128 + error.signal_number if isinstance(error, InterruptedRunError) else 2)


def _parse(words: list[str], flags: Mapping[str, str]) -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    """Parse the words of a command line: Hydra's flags and ours, between the overrides or around them.

    Raises:
        ConfigError: there is no such flag, or its value is missing or wrong.
    """
    parser = get_args_parser()
    parser.allow_abbrev = False  # it would take `--experiment` for `--experimental-rerun`
    parser.exit_on_error = False
    for flag in flags:
        parser.add_argument(flag, action="append_const", dest="flags", const=flags[flag])
    try:
        arguments, unknown = parser.parse_known_intermixed_args(words)
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error.argument_name}: {error.message}") from error
    if unknown:
        flag = next((word for word in unknown if word.startswith("-")), unknown[0]).partition("=")[0]
        hint = (
            did_you_mean(flag, re.findall(r"--[\w-]+", parser.format_usage()), cutoff=0.8)
            or "; write KEY=VALUE, without dashes"
        )
        raise ConfigError(f"{flag}: there is no such flag{hint}")
    if arguments.config_name or arguments.config_path or arguments.experimental_rerun:
        raise ConfigError(
            "--config-name, --config-path and --experimental-rerun: not supported here; put options of your own into a "
            "directory and pass --config-dir=DIRECTORY; rerun the same command to resume"
        )
    if arguments.config_dir and not Path(arguments.config_dir).is_dir():
        raise ConfigError(f"--config-dir={arguments.config_dir}: there is no such directory")
    arguments.overrides += getattr(arguments, "flags", None) or []
    return parser, arguments


def _run_hydras(parser: argparse.ArgumentParser, arguments: argparse.Namespace, config_name: str) -> None:
    """Have Hydra show help, a config or the like.

    Raises:
        ConfigError: what is to be shown does not compose, or flags do not go together.
    """
    if arguments.cfg:
        composed(config_name, arguments.overrides, arguments.config_dir)
    hydra.version.setbase(VERSION_BASE)
    shown = io.StringIO()  # Hydra would print a traceback when the pipe that it prints to is closed
    try:
        with redirect_stdout(shown):
            _run_hydra(arguments, parser, lambda config: None, str(config_dir()), config_name)
    except ValueError as error:  # flags that do not go together
        raise ConfigError(str(error)) from error
    finally:
        sys.stdout.write(shown.getvalue())
