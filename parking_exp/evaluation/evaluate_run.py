"""Evaluate stored runs: rates with intervals, a table of episodes, a video."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from parking_exp.config.cell_labels import can_matter, cell_labels, find_factors, settings_of
from parking_exp.config.paths import default_uri, is_same_store
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig, StoreConfig
from parking_exp.config.validate import SWEEP_KEYS, check, parse, refuse
from parking_exp.config_model import TRAINING_SEEDS_START, ConfigModel, Count, EpisodeSeed, Name, NumberOfEpisodes
from parking_exp.errors import ConfigError, VideoError, plural
from parking_exp.evaluation.agents import Agent, AgentRequest, find_agents, is_pretrained
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import EPISODES_FILE
from parking_exp.tasks.env_config import EnvConfig
from parking_exp.tasks.registry import make_task
from parking_exp.terminal import Screen, say

TRAINING_KEYS = ({*RunConfig.model_fields} | SWEEP_KEYS) - {"env", "output_dir", "tracking"}
"""Keys of the recipe that an option of `env` may set."""
EPISODES, PRETRAINED_EPISODES = 100, 20  # by default; the cards of pretrained agents have the rates of 500


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
    video: Count
    gif: bool
    name: Name | None
    tracking: ResultsTracking
    env: dict[str, Any] | None = None  # an option of `env` with its changes, or changes of the env of training

    @property
    def seeds(self) -> range:
        """Seeds of the episodes."""
        n_episodes = self.episodes or (PRETRAINED_EPISODES if is_pretrained(self.run) else EPISODES)
        return range(self.first_scene, self.first_scene + n_episodes)


@dataclass(frozen=True)
class Evaluation:
    """An agent, and what it is evaluated on."""

    request: EvaluationRequest
    agent: Agent
    env: EnvConfig

    @property
    def folder(self) -> Path:
        """Folder of the results."""
        return self.agent.folder / "evaluations" / (self.request.name or _folder_name(self))

    def settings(self, env: EnvConfig) -> dict[str, Any]:
        """Return what was asked for, with an env: dotted keys without what belongs to the agent."""
        asked = self.request.model_dump(include={"model", "episodes", "first_scene", "simulator"})
        return settings_of({**asked, "env": env.model_dump(exclude={"simulator", *env.agent_keys})})


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Validate a composed config."""
    request = parse(EvaluationRequest, config, without=TRAINING_KEYS)
    n_episodes = len(request.seeds)
    if request.env and "task" in request.env:
        check(EvaluatedEnv, {"env": request.env})
    if request.video > n_episodes:
        raise ConfigError(f"video={request.video} is above episodes; the closest valid choice is {n_episodes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video; set video=N as well")
    if request.seeds.stop > TRAINING_SEEDS_START:
        highest = TRAINING_SEEDS_START - n_episodes
        raise ConfigError(f"first_scene={request.first_scene} reaches into the seeds of training; at most {highest}")
    return request


def evaluate_runs(configs: Sequence[DictConfig]) -> None:
    """Evaluate the agents that each config names, print and store their results; several make a table."""
    requests = [validate_request(config) for config in configs]
    find = cache(find_agents)  # once, for all the envs that they are evaluated on
    evaluations = [
        Evaluation(request, agent, evaluated_env(request, agent))
        for request in requests
        for agent in find(request.run, request.output_path, request.model, trust=request.trust)
    ]
    if len({evaluation.folder for evaluation in evaluations}) < len(evaluations):
        raise ConfigError("these are several evaluations of one agent, each with a folder of its own; leave name out")
    rates = [_evaluate_and_store(evaluation) for evaluation in evaluations]
    if len(evaluations) > 1:
        say("", *comparison(evaluations, rates).split("\n"))


def comparison(evaluations: Sequence[Evaluation], rates: Sequence[dict[str, float]]) -> str:
    """Return a table of mean rates by cell and evaluated env, with the lowest success of a run."""
    import pandas as pd

    configs = [settings_of(evaluation.agent.config.model_dump(exclude={"seed"})) for evaluation in evaluations]
    cells = _labels(
        configs, [evaluation.agent.config.experiment_name for evaluation in evaluations], evaluations[0].agent.name
    )
    # Changes are named, too, where there is one evaluation of each agent.
    asked = [evaluation.settings(evaluation.env) for evaluation in evaluations]
    unchanged = [evaluation.settings(evaluation.agent.config.env) for evaluation in evaluations]
    changes = _labels([*asked, *unchanged], [""] * 2 * len(asked), "env of training")[: len(asked)]
    percent = [{key: 100 * rate for key, rate in row.items() if key.endswith("_rate")} for row in rates]
    frame = pd.DataFrame(percent).rename(columns=lambda key: key.removesuffix("_rate"))
    groups = frame.groupby([pd.Series(cells, name="agent"), pd.Series(changes, name="evaluated on")], sort=False)
    table = groups.mean().add_suffix(", %")
    table.insert(0, "runs", groups.size())
    table.insert(2, "lowest success, %", groups["success"].min())
    return table.reset_index().to_string(index=False, float_format="{:.2f}".format, na_rep="")


def _labels(settings: Sequence[dict[str, Any]], experiments: Sequence[str], default: str) -> list[str]:
    """Return what differs between settings; equal ones have equal labels, a single one the default."""
    keys = [
        (name, tuple(sorted(item for item in config.items() if can_matter(item[0]))))
        for name, config in zip(experiments, settings, strict=True)
    ]
    distinct = dict(zip(keys, settings, strict=True))
    factors, values = find_factors([*distinct.values()], [key[0] for key in distinct])
    labels = cell_labels(factors, values, [default] * len(distinct)) if len(distinct) > 1 else [default]
    label_of = dict(zip(distinct, labels, strict=True))
    return [label_of[key] for key in keys]


