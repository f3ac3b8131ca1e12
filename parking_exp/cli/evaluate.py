"""`scripts/evaluate.py` and `parking-evaluate`: evaluate a trained agent."""

import re

from parking_exp.cli.command import for_each, run_command
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_run import OF_RECIPES, evaluate_run, validate_request


def main() -> None:
    """Run the command."""
    run_command("evaluate", for_each("evaluate", validate_request, evaluate_run), without_training_keys)


def without_training_keys(overrides: list[str]) -> list[str]:
    """Refuse keys of training, which options of `env` add to the config."""
    for override in overrides:
        if re.split(r"[=./]", override.lstrip("+~"))[0] in OF_RECIPES:
            raise ConfigError(
                f"{override} is a key of training; evaluate.py takes the keys of conf/evaluate.yaml and env.KEY"
            )
    return overrides
