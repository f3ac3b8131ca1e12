"""Find trained agents: a run's models, and the pretrained policies of this package."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from parking_exp.config.allowlist import check_trust
from parking_exp.config.paths import directory_path, refuse_links
from parking_exp.config.schema import EnvConfig, RunConfig
from parking_exp.errors import DamagedModelError, ModelError, RunNotFoundError, did_you_mean
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_run
from parking_exp.runs.stored_config import CONFIG_FILE, read_config

if TYPE_CHECKING:
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

PRETRAINED = "pretrained"
PRETRAINED_DIR = Path(__file__).parents[1] / PRETRAINED
POLICY_FILE = "policy.safetensors"

ModelName = Literal["final", "best"]


@dataclass(frozen=True)
class Agent:
    """A trained agent on disk.

    Attributes:
        name: what it is called in sentences: `final model`, `pretrained agent parked`.
        config: what it was trained with.
        weights: a model as Stable-Baselines3 saves it, or the actor's weights alone.
        folder: where what is made of it goes.
        directory: its run directory; None of a pretrained one.
    """

    name: str
    config: RunConfig
    weights: Path
    folder: Path
    directory: RunDirectory | None = None

    def model(self, env: EnvConfig) -> "OffPolicyAlgorithm":
        """Return the model with its weights, for predicting in an env.

        Raises:
            ConfigError: a model of its class can't be restored exactly.
            ModelError: the weights are damaged, or are not those of its config.
        """
        from stable_baselines3.common.vec_env import DummyVecEnv

        from parking_exp.algorithms.build_model import build_model
        from parking_exp.algorithms.model_files import load_weights
        from parking_exp.algorithms.policy_files import load_policy
        from parking_exp.envs.highway import make_env

        model = build_model(self.config, DummyVecEnv([lambda: make_env(env)]), seed=0, for_training=False)
        if self.directory is None:
            load_policy(self.weights, model)
            return model
        try:
            load_weights(self.weights, model)
        except ModelError as error:
            ways = _ways_out(self.directory, self.weights.stem)
            if not isinstance(error, DamagedModelError):
                ways = f"put back the config.yaml that it was trained with, or {ways}"
            raise ModelError(f"{error}; {ways}") from error
        return model


def find_agent(run: str, output_dir: Path, model: ModelName = "final", *, trust: bool = False) -> Agent:
    """Find the agent that a run directory, an MLflow run id, `latest`, `pretrained` or `pretrained/NAME` means.

    Args:
        run: one of these.
        output_dir: where runs are looked for.
        model: which of a run's models.
        trust: whether its config may name classes that runs are not made of.

    Raises:
        ConfigError: its config can't be read.
        RunNotFoundError: nothing answers to `run`, or it has no such model yet.
        UntrustedError: its config would execute what runs are not made of.
    """
    if is_pretrained(run):
        if model != "final":
            raise RunNotFoundError(f"run={run}: a pretrained agent has one model; leave model={model} out")
        return _pretrained(run, output_dir)
    directory = find_run(run, output_dir, having=f"models/{model}.zip", others=[PRETRAINED, *_pretrained_runs()])
    weights = directory.models / f"{model}.zip"
    if not weights.exists():
        state = "is gone" if directory.status == "done" else "has not been made yet"
        raise RunNotFoundError(f"run={run}: {weights} {state}; {_ways_out(directory, model)}")
    config = directory.config()
    directory.check_links()
    if not trust:
        check_trust(config, directory.path / CONFIG_FILE)
    return Agent(f"{model} model", config, weights, directory.path, directory)


def load_model(
    run: str = PRETRAINED, output_dir: str | Path = "outputs", model: ModelName = "final", *, trust: bool = False
) -> "OffPolicyAlgorithm":
    """Return a trained agent's model, for `predict`, in the env that it was trained in.

    Args:
        run: run directory, MLflow run id, `latest`, `pretrained` or `pretrained/NAME`.
        output_dir: where runs are looked for.
        model: which of a run's models.
        trust: whether its config may name classes that runs are not made of.

    Raises:
        ConfigError: its config can't be read, or a model of its class can't be restored exactly.
        ModelError: the weights are damaged, or are not those of its config.
        RunNotFoundError: nothing answers to `run`, or it has no such model yet.
        UntrustedError: its config would execute what runs are not made of.
    """
    agent = find_agent(run, directory_path(output_dir), model, trust=trust)
    return agent.model(agent.config.env)


def is_pretrained(run: str) -> bool:
    """Whether a name means an agent of this package."""
    return run.partition("/")[0] == PRETRAINED


def pretrained_names() -> list[str]:
    """Return the names of the pretrained agents that this package has."""
    return sorted(folder.parent.name for folder in PRETRAINED_DIR.glob(f"*/{POLICY_FILE}"))


def _pretrained_runs() -> list[str]:
    return [f"{PRETRAINED}/{name}" for name in pretrained_names()]


def _pretrained(run: str, output_dir: Path) -> Agent:
    _, _, name = run.partition("/")
    name = name or "default"
    if name not in (names := pretrained_names()):
        hint = did_you_mean(run, _pretrained_runs())
        raise RunNotFoundError(f"run={run}: there is no such pretrained agent; there are {', '.join(names)}{hint}")
    folder = PRETRAINED_DIR / name
    config, results = read_config(folder, output_dir), output_dir / PRETRAINED / name
    refuse_links([results.parent, results, *results.rglob("*")], output_dir)
    return Agent(f"pretrained agent {name}", config, folder / POLICY_FILE, results)


def _ways_out(directory: RunDirectory, model: str) -> str:
    """Return what to enter where a run's model is missing or damaged."""
    other = "best" if model == "final" else "final"
    ways = [f"try model={other}"] if (directory.models / f"{other}.zip").exists() else []
    if directory.status != "done":
        return (ways or ["let it train first"])[0]
    return ", or ".join([*ways, f"delete {directory.path} to train it afresh"])
