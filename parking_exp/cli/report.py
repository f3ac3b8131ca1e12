"""`scripts/report.py` and `parking-report`: compare the cells of an experiment."""

import re

from parking_exp.cli.command import rename_experiment, run_command
from parking_exp.config.compose import compose_configs
from parking_exp.config.overrides import in_quotes, numbers_as_text, without_quotes
from parking_exp.errors import ConfigError
from parking_exp.garbage_collection import no_garbage_collection
from parking_exp.reports.report_request import KEYS, validate_report


def main() -> None:
    """Run the command."""
    run_command("report", report, read_overrides)


def report(overrides: list[str], extra_config_dir: str | None) -> None:
    """Write one report."""
    configs = compose_configs("report", overrides, extra_config_dir)
    if len(configs) > 1:
        raise ConfigError(
            "a report takes one value for each key; use name=... to write a second report"
        )
    request = validate_report(configs[0])
    # It imports pandas and matplotlib: after the check.
    from parking_exp.reports.make_report import make_report

    with no_garbage_collection(freeze=True):  # the objects of a report live to its end
        make_report(request)


def read_overrides(words: list[str]) -> list[str]:
    """Convert the words after `report.py` to overrides; words that set no known key name cells.

    Labels of cells have commas, equal signs and spaces, which have another meaning for Hydra.
    """
    overrides = []
    labels = []
    for word in words:
        key, equals, value = word.partition("=")
        if key == "experiment" and equals and value != "null":
            listed = value.removeprefix("[").removesuffix("]").split(",")
            names = [name.strip() for name in listed]
            overrides.append(f"{key}={_quote_list(names)}")
        elif key in {"baseline", "contrast", "from", "export"} and value not in {"", "null"}:
            overrides.append(f"{key}={in_quotes(without_quotes(value))}")
        elif key == "cells" and equals and value != "null" and not value.startswith("["):
            labels += _split_labels(value)
        elif key == "cells" and equals:
            overrides.append(f"{key}={numbers_as_text(value)}")
        elif re.split(r"[./]", key.lstrip("+~"))[0] in {*KEYS, "hydra"}:
            overrides.append(word)
        else:
            labels += [word] if equals else _split_labels(word)
    if labels:
        if any(override.startswith("cells=") for override in overrides):
            raise ConfigError(f"{labels[0]}: name cells either as words or as cells=[...]")
        overrides.append(f"cells={_quote_list(labels)}")
    return rename_experiment(overrides)


def _quote_list(values: list[str]) -> str:
    """Write a list of strings in Hydra's grammar."""
    return f"[{','.join(map(in_quotes, values))}]"


def _split_labels(text: str) -> list[str]:
    """Split at commas; a comma before a space is part of a label."""
    return re.split(r",(?! )", text)
