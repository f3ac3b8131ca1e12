"""Run a command: parse its command line, call it, and turn errors into sentences and exit statuses.

The parser accepts Hydra's flags, our own flags and `key=value` words; Hydra itself shows `--help` and `--cfg job`.
Commands import torch and mlflow after our own keys are validated.
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

HYDRA_FLAGS = {"--help", "--cfg", "--resolve", "--multirun", "--config-dir"}

Command = Callable[[list[str], str | None], None]
"""A function of the overrides and Hydra's `--config-dir`."""


def run_command(
    config_name: str,
    command: Command,
    *,
    flags: Mapping[str, str] | None = None,
    read: Callable[[list[str]], list[str]] = list,
) -> None:
    """Run the command of this process, or let Hydra show help or the config.

    Args:
        config_name: root of the command's config.
        command: the function to call.
        flags: flag, e.g. `--quick`, -> equivalent override.
        read: turns the words of the command line into Hydra's overrides.
    """
    if logging.lastResort is not None:  # handles warnings
        logging.lastResort.setFormatter(LogFormatter())
    with errors_as_sentences():
        options, words = _parse(sys.argv[1:], flags or {})
        overrides = [quoted(override) for override in read(words)]
        if options.cfg:
            composed(config_name, overrides, options.config_dir)  # for its error messages
        if options.cfg or options.help:
            _show(config_name, options, overrides)
        else:
            command(overrides, options.config_dir)


def for_each(config_name: str, check: Callable[[DictConfig], object], task: Callable[[DictConfig], object]) -> Command:
    """Return a command that runs a task for each config of the overrides, after all are checked."""

    def command(overrides: list[str], extra_config_dir: str | None) -> None:
        configs = composed(config_name, overrides, extra_config_dir)
        for config in configs:
            check(config)
        for config in configs:
            task(config)

    return command


@contextmanager
def errors_as_sentences() -> Iterator[None]:
    """Print a `ParkingError` without its traceback, and exit with a status."""
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
    """Print an error's sentences, and exit with its status."""
    if os.environ.get("HYDRA_FULL_ERROR") == "1":
        raise error
    prefix = "" if isinstance(error, InterruptedRunError) else "error: "
    # Only the lines of a ConfigError are ours; in others, line breaks come from names or libraries.
    text = strip_password(str(error).strip())
    lines = text.split("\n") if isinstance(error, ConfigError) else [text]
    say(*(f"{prefix}{line}" for line in lines), stderr=True)
    sys.exit(128 + error.signal_number if isinstance(error, InterruptedRunError) else 2)


def _parse(words: list[str], flags: Mapping[str, str]) -> tuple[argparse.Namespace, list[str]]:
    """Return Hydra's flags, and the overrides, those of our flags last."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--help", "-h", action="store_true")
    parser.add_argument("--cfg", "-c", choices=["job", "hydra", "all"])
    parser.add_argument("--resolve", action="store_true")
    parser.add_argument("--multirun", "-m", action="store_true")  # not needed: several values make a sweep
    parser.add_argument("--config-dir", "-cd")
    for flag, override in flags.items():
        parser.add_argument(flag, action="append_const", dest="flags", const=override, default=[])
    try:
        options, unknown = parser.parse_known_intermixed_args(words)
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error.argument_name}: {error.message}") from error
    if unknown:
        flag = next((word for word in unknown if word.startswith("-")), unknown[0]).partition("=")[0]
        hint = did_you_mean(flag, [*flags, *HYDRA_FLAGS], cutoff=0.8) or "; write KEY=VALUE, without dashes"
        raise ConfigError(f"{flag}: there is no such flag{hint}")
    if options.config_dir is not None and not Path(options.config_dir).is_dir():
        raise ConfigError(f"--config-dir={options.config_dir} is not a directory")
    return options, options.overrides + getattr(options, "flags", [])


def _show(config_name: str, options: argparse.Namespace, overrides: list[str]) -> None:
    """Have Hydra show help or a config, without passwords."""
    flags = ["--help"] if options.help else [f"--cfg={options.cfg}", *["--resolve"] * options.resolve]
    if options.config_dir is not None:
        flags.append(f"--config-dir={options.config_dir}")
    sys.argv[1:] = [*flags, *overrides]
    output = io.StringIO()
    try:
        with redirect_stdout(output):
            hydra.main(str(config_dir()), config_name, VERSION_BASE)(lambda config: None)()
    finally:
        sys.stdout.write(strip_password(output.getvalue()))
