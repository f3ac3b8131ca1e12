"""The command lines: compose all runs, refuse what cannot run, run the rest, print sentences instead of tracebacks.

What Hydra only shows (`--help`, `--cfg job`) is left to Hydra. Torch and mlflow are imported only once a command is
known to be good.
"""

import argparse
import gc
import logging
import os
import re
import signal
import sys
from collections.abc import Callable
from typing import NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from omegaconf import DictConfig

from parking_exp.config.compose import VERSION_BASE, composed, composed_runs, config_dir, in_quotes, quoted
from parking_exp.config.schema import SweepOptions
from parking_exp.errors import ConfigError, InterruptedRunError, OutputDirectoryError, ParkingError
from parking_exp.terminal import LogFormatter, say

Task = Callable[[DictConfig], object]
REPORT_KEYS = {"experiment_name", "cells", "baseline", "output_dir", "name", "tracking", "report", "hydra"}
# Options of ours that may be typed the way of other commands.
FLAGS = {"--quick", "--json", "--watch", "--sync", "--dry-run"}


def train() -> None:
    """Entry point of `scripts/train.py` and `parking-train`: one run in this process, or a sweep."""

    def run(config: DictConfig) -> None:
        gc.disable()  # importing torch without it takes .8 s less
        from parking_exp.training.run import train as train_run

        gc.freeze()
        gc.enable()
        train_run(config)

    def command(arguments: argparse.Namespace) -> None:
        from parking_exp.config.validate import parse
        from parking_exp.sweeps.launching import Launch
        from parking_exp.sweeps.plan import plan
        from parking_exp.sweeps.run import sweep

        runs = composed_runs("config", arguments.overrides, arguments.config_dir)
        first = runs[0].cell  # keys of a sweep are the same in all
        options = parse(SweepOptions, {name: first[name] for name in SweepOptions.model_fields})
        planned = plan(runs, options.retry)
        launcher_named = any(override.lstrip("+~").startswith("hydra/launcher") for override in arguments.overrides)
        # What only a supervisor can do makes a sweep of a single run.
        supervised = launcher_named or options.dry_run or options.retry or planned[0].config.timeout_s
        if len(planned) == 1 and not supervised:
            run(runs[0].config)
        else:
            sweep(planned, Launch(arguments.overrides, arguments.config_dir), dry_run=options.dry_run)

    _translate()
    _command("config", command, shows=run)


def evaluate() -> None:
    """Entry point of `scripts/evaluate.py` and `parking-evaluate`."""
    from parking_exp.evaluation.stored_run import evaluate_run, validate_request

    _command("evaluate", _single("evaluate", validate_request, evaluate_run), shows=evaluate_run)


def status() -> None:
    """Entry point of `scripts/status.py` and `parking-status`."""
    from parking_exp.cli.status import show, validate_status

    _translate()
    # `experiment` is a group in our tree; here it is the name of what was run.
    sys.argv = [f"experiment_name={a[11:]}" if a.startswith("experiment=") else a for a in sys.argv]
    _command("status", _single("status", validate_status, show), shows=show)


def report() -> None:
    """Entry point of `scripts/report.py` and `parking-report`."""
    from parking_exp.reports.report import report as write_report
    from parking_exp.reports.report import validate_report

    def only_one(arguments: argparse.Namespace) -> None:
        configs = composed("report", arguments.overrides, arguments.config_dir)
        if len(configs) > 1:
            raise ConfigError("a report takes one value for each key; name=... makes another one beside it")
        validate_report(configs[0])
        run(configs[0])

    def run(config: DictConfig) -> None:
        gc.disable()  # a third of the time of a large report, whose objects all stay to its end
        write_report(config)
        gc.freeze()

    try:
        sys.argv[1:] = report_arguments(sys.argv[1:])
    except ParkingError as error:
        _fail(error)
    _command("report", only_one, shows=run)


def benchmark() -> None:
    """Entry point of `scripts/benchmark.py` and `parking-benchmark`."""
    from parking_exp.benchmarks.run import benchmark as measure
    from parking_exp.benchmarks.run import validate_benchmark

    _translate()
    _command("benchmark", _single("benchmark", validate_benchmark, measure), shows=measure)


