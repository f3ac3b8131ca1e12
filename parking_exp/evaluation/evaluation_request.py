"""The config of `scripts/evaluate.py`, and the env that it makes of an agent's."""

from typing import Any

from omegaconf import DictConfig, OmegaConf
from pydantic import NonNegativeInt

from parking_exp.config.schema import RunConfig, StoreConfig
from parking_exp.config.validate import SWEEP_KEYS, parse_config, parse_plain, raise_problems
from parking_exp.config_model import ConfigModel, EpisodeSeed, Name, NumberOfEpisodes
from parking_exp.errors import ConfigError
from parking_exp.evaluation.agents import Agent, AgentRequest, is_pretrained
from parking_exp.evaluation.sb3_model_files import is_model_file
from parking_exp.tasks.registry import EnvConfig

KEYS_LEFT_OUT = ({*RunConfig.model_fields} | SWEEP_KEYS) - {
    "env",
    "algorithm",
    "output_dir",
    "tracking",
}
"""Keys of a run. Options of `env` may set them for training; an evaluation ignores them."""
DEFAULT_EPISODES = 100
PRETRAINED_EPISODES = 20  # the cards of pretrained agents have the rates of 500


class ResultsTracking(StoreConfig):
    """Where results go besides the run directory."""

    mlflow: bool


class EvaluatedEnv(ConfigModel):
    """The env that an agent is evaluated on."""

    env: EnvConfig


class EvaluationRequest(AgentRequest):
    """The config of scripts/evaluate.py."""

    episodes: NumberOfEpisodes | None
    first_scene: EpisodeSeed
    simulator: str | None
    video: NonNegativeInt
    gif: bool
    replay: bool
    name: Name | None
    tracking: ResultsTracking
    # An option of `env` with its changes, or changes of the env of training.
    env: dict[str, Any] | None = None
    # The algorithm of a model file; options of `env` also bring one, for training.
    algorithm: dict[str, Any] | None = None

    @property
    def seeds(self) -> range:
        """Seeds of the episodes."""
        default = PRETRAINED_EPISODES if is_pretrained(self.run) else DEFAULT_EPISODES
        n_episodes = self.episodes or default
        return range(self.first_scene, self.first_scene + n_episodes)


def validate_evaluation(config: DictConfig) -> EvaluationRequest:
    """Return the checked request of `scripts/evaluate.py`.

    Raises:
        ConfigError: a key is wrong, or keys do not fit together.
    """
    request = parse_config(EvaluationRequest, config, without=KEYS_LEFT_OUT)
    n_episodes = len(request.seeds)
    if request.env and "task" in request.env:
        parse_plain(EvaluatedEnv, {"env": request.env})
    elif is_model_file(request.run):
        raise ConfigError(
            f"run={request.run}: name the env that the model is evaluated on, such as env=parking"
        )
    if is_model_file(request.run) and request.model != "final":
        raise ConfigError(f"run={request.run}: a file has no model={request.model}; leave it out")
    if request.video > n_episodes:
        raise ConfigError(f"video={request.video} is above episodes; use at most {n_episodes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video; set video=N as well")
    return request


def choose_env(request: EvaluationRequest, agent: Agent) -> EnvConfig:
    """Return the env that an agent is evaluated on, with the agent's observation.

    Raises:
        ConfigError: its keys are wrong, or it is of another task.
    """
    trained_on = agent.config.env
    requested: Any = request.env or {}
    if "task" not in requested:  # changes of the env of training
        raise_problems(trained_on.change_problems(requested))
        merged = OmegaConf.merge(trained_on.model_dump(), requested)
        requested = OmegaConf.to_container(merged)
    if requested["task"] != trained_on.task:
        raise ConfigError(
            f"env={requested.get('name')}: the agent was trained on env={trained_on.name}, which "
            "is another task"
        )
    agent_part = trained_on.model_dump(include={*trained_on.agent_keys})
    env = parse_plain(EvaluatedEnv, {"env": requested | agent_part}).env
    simulator = request.simulator or env.reference_simulator
    if simulator not in env.simulators:
        raise ConfigError(
            f"simulator={simulator}: env={env.name} has {' and '.join(env.simulators)}"
        )
    if simulator != env.simulator:
        env = env.model_copy(update={"simulator": simulator})
    overlap = env.overlap_problem("first_scene", request.first_scene, len(request.seeds))
    if overlap is not None:
        raise ConfigError(overlap)
    return env
