"""The shell of every command: parse its line, run it, and turn errors into sentences and exit statuses.

The parser takes Hydra's flags, flags of ours, and `key=value` words. Hydra answers `--help`, `--cfg job` and the like.
Commands import torch and mlflow once our own keys are known to be good.
"""

import argparse
import io
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import NoReturn

import hydra
from omegaconf import DictConfig

from parking_exp.config.compose import VERSION_BASE, composed, config_dir
from parking_exp.config.credentials import strip_password
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

# Hydra's flags, with their short forms: those that show something, and those that change how.
SHOWING = {"--help": ["-h"], "--hydra-help": [], "--version": [], "--cfg": ["-c"], "--info": ["-i"]}
OTHERS = {"--resolve": [], "--package": ["-p"], "--run": ["-r"], "--multirun": ["-m"], "--config-dir": ["-cd"]}
WITH_VALUE = {"--cfg": {}, "--info": {"nargs": "?", "const": "all"}, "--package": {}, "--config-dir": {}}

Command = Callable[[list[str], str | None], None]
"""What a command does with its overrides and Hydra's `--config-dir`."""


def run_command(
    config_name: str,
    command: Command,
    *,
    flags: Mapping[str, str] | None = None,
    read: Callable[[list[str]], list[str]] = list,
) -> None:
    """Run the command of this process, or let Hydra show what is asked for.

    Args:
        config_name: root of the command's config.
        command: what to do.
        flags: `--quick` and such, and the override that each stands for.
        read: writes the words of the command line as Hydra's overrides.
    """
    if logging.lastResort is not None:  # what warnings go through
        logging.lastResort.setFormatter(LogFormatter())
    with errors_as_sentences():
        given, words = _parse(sys.argv[1:], flags or {})
        overrides = [quoted(override) for override in read(words)]
        if given.keys() & SHOWING.keys():
            _run_hydra(config_name, given, overrides)
        else:
            command(overrides, given.get("--config-dir"))


def for_each(config_name: str, check: Callable[[DictConfig], object], task: Callable[[DictConfig], object]) -> Command:
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
        fail(InterruptedRunError("stopped; rerun the same command to resume", signal.SIGINT))


def fail(error: ParkingError) -> NoReturn:
    """Print an error's sentences, and leave with its exit status."""
    if os.environ.get("HYDRA_FULL_ERROR") == "1":
        raise error
    prefix = "" if isinstance(error, InterruptedRunError) else "error: "
    # Only a ConfigError has lines of its own; in others they stand in a name or a library's words.
    text = strip_password(str(error).strip())
    lines = text.split("\n") if isinstance(error, ConfigError) else [text]
    say(*(f"{prefix}{line}" for line in lines), stderr=True)
    sys.exit(128 + error.signal_number if isinstance(error, InterruptedRunError) else 2)


def _parse(words: list[str], flags: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Return Hydra's flags with their values, and the overrides, those of our flags last.

    Raises:
        ConfigError: there is no such flag, or its value is missing or wrong.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("overrides", nargs="*")
    for flag, short in {**SHOWING, **OTHERS}.items():
        options = WITH_VALUE.get(flag, {"action": "store_const", "const": ""})
        parser.add_argument(flag, *short, dest=flag, **options)  # type: ignore[arg-type]
    for flag, override in flags.items():
        parser.add_argument(flag, action="append_const", dest="flags", const=override, default=[])
    try:
        arguments, unknown = parser.parse_known_intermixed_args(words)
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error.argument_name}: {error.message}") from error
    if unknown:
        flag = next((word for word in unknown if word.startswith("-")), unknown[0]).partition("=")[0]
        hint = did_you_mean(flag, [*flags, *SHOWING, *OTHERS], cutoff=0.8) or "; write KEY=VALUE, without dashes"
        raise ConfigError(f"{flag}: there is no such flag{hint}")
    given = {name: value for name, value in vars(arguments).items() if name.startswith("-") and value is not None}
    directory = given.get("--config-dir")
    if directory is not None and not Path(directory).is_dir():
        raise ConfigError(f"--config-dir={directory} is not a directory")
    return given, arguments.overrides + getattr(arguments, "flags", [])


def _run_hydra(config_name: str, flags: Mapping[str, str], overrides: list[str]) -> None:
    """Have Hydra show help, a config or the like.

    Raises:
        ConfigError: what is to be shown does not compose, or flags do not go together.
    """
    if "--cfg" in flags:
        composed(config_name, overrides, flags.get("--config-dir"))
    show = hydra.main(str(config_dir()), config_name, VERSION_BASE)(lambda config: None)
    shown = io.StringIO()
    try:
        with redirect_stdout(shown):
            sys.argv[1:] = [*(f"{flag}={value}" if value else flag for flag, value in flags.items()), *overrides]
            show()
    except ValueError as error:  # flags that do not go together
        raise ConfigError(str(error)) from error
    finally:
        sys.stdout.write(strip_password(shown.getvalue()))