def report_arguments(arguments: list[str]) -> list[str]:
    """Write what is typed after `report.py` as Hydra reads it: words that are no key of this command name cells.

    Labels of cells have commas, equal signs and spaces in them, which mean something else to Hydra.

    Raises:
        ConfigError: cells are named both ways.
    """
    found, cells = [], []
    arguments = ["report=quick" if argument == "--quick" else argument for argument in arguments]
    overrides = _parser().parse_args(arguments).overrides
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if argument not in overrides:
            found.append(argument)
        elif key == "experiment" and equals:
            names = value.removeprefix("[").removesuffix("]").split(",")
            found.append(
                "experiment_name=null" if value == "null" else f"experiment_name=[{','.join(map(in_quotes, names))}]"
            )
        elif key == "baseline" and value not in {"", "null"}:
            found.append(f"baseline={in_quotes(_unquoted(value))}")
        elif key == "cells" and equals and value != "null" and not value.startswith("["):
            cells += _words(value)
        elif key.lstrip("+~").split(".")[0].split("/")[0] in REPORT_KEYS:
            found.append(argument)
        else:
            cells += _words(argument) if not equals else [argument]
    if cells and any(argument.startswith("cells=") for argument in found):
        raise ConfigError(f"{cells[0]}: name cells either as words or as cells=[...]")
    return [*found, *([f"cells=[{','.join(map(in_quotes, cells))}]"] if cells else [])]


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def _words(text: str) -> list[str]:
    """Split at commas; a comma before a space is part of a label."""
    return re.split(r",(?! )", text)


def _translate() -> None:
    """Write what people type in the way of other commands as Hydra reads it."""
    for number, argument in enumerate(sys.argv):
        if argument in FLAGS:
            sys.argv[number] = f"{argument.removeprefix('--').replace('-', '_')}=true"


def _single(config_name: str, check: Task, task: Task) -> Callable[[argparse.Namespace], None]:
    """Make a command of a task for each composed config, one after the other."""

    def command(arguments: argparse.Namespace) -> None:
        configs = composed(config_name, arguments.overrides, arguments.config_dir)
        for config in configs:
            check(config)
        for config in configs:
            task(config)

    return command


def _command(config_name: str, command: Callable[[argparse.Namespace], None], shows: Task) -> None:
    """Run a command, or let Hydra show what it is asked for, and turn errors into sentences and exit statuses."""
    if logging.lastResort is not None:  # what warnings go through
        logging.lastResort.setFormatter(LogFormatter())
    sys.argv[1:] = [quoted(argument) for argument in sys.argv[1:]]
    arguments = _parser().parse_args()
    if _only_shows(arguments):
        hydra.main(version_base=VERSION_BASE, config_path=str(config_dir()), config_name=config_name)(shows)()
        return
    try:
        command(arguments)
    except ParkingError as error:
        _fail(error)
    except BrokenPipeError:  # `... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:  # a full disk, a file in the way
        where = f": {error.filename}" if error.filename else ""
        _fail(OutputDirectoryError(f"{error.strerror or error}{where}"))
    except KeyboardInterrupt:
        _fail(InterruptedRunError("stopped; type the same command to go on", signal.SIGINT))


def _parser() -> argparse.ArgumentParser:
    """Return Hydra's parser, which would take `--experiment` for `--experimental-rerun`."""
    parser = get_args_parser()
    parser.allow_abbrev = False
    return parser


def _only_shows(arguments: argparse.Namespace) -> bool:
    """Whether the command line asks Hydra to show something and run nothing."""
    return bool(
        arguments.help
        or arguments.hydra_help
        or arguments.cfg
        or arguments.info
        or arguments.shell_completion
        or arguments.experimental_rerun
        or arguments.config_name
        or arguments.config_path
    )


def _fail(error: ParkingError) -> NoReturn:
    if os.environ.get("HYDRA_FULL_ERROR") == "1":
        raise error
    prefix = "" if isinstance(error, InterruptedRunError) else "error: "
    # Only a ConfigError has lines of its own; in others they stand in a name or a library's words.
    lines = str(error).strip().split("\n") if isinstance(error, ConfigError) else [str(error).strip()]
    say(*(f"{prefix}{line}" for line in lines), stderr=True)
    sys.exit(128 + error.signal_number if isinstance(error, InterruptedRunError) else 2)
