"""Parse a command line, run the command, and turn errors into sentences and exit statuses.

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

# Hydra's flags that show something, and those that change how.
SHOWING = ("help", "hydra_help", "version", "cfg", "info", "shell_completion")
OTHERS = ("resolve", "package", "run", "multirun", "config_dir")
NOT_SUPPORTED = ("config_name", "config_path", "experimental_rerun")

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
        arguments = _parse(sys.argv[1:], flags or {})
        arguments.overrides = [quoted(override) for override in read(arguments.overrides)]
        if any(getattr(arguments, flag) for flag in SHOWING):
            _run_hydra(arguments, config_name)
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


def _parser(flags: Mapping[str, str]) -> argparse.ArgumentParser:
    """Return a parser of Hydra's flags, as `hydra.main` has them, of ours, and of overrides."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("overrides", nargs="*")
    for names in (
        ("--help", "-h"), ("--hydra-help",), ("--version",), ("--shell-completion", "-sc"), ("--resolve",),
        ("--run", "-r"), ("--multirun", "-m"),
    ):  # fmt: skip
        parser.add_argument(*names, action="store_true")
    for names in (
        ("--package", "-p"), ("--config-dir", "-cd"), ("--config-name", "-cn"), ("--config-path", "-cp"),
        ("--experimental-rerun",),
    ):  # fmt: skip
        parser.add_argument(*names)
    parser.add_argument("--cfg", "-c", choices=["job", "hydra", "all"])
    infos = ["all", "config", "defaults", "defaults-tree", "plugins", "searchpath"]
    parser.add_argument("--info", "-i", nargs="?", const="all", choices=infos)
    for flag, override in flags.items():
        parser.add_argument(flag, action="append_const", dest="flags", const=override)
    return parser


def _parse(words: list[str], flags: Mapping[str, str]) -> argparse.Namespace:
    """Parse the words of a command line: Hydra's flags and ours, between the overrides or around them.

    Raises:
        ConfigError: there is no such flag, or its value is missing or wrong.
    """
    try:
        arguments, unknown = _parser(flags).parse_known_intermixed_args(words)
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error.argument_name}: {error.message}") from error
    if unknown:
        flag = next((word for word in unknown if word.startswith("-")), unknown[0]).partition("=")[0]
        known = [*flags, *(f"--{name.replace('_', '-')}" for name in (*SHOWING, *OTHERS))]
        hint = did_you_mean(flag, known, cutoff=0.8) or "; write KEY=VALUE, without dashes"
        raise ConfigError(f"{flag}: there is no such flag{hint}")
    if passed := [name for name in NOT_SUPPORTED if getattr(arguments, name)]:
        instead = "put options of your own into a directory and pass --config-dir=DIRECTORY"
        instead = "rerun the same command to resume" if passed == ["experimental_rerun"] else instead
        raise ConfigError(f"--{passed[0].replace('_', '-')} is not supported here; {instead}")
    if arguments.config_dir and not Path(arguments.config_dir).is_dir():
        raise ConfigError(f"--config-dir={arguments.config_dir} is not a directory")
    arguments.overrides += getattr(arguments, "flags", None) or []
    return arguments


def _run_hydra(arguments: argparse.Namespace, config_name: str) -> None:
    """Have Hydra show help, a config or the like.

    Raises:
        ConfigError: what is to be shown does not compose, or flags do not go together.
    """
    if arguments.cfg:
        composed(config_name, arguments.overrides, arguments.config_dir)
    given = {f"--{name.replace('_', '-')}": getattr(arguments, name) for name in (*SHOWING, *OTHERS)}
    words = [flag if value is True else f"{flag}={value}" for flag, value in given.items() if value]
    show = hydra.main(str(config_dir()), config_name, VERSION_BASE)(lambda config: None)
    shown = io.StringIO()  # Hydra would print a traceback when the pipe that it prints to is closed
    try:
        with redirect_stdout(shown):
            sys.argv[1:] = [*words, *arguments.overrides]
            show()
    except ValueError as error:  # flags that do not go together
        raise ConfigError(str(error)) from error
    finally:
        sys.stdout.write(strip_password(shown.getvalue()))
