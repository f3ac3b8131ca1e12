"""The command lines: compose all runs, refuse what cannot run, run the rest, print sentences instead of tracebacks.

What Hydra only shows (`--help`, `--cfg job`) is left to Hydra. Torch and mlflow are imported only once a command is
known to be good.
"""

import argparse
import os
import signal
import sys
from collections.abc import Callable
from typing import NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from omegaconf import DictConfig

from parking_exp.composition import VERSION_BASE, composed, config_dir, quoted
from parking_exp.errors import FailedRunError, InterruptedRunError, ParkingError, RunLockedError
from parking_exp.validation import validate


def train() -> None:
    """Entry point of `scripts/train.py` and `parking-train`."""

    def run(config: DictConfig) -> None:
        from parking_exp.training import train as train_run

        train_run(config)

    _command("config", check=validate, task=run)


def evaluate() -> None:
    """Entry point of `scripts/evaluate.py` and `parking-evaluate`."""
    from parking_exp.evaluate_run import evaluate_run, validate_request

    _command("evaluate", check=validate_request, task=evaluate_run)


def benchmark() -> None:
    """Entry point of `scripts/benchmark.py` and `parking-benchmark`."""
    from parking_exp.benchmark import benchmark as measure
    from parking_exp.benchmark import validate_benchmark

    sys.argv = ["quick=true" if argument == "--quick" else argument for argument in sys.argv]
    _command("benchmark", check=validate_benchmark, task=measure)


def _command(config_name: str, check: Callable[[DictConfig], object], task: Callable[[DictConfig], object]) -> None:
    sys.argv[1:] = [quoted(argument) for argument in sys.argv[1:]]
    arguments = get_args_parser().parse_args()
    if _only_shows(arguments):
        hydra.main(version_base=VERSION_BASE, config_path=str(config_dir()), config_name=config_name)(task)()
        return
    try:
        configs = composed(config_name, arguments.overrides, arguments.config_dir)
        for config in configs:
            check(config)
        if len(configs) == 1:
            task(configs[0])
        else:
            _sweep(configs, task)
    except ParkingError as error:
        _fail(error)
    except KeyboardInterrupt:
        _fail(InterruptedRunError("stopped; nothing of this was stored", signal.SIGINT))


def _sweep(configs: list[DictConfig], task: Callable[[DictConfig], object]) -> None:
    """Run one config after the other; a failure does not keep the others from running, Ctrl-C does.

    A run that another process is working on is left to it, so that sweeps in several shells share the work.
    """
    failed = []
    for number, config in enumerate(configs, 1):
        print(f"run {number} of {len(configs)}", flush=True)
        try:
            task(config)
        except InterruptedRunError:
            raise
        except RunLockedError:
            print("another process is working on it; left to that one", file=sys.stderr)
        except ParkingError as error:
            print(f"error: {error}", file=sys.stderr)
            failed.append(number)
    if failed:
        raise FailedRunError(f"{len(failed)} of {len(configs)} runs failed: {', '.join(map(str, failed))}")


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
    for line in str(error).splitlines():
        print(f"{prefix}{line}", file=sys.stderr)
    sys.exit(128 + error.signal_number if isinstance(error, InterruptedRunError) else 2)
