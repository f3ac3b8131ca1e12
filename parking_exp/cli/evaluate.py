"""`scripts/evaluate.py` and `parking-evaluate`: evaluate trained agents."""

from parking_exp.cli.command import run_command
from parking_exp.config.compose import compose_configs
from parking_exp.config.overrides import without_quotes
from parking_exp.config.paths import default_uri
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_run import evaluate_runs
from parking_exp.evaluation.evaluation_request import KEYS_LEFT_OUT, EvaluationRequest
from parking_exp.evaluation.sb3_model_files import is_model_file
from parking_exp.runs.directory import RunDirectory
from parking_exp.terminal import command_of, say
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import sync_hint, try_sync


def main() -> None:
    """Run the command."""
    run_command("evaluate", evaluate, read_overrides)


def evaluate(overrides: list[str], extra_config_dir: str | None) -> None:
    """Evaluate the agents of every config that the overrides define."""
    evaluate_runs(compose_configs("evaluate", overrides, extra_config_dir), sync_results)


def sync_results(request: EvaluationRequest, directory: RunDirectory) -> None:
    """Sync a run with `tracking.uri`, or with the embedded store of the output directory.

    A run directory may be foreign: nothing is sent to the store that it names.
    """
    tracked_in = directory.tracking_uri
    uri = request.tracking.uri
    if not request.tracking.mlflow or (uri is None and tracked_in is None):
        return
    store = Store(uri or default_uri(request.output_path), directory.output_dir)
    if uri is None and not store.tracks(directory):
        say(
            f"not stored     the run is tracked in {tracked_in}, not in the store of "
            f"output_dir={request.output_path}; tracking.uri={tracked_in} sends the results "
            "there"
        )
        return
    problem = try_sync(directory, store)
    if problem is not None:
        say(f"not stored     {problem}; {sync_hint(directory.output_dir, store.uri)}")


def read_overrides(words: list[str]) -> list[str]:
    """Return words as overrides; `env.KEY` without `env` changes the env of the agent's training.

    Raises:
        ConfigError: an evaluation can't follow a word.
    """
    _check_words(words)
    changed_sections = ["algorithm."]
    if not any(word.startswith("env=") for word in words):
        changed_sections.append("env.")
    overrides = []
    for word in words:
        is_change = word.startswith(tuple(changed_sections))
        overrides.append(f"++{word}" if is_change else word)
    return overrides


def _names_model_file(word: str) -> bool:
    """Return whether a word is `run=` with a model file among its runs."""
    key, _, value = word.partition("=")
    runs = [without_quotes(run.strip()) for run in value.split(",")]
    return key == "run" and any(is_model_file(run) for run in runs)


def _check_words(words: list[str]) -> None:
    """Refuse words that an evaluation can't follow.

    Raises:
        ConfigError: a word sets a key of training, the observation (which is the agent's),
            `env.simulator` (`simulator` chooses it), or an env in place of an option.
    """
    has_model_file = any(_names_model_file(word) for word in words)
    for word in words:
        key, _, value = word.lstrip("+~").partition("=")
        section = key.replace("/", ".").partition(".")[0]
        if section in KEYS_LEFT_OUT or (section == "algorithm" and not has_model_file):
            raise ConfigError(
                f"{word} is a training key; {command_of('evaluate')} --help lists the keys of this "
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
