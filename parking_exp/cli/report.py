"""`scripts/report.py` and `parking-report`: compare the cells of an experiment."""

import gc
import re

from omegaconf import DictConfig

from parking_exp.cli.command import run_command
from parking_exp.config.compose import composed
from parking_exp.config.overrides import in_quotes
from parking_exp.errors import ConfigError
from parking_exp.reports.report_request import validate_report
from parking_exp.reports.report_run import report

KEYS = {"experiment_name", "from", "export", "cells", "baseline", "output_dir", "name", "storage", "tracking", "report"}


def main() -> None:
    """Run the command."""
    run_command("report", report_once, flags={"--quick": "report=quick"}, read=report_overrides)


def report_once(overrides: list[str], extra_config_dir: str | None) -> None:
    """Write the report that the overrides stand for.

    Raises:
        ConfigError: they stand for several.
    """
    configs = composed("report", overrides, extra_config_dir)
    if len(configs) > 1:
        raise ConfigError("a report takes one value for each key; name=... makes another one beside it")
    validate_report(configs[0])
    write(configs[0])


def write(config: DictConfig) -> None:
    """Write a report."""
    gc.disable()  # a third of the time of a large report, whose objects all stay to its end
    report(config)
    gc.freeze()


def report_overrides(words: list[str]) -> list[str]:
    """Write what is typed after `report.py` as Hydra's overrides: words that are no key of this command name cells.

    Labels of cells have commas, equal signs and spaces in them, which mean something else to Hydra.

    Raises:
        ConfigError: cells are named both ways.
    """
    found, cells = [], []
    for word in words:
        key, equals, value = word.partition("=")
        if key == "experiment" and equals:
            names = value.removeprefix("[").removesuffix("]").split(",")
            found.append(
                "experiment_name=null" if value == "null" else f"experiment_name=[{','.join(map(in_quotes, names))}]"
            )
        elif key in {"baseline", "from", "export"} and value not in {"", "null"}:
            found.append(f"{key}={in_quotes(_unquoted(value))}")
        elif key == "cells" and equals and value != "null" and not value.startswith("["):
            cells += _labels(value)
        elif key.lstrip("+~").split(".")[0].split("/")[0] in {*KEYS, "hydra"}:
            found.append(word)
        else:
            cells += _labels(word) if not equals else [word]
    if cells and any(override.startswith("cells=") for override in found):
        raise ConfigError(f"{cells[0]}: name cells either as words or as cells=[...]")
    return [*found, *([f"cells=[{','.join(map(in_quotes, cells))}]"] if cells else [])]


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def _labels(text: str) -> list[str]:
    """Split at commas; a comma before a space is part of a label."""
    return re.split(r",(?! )", text)