def _evaluate_and_store(evaluation: Evaluation) -> dict[str, float]:
    directory, request = evaluation.agent.directory, evaluation.request
    if directory is not None:
        say(f"run directory  {directory.path}")
    rates = _evaluate(evaluation)
    if directory is not None and request.tracking.mlflow:
        _store(request, directory)
    say(f"results        {evaluation.folder}")
    return rates


def _evaluate(evaluation: Evaluation) -> dict[str, float]:
    from rich.progress import Progress

    from parking_exp.algorithms.build_model import greedy_policy, torch_settings
    from parking_exp.evaluation.evaluate_policy import describe, evaluate, intervals, summarise
    from parking_exp.evaluation.video import record

    request, agent, env, folder = evaluation.request, evaluation.agent, evaluation.env, evaluation.folder
    task = make_task(env)
    policy, seeds, screen = greedy_policy(agent.model(env)), request.seeds, Screen(stderr=True)
    with torch_settings(agent.config), Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
        shown = bar.add_task(f"{plural(len(seeds), 'episode')} of {env.name}", total=len(seeds))
        episodes = evaluate(policy, task, seeds, lambda finished: bar.update(shown, completed=finished))
    folder.mkdir(parents=True, exist_ok=True)
    for outdated in folder.glob("video.*"):
        outdated.unlink()
    episodes.to_csv(folder / EPISODES_FILE, index=False)
    chosen = {"simulator": env.simulator, "model": request.model, "first_scene": request.first_scene}
    rates = summarise(episodes, task.metrics)
    numbers = {"episodes": len(episodes), **rates, "intervals": intervals(episodes, task.metrics)}
    write_json(folder / "summary.json", {"env": env.name, "env_config": env.model_dump(), **chosen, **numbers})
    say(
        f"{agent.name} on {plural(len(seeds), 'episode')} of {_env_text(evaluation)}, from seed {request.first_scene}, "
        f"simulated by {env.simulator}",
        *describe(episodes, task.metrics).split("\n"),
    )
    if request.video:
        try:
            record(policy, task, seeds[: request.video], folder / "video.mp4", request.gif)
        except VideoError as error:
            say(str(error))
        say(*(f"video          {path}" for path in sorted(folder.glob("video.*"))))
    return rates


def _store(request: EvaluationRequest, directory: RunDirectory) -> None:
    """Send the results to the run's store: `tracking.uri`, or the embedded store of the output directory.

    A run directory may be somebody else's: nothing is sent to the store that it names.
    """
    from parking_exp.tracking.mirror import sync_hint, try_mirror
    from parking_exp.tracking.store import Store

    tracked_in, output_dir = directory.tracking_uri, request.output_path
    uri = request.tracking.uri or default_uri(output_dir)
    if request.tracking.uri is None and (tracked_in is None or not is_same_store(tracked_in, uri)):
        if tracked_in is not None:
            say(
                f"not stored     the run is tracked in {tracked_in}, not in the store of output_dir={output_dir}; "
                f"tracking.uri={tracked_in} sends the results there"
            )
        return
    if problem := try_mirror(directory, Store(uri, directory.output_dir)):
        say(f"not stored     {problem}; {sync_hint(directory.output_dir, uri)}")


def evaluated_env(request: EvaluationRequest, agent: Agent) -> EnvConfig:
    """Return the env that an agent is evaluated on, with the agent's observation; ConfigError where that is wrong."""
    own, asked = agent.config.env, request.env or {}
    merged: Any = asked if "task" in asked else OmegaConf.to_container(OmegaConf.merge(own.model_dump(), asked))
    if merged["task"] != own.task:
        raise ConfigError(f"env={merged.get('name')}: the agent was trained on env={own.name}, which is another task")
    env = check(EvaluatedEnv, {"env": merged | own.model_dump(include={*own.agent_keys})}).env
    if (simulator := _simulator(request, env)) != env.simulator:
        env = env.model_copy(update={"simulator": simulator})
    refuse([*env.problems(), *make_task(env).problems()])
    return env


def _env_text(evaluation: Evaluation) -> str:
    """Return the name of an env, with what differs from an agent's own env of that name."""
    env, own = evaluation.env, evaluation.agent.config.env
    before, now = evaluation.settings(own), evaluation.settings(env)
    changes = [f"{key.removeprefix('env.')}={value}" for key, value in now.items() if before.get(key) != value]
    return f"{env.name} ({', '.join(changes)})" if changes and env.name == own.name else env.name


def _simulator(request: EvaluationRequest, env: EnvConfig) -> str:
    """Return what simulates the episodes: by default the task's reference."""
    if request.simulator not in (None, *env.simulators):
        raise ConfigError(f"simulator={request.simulator}: env={env.name} has {' and '.join(env.simulators)}")
    return request.simulator or env.simulators[-1]


def _folder_name(evaluation: Evaluation) -> str:
    request, env = evaluation.request, evaluation.env
    name = f"{env.name}-{request.model}-seeds-{request.seeds[0]}-{request.seeds[-1]}"
    if env.simulator != env.simulators[-1]:
        name += f"-{env.simulator}"
    own = evaluation.agent.config.env.model_dump()
    if env.model_dump() != own | ({"simulator": env.simulator} if "simulator" in own else {}):
        name += f"-{short_hash(env.model_dump())}"  # the same option with other values is another evaluation
    return name
