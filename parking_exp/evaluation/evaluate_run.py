"""Evaluate stored runs, of parking on real highway-env: rates with intervals, an episodes table, a video."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from parking_exp.config.cell_labels import label_cells, settings_of
from parking_exp.config.paths import default_uri, directory_path, is_same_store
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig, StoreConfig
from parking_exp.config.validate import check, parse, refuse
from parking_exp.config_model import TRAINING_SEEDS_START, ConfigModel, Count, EpisodeSeed, Name, NumberOfEpisodes
from parking_exp.errors import ConfigError, VideoError, plural
from parking_exp.evaluation.agents import Agent, AgentRequest, find_agents, is_pretrained
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.tasks.env_config import EnvConfig
from parking_exp.tasks.registry import make_task
from parking_exp.terminal import Screen, say

OF_RECIPES = {*RunConfig.model_fields} - {"env", "output_dir", "tracking"}  # keys that an option of `env` may set
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
    """Results of one agent.

    Attributes:
        config: of the agent's training.
        request: what was asked for.
        folder: where the results are.
        rates: means of the task's metrics over episodes.
    """

    config: RunConfig
    request: EvaluationRequest
    folder: Path
    rates: dict[str, float]


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Validate a composed config."""
    request = parse(EvaluationRequest, config, without=OF_RECIPES)
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


def evaluate_runs(configs: Sequence[DictConfig]) -> list[Evaluation]:
    """Evaluate the agents that each config names; print, and store; print a table if there are several."""
    requests = [validate_request(config) for config in configs]
    found = [
        (request, agent, evaluated_env(request, agent))
        for request in requests
        for agent in find_agents(request.run, directory_path(request.output_dir), request.model, trust=request.trust)
    ]
    results = [_evaluate_agent(*item) for item in found]
    if len(results) > 1:
        say("", *comparison(results).split("\n"))
    return results


def comparison(results: Sequence[Evaluation]) -> str:
    """Return a table of rates in percent by cell and by what the evaluations differ in: means and lowest of runs."""
    import pandas as pd

    cells = _labels([settings_of(result.config.model_dump(exclude={"seed"})) for result in results], "agent")
    others = {"run", "output_dir", "name", "tracking", "video", "gif"}
    asked = _labels([settings_of(result.request.model_dump(exclude=others)) for result in results], "env of training")
    rates = [{key: 100 * rate for key, rate in result.rates.items() if key.endswith("_rate")} for result in results]
    frame = pd.DataFrame(rates).rename(columns=lambda key: key.removesuffix("_rate"))
    groups = frame.groupby([pd.Series(cells, name="agent"), pd.Series(asked, name="evaluated on")], sort=False)
    table = groups.mean().add_suffix(", %")
    table.insert(0, "runs", groups.size())
    table.insert(2, "lowest", groups["success"].min())
    return table.reset_index().to_string(index=False, float_format="{:.2f}".format)


def _labels(settings: Sequence[dict[str, Any]], default: str) -> list[str]:
    """Return what each of some settings differs in from the others; equal ones have equal labels."""
    keys = [tuple(config.items()) for config in settings]
    distinct = dict(zip(keys, settings, strict=True))
    labels = label_cells([*distinct.values()], [default] * len(distinct))
    return [dict(zip(distinct, labels, strict=True))[key] for key in keys]


def _evaluate_agent(request: EvaluationRequest, agent: Agent, env: EnvConfig) -> Evaluation:
    folder = agent.folder / "evaluations" / (request.name or _folder_name(request, agent, env))
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")
    rates = _evaluate(request, agent, env, folder)
    if agent.directory is not None and request.tracking.mlflow:
        _store(request, agent.directory)
    say(f"results        {folder}")
    return Evaluation(agent.config, request, folder, rates)


def _evaluate(request: EvaluationRequest, agent: Agent, env: EnvConfig, folder: Path) -> dict[str, float]:
    from rich.progress import Progress

    from parking_exp.algorithms.build_model import greedy_policy, torch_settings
    from parking_exp.evaluation.evaluate_policy import describe, evaluate, intervals, summarise
    from parking_exp.evaluation.video import record

    task, simulator = make_task(env), _simulator(request, env)
    policy, seeds, screen = greedy_policy(agent.model(env)), request.seeds, Screen(stderr=True)
    with torch_settings(agent.config), Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
        shown = bar.add_task(f"{plural(len(seeds), 'episode')} of {env.name}", total=len(seeds))
        episodes = evaluate(policy, task, seeds, lambda finished: bar.update(shown, completed=finished), simulator)
    folder.mkdir(parents=True, exist_ok=True)
    for outdated in folder.glob("video.*"):
        outdated.unlink()
    episodes.to_csv(folder / "episodes.csv", index=False)
    chosen = {"simulator": simulator, "model": request.model, "first_scene": request.first_scene}
    rates = summarise(episodes, task.metrics)
    numbers = {"episodes": len(episodes), **rates, "intervals": intervals(episodes, task.metrics)}
    write_json(folder / "summary.json", {"env": env.name, **chosen, **numbers})
    say(
        f"{agent.name} on {plural(len(seeds), 'episode')} of {env.name}, from seed {request.first_scene}, "
        f"simulated by {simulator}",
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

    tracked_in, output_dir = directory.tracking_uri, directory_path(request.output_dir)
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
    if merged["task"] == own.task:
        merged = merged | own.model_dump(include={*own.of_agent})
    env = check(EvaluatedEnv, {"env": merged}).env
    if (simulator := _simulator(request, env)) != env.simulator:
        env = env.model_copy(update={"simulator": simulator})
    refuse([*env.problems(), *make_task(env).problems()])
    return env


def _simulator(request: EvaluationRequest, env: EnvConfig) -> str:
    """Return what simulates the episodes: by default the task's reference."""
    if request.simulator not in (None, *env.simulators):
        raise ConfigError(f"simulator={request.simulator}: env={env.name} has {' and '.join(env.simulators)}")
    return request.simulator or env.simulators[-1]


def _folder_name(request: EvaluationRequest, agent: Agent, env: EnvConfig) -> str:
    name = f"{env.name}-{request.model}-seeds-{request.seeds[0]}-{request.seeds[-1]}"
    if env.simulator != env.simulators[-1]:
        name += f"-{env.simulator}"
    own = agent.config.env.model_dump()
    if env.model_dump() != own | ({"simulator": env.simulator} if "simulator" in own else {}):
        name += f"-{short_hash(env.model_dump())}"  # the same option with other values is another evaluation
    return name
