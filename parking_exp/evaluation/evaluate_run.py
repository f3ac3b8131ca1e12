"""Evaluate stored runs: rates with intervals, a table of episodes, a video."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from pydantic import NonNegativeInt

from parking_exp.config.cell_labels import find_factors, label_factors, setting, settings_of
from parking_exp.config.paths import default_uri, is_same_store, resolved
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig, StoreConfig
from parking_exp.config.validate import SWEEP_KEYS, check, parse, refuse
from parking_exp.config_model import ConfigModel, EpisodeSeed, Name, NumberOfEpisodes
from parking_exp.errors import ConfigError, VideoError, plural
from parking_exp.evaluation.agents import Agent, AgentRequest, find_agents, is_pretrained
from parking_exp.runs.directory import EVALUATIONS, SUMMARY_FILE, RunDirectory, write_summary
from parking_exp.runs.metric_logs import EPISODES_FILE
from parking_exp.tasks.registry import EnvConfig, make_task
from parking_exp.terminal import say

TRAINING_KEYS = ({*RunConfig.model_fields} | SWEEP_KEYS) - {"env", "output_dir", "tracking"}
"""Keys of the recipe that an option of `env` may set."""
DEFAULT_EPISODES, PRETRAINED_EPISODES = (
    100,
    20,
)  # by default; the cards of pretrained agents have the rates of 500


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
    name: Name | None
    tracking: ResultsTracking
    env: dict[str, Any] | None = (
        None  # an option of `env` with its changes, or changes of the env of training
    )

    @property
    def seeds(self) -> range:
        """Seeds of the episodes."""
        n_episodes = self.episodes or (
            PRETRAINED_EPISODES if is_pretrained(self.run) else DEFAULT_EPISODES
        )
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
        return self.agent.folder / EVALUATIONS / (self.request.name or self.default_name)

    @property
    def default_name(self) -> str:
        """Name of the folder if the request has none."""
        env, request = self.env, self.request
        name = f"{env.name}-{request.model}-seeds-{request.seeds[0]}-{request.seeds[-1]}"
        if env.simulator != env.simulators[-1]:
            name += f"-{env.simulator}"
        if self.changes:
            # the same option with other values is another evaluation
            name += f"-{short_hash(env.model_dump())}"
        return name

    @property
    def env_text(self) -> str:
        """Name of the env, with changes to the training env in brackets."""
        if not self.changes or "name" in self.changes:
            return self.env.name
        return (
            f"{self.env.name} "
            f"({', '.join(f'{key}={setting(value)}' for key, value in self.changes.items())})"
        )

    def settings(self, env: EnvConfig) -> dict[str, Any]:
        """Return the request's settings with an env, as dotted keys, without what belongs to the
        agent.
        """
        requested = self.request.model_dump(
            include={"model", "episodes", "first_scene", "simulator"}
        )
        return settings_of(
            {**requested, "env": env.model_dump(exclude={"simulator", *env.agent_keys})}
        )

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of `env` that differ from the training env, except the simulator, with their
        values.
        """
        now, before = self.settings(self.env), self.settings(self.agent.config.env)
        return {
            key.removeprefix("env."): now.get(key)
            for key in now | before
            if now.get(key) != before.get(key)
        }


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Validate a composed config."""
    request = parse(EvaluationRequest, config, without=TRAINING_KEYS)
    n_episodes = len(request.seeds)
    if request.env and "task" in request.env:
        check(EvaluatedEnv, {"env": request.env})
    if request.video > n_episodes:
        raise ConfigError(f"video={request.video} is above episodes; use at most {n_episodes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video; set video=N as well")
    return request


def evaluate_runs(configs: Sequence[DictConfig]) -> None:
    """Evaluate the agents that each config names, print and store their results; several make a
    table.
    """
    requests = [validate_request(config) for config in configs]
    find = cache(find_agents)  # once, for all the envs that they are evaluated on
    evaluations = [
        Evaluation(request, agent, choose_env(request, agent))
        for request in requests
        for agent in find(request.run, request.output_path, request.model, trust=request.trust)
    ]
    if len({resolved(evaluation.folder) for evaluation in evaluations}) < len(evaluations):
        raise ConfigError(
            "two of these evaluations would share a folder; leave name out, and name each run once"
        )
    rates = [_evaluate(evaluation) for evaluation in evaluations]
    if len(evaluations) > 1:
        say("", *compare(evaluations, rates).split("\n"))


def compare(evaluations: Sequence[Evaluation], rates: Sequence[dict[str, float]]) -> str:
    """Return a table of mean rates by cell and evaluated env, with the lowest success of a run."""
    import pandas as pd

    configs = [
        settings_of(evaluation.agent.config.model_dump(exclude={"seed"}))
        for evaluation in evaluations
    ]
    cells = _label(
        configs,
        [evaluation.agent.config.experiment_name for evaluation in evaluations],
        evaluations[0].agent.name,
    )
    # Changes are named, too, where there is one evaluation of each agent.
    asked = [evaluation.settings(evaluation.env) for evaluation in evaluations]
    unchanged = [evaluation.settings(evaluation.agent.config.env) for evaluation in evaluations]
    changes = _label([*asked, *unchanged], [""] * 2 * len(asked), "env of training")[: len(asked)]
    percent = [
        {key: 100 * rate for key, rate in row.items() if key.endswith("_rate")} for row in rates
    ]
    frame = pd.DataFrame(percent).rename(columns=lambda key: key.removesuffix("_rate"))
    groups = frame.groupby(
        [pd.Series(cells, name="agent"), pd.Series(changes, name="evaluated on")], sort=False
    )
    table = groups.mean().add_suffix(", %")
    table.insert(0, "runs", groups.size())
    table.insert(2, "lowest success, %", groups["success"].min())
    return table.reset_index().to_string(index=False, float_format="{:.2f}".format, na_rep="")


def _label(
    settings: Sequence[dict[str, Any]], experiments: Sequence[str], default: str
) -> list[str]:
    """Return what differs between settings; the default where nothing does."""
    factors, values = find_factors(settings, experiments)
    return [label_factors(factors, row) or default for row in values]


def _evaluate(evaluation: Evaluation) -> dict[str, float]:
    """Evaluate an agent, print, write and store the results, and return the rates and means."""
    from parking_exp.algorithms.build_model import greedy_policy, torch_settings
    from parking_exp.evaluation.evaluate_policy import describe, evaluate, intervals, summarise
    from parking_exp.evaluation.evaluation_progress import EvaluationProgress
    from parking_exp.evaluation.video import record

    request, agent, env, folder = (
        evaluation.request,
        evaluation.agent,
        evaluation.env,
        evaluation.folder,
    )
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")
    task = make_task(env)
    policy, seeds = greedy_policy(agent.model(env)), request.seeds
    with torch_settings(agent.config), EvaluationProgress(len(seeds), env.name) as progress:
        episodes = evaluate(policy, task, seeds, progress.update)
    folder.mkdir(parents=True, exist_ok=True)
    for outdated in (folder / SUMMARY_FILE, *folder.glob("video.*")):
        outdated.unlink(missing_ok=True)
    episodes.to_csv(folder / EPISODES_FILE, index=False)
    rates = summarise(episodes, task.metrics)
    say(
        f"{agent.name} on {plural(len(seeds), 'episode')} of {evaluation.env_text}, from seed "
        f"{request.first_scene}, "
        f"simulated by {env.simulator}",
        *describe(episodes, task.metrics).split("\n"),
    )
    if request.video:
        try:
            record(policy, task, seeds[: request.video], folder / "video.mp4", request.gif)
        except VideoError as error:
            say(str(error))
        for path in sorted(folder.glob("video.*")):
            say(f"video          {path}")
    settings = {
        "simulator": env.simulator,
        "model": request.model,
        "first_scene": request.first_scene,
    }
    numbers = {"episodes": len(episodes), **rates, "intervals": intervals(episodes, task.metrics)}
    write_summary(folder, {"env": env.name, "env_config": env.model_dump(), **settings, **numbers})
    task.close()
    if agent.directory is not None and request.tracking.mlflow:
        _store(request, agent.directory)
    say(f"results        {folder}")
    return rates


def _store(request: EvaluationRequest, directory: RunDirectory) -> None:
    """Send the results to the run's store: `tracking.uri`, or the embedded store of the output
    directory.

    A run directory may be foreign: nothing is sent to the store that it names.
    """
    from parking_exp.tracking.mirror import sync_hint, try_mirror
    from parking_exp.tracking.store import Store

    tracked_in, output_dir = directory.tracking_uri, request.output_path
    uri = request.tracking.uri or default_uri(output_dir)
    if request.tracking.uri is None and (tracked_in is None or not is_same_store(tracked_in, uri)):
        if tracked_in is not None:
            say(
                f"not stored     the run is tracked in {tracked_in}, not in the store of "
                f"output_dir={output_dir}; "
                f"tracking.uri={tracked_in} sends the results there"
            )
        return
    if problem := try_mirror(directory, Store(uri, directory.output_dir)):
        say(f"not stored     {problem}; {sync_hint(directory.output_dir, uri)}")


def choose_env(request: EvaluationRequest, agent: Agent) -> EnvConfig:
    """Return the env that an agent is evaluated on, with the agent's observation; raise ConfigError
    if it is wrong.
    """
    trained_on, asked = agent.config.env, request.env or {}
    merged: Any = (
        asked
        if "task" in asked
        else OmegaConf.to_container(OmegaConf.merge(trained_on.model_dump(), asked))
    )
    if merged["task"] != trained_on.task:
        raise ConfigError(
            f"env={merged.get('name')}: the agent was trained on env={trained_on.name}, which is "
            "another task"
        )
    env = check(
        EvaluatedEnv, {"env": merged | trained_on.model_dump(include={*trained_on.agent_keys})}
    ).env
    if request.simulator not in (None, *env.simulators):
        raise ConfigError(
            f"simulator={request.simulator}: env={env.name} has {' and '.join(env.simulators)}"
        )
    simulator = request.simulator or env.simulators[-1]  # by default the task's reference
    if simulator != env.simulator:
        env = env.model_copy(update={"simulator": simulator})
    if request.seeds.stop > env.training_seeds.start:
        highest = env.training_seeds.start - len(request.seeds)
        raise ConfigError(
            f"first_scene={request.first_scene} overlaps the training seeds; it can be at most "
            f"{highest}"
        )
    refuse([*env.problems(), *make_task(env).problems()])
    return env
