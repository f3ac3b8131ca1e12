"""`scripts/evaluate.py` and `parking-evaluate`: evaluate trained agents."""

import re

from parking_exp.cli.command import run_command
from parking_exp.config.compose import composed
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_run import OF_RECIPES, evaluate_runs


def main() -> None:
    """Run the command."""
    run_command("evaluate", evaluate, as_overrides)


def evaluate(overrides: list[str], extra_config_dir: str | None) -> None:
    """Evaluate the agents of every config that the overrides define."""
    evaluate_runs(composed("evaluate", overrides, extra_config_dir))


def as_overrides(words: list[str]) -> list[str]:
    """Return words as overrides: without an option of `env`, `env.KEY` changes the env of the agent's training.

    Raises:
        ConfigError: a word is a key of training, which options of `env` add to the config.
    """
    has_option = any(word.startswith("env=") for word in words)
    for word in words:
        key = re.split(r"=", word.lstrip("+~"), maxsplit=1)[0]
        if re.split(r"[./]", key)[0] in OF_RECIPES:
            raise ConfigError(
                f"{word} is a key of training; evaluate.py takes the keys of conf/evaluate.yaml and env.KEY"
            )
        if f"{key}.".startswith("env.observation."):
            raise ConfigError(f"{word}: the observation is the one that the agent was trained with")
    return words if has_option else [f"++{word}" if word.startswith("env.") else word for word in words]
