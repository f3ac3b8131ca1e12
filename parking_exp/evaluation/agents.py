"""Find trained agents: a run's models, and the pretrained policies of this package."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from parking_exp.config.allowlist import check_trust
from parking_exp.config.paths import absolute_path, refuse_links
from parking_exp.config.schema import OutputConfig, RunConfig
from parking_exp.config_model import NonEmptyText
from parking_exp.errors import ModelError, RunNotFoundError
from parking_exp.phrases import plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import LATEST, find_run, find_runs_below
from parking_exp.runs.run_files import CONFIG_FILE, read_config
from parking_exp.runs.run_state import read_state
from parking_exp.runs.state_tables import run_name
from parking_exp.runs.trained_here import was_trained_here
from parking_exp.terminal import command_of, say

if TYPE_CHECKING:
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    from parking_exp.tasks.task import Policy, Task

PRETRAINED = "pretrained"
PRETRAINED_DIR = Path(__file__).parents[1] / PRETRAINED
POLICY_FILE = "policy.safetensors"
PRETRAINED_NAMES = sorted(file.parent.name for file in PRETRAINED_DIR.glob(f"*/{POLICY_FILE}"))

ModelName = Literal["final", "best"]


@dataclass(frozen=True)
class Agent:
    """An agent on disk."""

    name: str  # as printed: `final model`, `pretrained agent default`
    config: RunConfig
    # A model as Stable-Baselines3 saves it, or `POLICY_FILE`; of a scripted policy, a zip of its
    # config.
    weights: Path
    folder: Path  # where its evaluations and exports are written
    directory: RunDirectory | None = None  # its run directory; None if there is none

    @property
    def label(self) -> str:
        """Name for tables, the same for all runs of a cell."""
        if self.directory is None:
            return self.name
        label = read_state(self.directory.path).label
        return f"{self.config.experiment_name}: {label} ({self.config.cell_key})"

    def policy(self, task: "Task") -> "Policy":
        """Return the policy, without exploration, for a task.

        Raises:
            ParkingError: see `load_model`.
        """
        from parking_exp.algorithms.build_model import GreedyPolicy
        from parking_exp.tasks.scripted_policy import build_scripted_policy

        if self.config.is_trained:
            return GreedyPolicy(self.load(task))
        algorithm = self.config.algorithm
        return build_scripted_policy(algorithm.target, algorithm.arguments, task, self.config.seed)

    def load(self, task: "Task") -> "OffPolicyAlgorithm":
        """Load the model with its weights, for predicting in a task.

        It raises what `load_model` does. The model's env is one of the task.
        """
        if not self.config.is_trained:
            raise ModelError(
                f"algorithm={self.config.algorithm.name} is not trained, so it has no model; "
                f"`{command_of('evaluate')}` evaluates it"
            )
        from parking_exp.algorithms.build_model import build_model
        from parking_exp.tasks.registry import make_task

        env = task.prediction_env()
        # The agent has the features it was trained with, also on another lot.
        with closing(make_task(self.config.env)) as trained_on:
            model = build_model(self.config, trained_on, env, seed=0, for_training=False)
        self.load_into(model)
        return model

    def load_into(self, model: "OffPolicyAlgorithm", *, networks_only: bool = False) -> None:
        """Load this agent's weights into a model.

        Which weights are loaded depends on the file:

        - a file of a run: all
        - `policy.safetensors`: actor and critics
        - a file of plain Stable-Baselines3: the actor

        Args:
            model: the model, with the same networks.
            networks_only: leave the optimizers of the model as they are.

        Raises:
            ModelError: the weights are damaged, or do not fit.
        """
        from parking_exp.algorithms.model_files import load_actor, load_networks, load_weights
        from parking_exp.algorithms.policy_files import load_policy

        if self.weights.name == POLICY_FILE:
            load_policy(self.weights, model)
        elif self.directory is None:
            load_actor(self.weights, model)
        elif networks_only:
            load_networks(self.weights, model)
        else:
            load_weights(self.weights, model)


class AgentRequest(OutputConfig):
    """The keys by which `evaluate` and `export` name an agent."""

    run: NonEmptyText
    model: ModelName
    trust: bool


def find_agent(
    run: str,
    output_dir: Path,
    model: ModelName = "final",
    *,
    trust: bool = False,
    key: str = "run",
) -> Agent:
    """Find a trained agent.

    For arguments and errors see `load_model`. `key` is the config key that names the run; messages
    begin with it.
    """
    if is_pretrained(run):
        return _find_pretrained(run, output_dir, model, key)
    other_names = [PRETRAINED, *(f"{PRETRAINED}/{name}" for name in PRETRAINED_NAMES)]
    directory = find_run(
        run, output_dir, required_file=f"models/{model}.zip", other_names=other_names, key=key
    )
    weights = directory.models / f"{model}.zip"
    if not weights.is_file():
        raise RunNotFoundError(
            f"{key}={run}: {weights} does not exist; the run is {directory.status}"
        )
    directory.check_links()
    config = directory.read_config()
    if run == LATEST:
        setting = f"{key}={LATEST}"
        name = run_name(read_state(directory.path))
        say(f"{setting:<15}{name} of experiment={config.experiment_name}")
    if not trust and not was_trained_here(directory.path):
        check_trust(config, directory.path / CONFIG_FILE)
    return Agent(f"{model} model", config, weights, directory.path, directory)


def find_agents(
    run: str, output_dir: Path, model: ModelName = "final", *, trust: bool = False
) -> list[Agent]:
    """Find the agent of a run, or the agents of all finished runs in a folder."""
    paths = [] if is_pretrained(run) else find_runs_below(absolute_path(run))
    if not paths:
        return [find_agent(run, output_dir, model, trust=trust)]
    finished = [path for path in paths if RunDirectory(path).status == "done"]
    if not finished:
        raise RunNotFoundError(f"run={run}: none of its {plural(len(paths), 'run')} is finished")
    n_unfinished = len(paths) - len(finished)
    if n_unfinished:
        say(f"left out       {plural(n_unfinished, 'unfinished run')}")
    return [find_agent(str(path), output_dir, model, trust=trust) for path in finished]


def load_model(
    run: str = PRETRAINED,
    output_dir: str | Path = "outputs",
    model: ModelName = "final",
    *,
    trust: bool = False,
) -> "OffPolicyAlgorithm":
    """Return a trained agent's model, for `predict`, in the env that it was trained in.

    Args:
        run: run directory, MLflow run id, `latest`, `pretrained` or `pretrained/NAME`.
        output_dir: the directory in which runs are looked for.
        model: which of a run's models.
        trust: accept classes in its config that are not on the list of known ones. A run that you
            trained here does not need it.

    Raises:
        ConfigError: its config can't be read, or a model of its class can't be restored exactly.
        ModelError: the weights are damaged, or do not fit the config; or it has none.
        RunNotFoundError: there is no such run, or it has no such model yet.
        UntrustedError: its config names an unknown class, or a symbolic link leads out of its
            directory.
    """
    from parking_exp.tasks.registry import make_task

    folder = absolute_path(output_dir)
    agent = find_agent(run, folder, model, trust=trust)
    return agent.load(make_task(agent.config.env))


def is_pretrained(run: str) -> bool:
    """Return whether a name means an agent of this package."""
    return run.partition("/")[0] == PRETRAINED


def _find_pretrained(run: str, output_dir: Path, model: ModelName, key: str) -> Agent:
    name = run.partition("/")[2] or "default"
    if name not in PRETRAINED_NAMES:
        raise RunNotFoundError(
            f"{key}={run}: no such pretrained agent; choose from {', '.join(PRETRAINED_NAMES)}"
        )
    if model != "final":
        raise RunNotFoundError(
            f"{key}={run}: a pretrained agent has no model={model}; use model=final"
        )
    folder = PRETRAINED_DIR / name
    config = read_config(folder, output_dir)
    results = output_dir / PRETRAINED / name
    refuse_links([results.parent, results, *results.rglob("*")], output_dir)
    return Agent(f"pretrained agent {name}", config, folder / POLICY_FILE, results)
