"""`scripts/evaluate.py` and `parking-evaluate`: evaluate trained agents."""

from parking_exp.cli.command import run_command
from parking_exp.config.compose import compose_configs
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_run import TRAINING_KEYS, evaluate_runs
from parking_exp.terminal import program


def main() -> None:
    """Run the command."""
    run_command("evaluate", evaluate, read_overrides)


def evaluate(overrides: list[str], extra_config_dir: str | None) -> None:
    """Evaluate the agents of every config that the overrides define."""
    evaluate_runs(compose_configs("evaluate", overrides, extra_config_dir))


def read_overrides(words: list[str]) -> list[str]:
    """Return words as overrides: without an option of `env`, `env.KEY` changes the env of the
    agent's training.

    Raises:
        ConfigError: a word is a key of training, which options of `env` add to the config, or of
            the agent.
    """
    has_option = any(word.startswith("env=") for word in words)
    has_model_file = any(word.startswith("run=") and ".zip" in word for word in words)
    for word in words:
        key, _, value = word.lstrip("+~").partition("=")
        section = key.replace("/", ".").partition(".")[0]
        if section in TRAINING_KEYS or (section == "algorithm" and not has_model_file):
            raise ConfigError(
                f"{word} is a training key; {program('evaluate')} --help lists the keys of this "
                "command"
            )
        if f"{key}.".startswith("env.observation.") and not has_model_file:
            raise ConfigError(f"{word}: the observation is always that of the agent's training")
        if key == "env.simulator":
            raise ConfigError(f"{word}: choose it by simulator={value}")
        if key == "env.task" or (key == "env" and value.startswith("{")):
            raise ConfigError(
                f"{word}: choose an option by env=NAME, and change its keys by env.KEY=VALUE"
            )
    changes = ["algorithm."]
    if not has_option:
        changes.append("env.")
    return [f"++{word}" if word.startswith(tuple(changes)) else word for word in words]
