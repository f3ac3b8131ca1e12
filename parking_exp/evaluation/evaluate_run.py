"""Evaluate a stored run on real highway-env: rates with intervals, an episodes table, a video."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.messages import refuse
from parking_exp.config.paths import default_uri, directory_path, is_same_store
from parking_exp.config.rules import check_env
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import (
    TRAINING_SCENES_START,
    ConfigModel,
    Count,
    EnvConfig,
    Name,
    NumberOfScenes,
    RunConfig,
    Scene,
    Simulation,
    StoreConfig,
)
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError, plural
from parking_exp.evaluation.agents import Agent, ModelName, find_agent, is_pretrained
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.terminal import Screen, say

EPISODES = 100
LINE_EVERY_S = 10.0  # of progress, where the output is no terminal
PRETRAINED_EPISODES = 20  # a first look; their cards have the rates of 500


class ResultsTracking(StoreConfig):
    """Where results go besides the run directory."""

    mlflow: bool


class EvaluationRequest(ConfigModel):
    """The config of scripts/evaluate.py."""

    run: Annotated[str, Field(min_length=1)]
    output_dir: str
    model: ModelName
    episodes: NumberOfScenes | None
    first_scene: Scene
    simulator: Simulation
    video: Count
    gif: bool
    name: Name | None
    trust: bool
    tracking: ResultsTracking
    env: EnvConfig | None = None

    @property
    def n_scenes(self) -> int:
        """Number of scenes that the policy is evaluated on."""
        return self.episodes or (PRETRAINED_EPISODES if is_pretrained(self.run) else EPISODES)


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong.
    """
    request = parse(EvaluationRequest, config)
    if request.video > request.n_scenes:
        raise ConfigError(f"video={request.video} is above episodes; the closest valid choice is {request.n_scenes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video to be made from; set video=N as well")
    if request.first_scene + request.n_scenes > TRAINING_SCENES_START:
        raise ConfigError(
            f"first_scene={request.first_scene} reaches into the training scenes; "
            f"the closest valid choice is {TRAINING_SCENES_START - request.n_scenes}"
        )
    if request.env is not None:
        # One key says what simulates: request.simulator.
        env = _simulated(request.env, request.simulator)
        request = request.model_copy(update={"env": env})
        refuse(check_env(env))
    return request


def evaluate_run(config: DictConfig) -> Path:
    """Evaluate, print, and store; return the folder of the results.

    Raises:
        ConfigError: the config is not valid, or the run's algorithm can't be restored exactly.
        ModelError: the model is damaged, or does not fit the run's config.
        RunNotFoundError: no run answers to `run`, or it has no such model yet.
        UntrustedError: the stored config would execute what runs are not made of, and `trust` is false.
    """
    request = validate_request(config)
    output_dir = directory_path(request.output_dir)
    agent = find_agent(request.run, output_dir, request.model, trust=request.trust)
    env = request.env or _simulated(agent.config.env, request.simulator)
    refuse(check_env(env))
    folder = agent.folder / "evaluations" / (request.name or _folder_name(request, agent.config, env))
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")
    _evaluate(request, agent, env, folder)
    if agent.directory is not None:
        _store(request, agent.directory, output_dir)
    say(f"results        {folder}")
    return folder


def _evaluate(request: EvaluationRequest, agent: Agent, env: EnvConfig, folder: Path) -> None:
    """Load the model, evaluate it, write the results into a folder, and print them."""
    from parking_exp.algorithms.build import greedy_policy, torch_settings
    from parking_exp.evaluation.description import describe, intervals
    from parking_exp.evaluation.evaluate import evaluate, summarise
    from parking_exp.evaluation.video import record

    policy = greedy_policy(agent.model(env))
    scenes = range(request.first_scene, request.first_scene + request.n_scenes)
    what = f"{plural(request.n_scenes, 'episode')} of {env.name}"
    with torch_settings(agent.config), _progress(what, request.n_scenes) as update:
        episodes = evaluate(policy, env, scenes, on_step=update)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob("video.*"):
        stale.unlink()
    episodes.to_csv(folder / "episodes.csv", index=False)
    about = {
        "env": env.name,
        "simulator": request.simulator,
        "model": request.model,
        "first_scene": request.first_scene,
        "episodes": len(episodes),
    }
    write_json(folder / "summary.json", {**about, **summarise(episodes), "intervals": intervals(episodes)})
    say(
        f"{agent.name} on {plural(request.n_scenes, 'scene')} of {env.name}, from scene "
        f"{request.first_scene}, simulated by {request.simulator}"
    )
    say(*describe(episodes).split("\n"))
    if request.video:
        with _progress(f"video of {plural(request.video, 'episode')}", request.video) as update:
            record(policy, env, scenes[: request.video], folder / "video.mp4", request.gif, on_episode=update)
        for path in sorted(folder.glob("video.*")):
            say(f"video          {path}")


@contextmanager
def _progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on a terminal, lines of text elsewhere, and yield what moves it."""
    from rich.progress import Progress

    screen, shown = Screen(stderr=True), time.monotonic()
    with Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task(what, total=total)

        def update(finished: int) -> None:
            nonlocal shown
            bar.update(task, completed=finished)
            if finished and not screen.is_terminal and time.monotonic() - shown >= LINE_EVERY_S:
                shown = time.monotonic()
                say(f"{what}: {finished} of {total} done", stderr=True)

        yield update


def _store(request: EvaluationRequest, directory: RunDirectory, output_dir: Path) -> None:
    """Bring the results into the run's store: the one that is typed, or the embedded one of the output directory.

    A run directory may come from elsewhere, and what it names as its store is no reason to connect there.
    """
    tracked_in = directory.tracking_uri
    uri = request.tracking.uri or (default_uri(output_dir) if tracked_in else None)
    if not request.tracking.mlflow or uri is None:
        return
    if request.tracking.uri is None and tracked_in is not None and not is_same_store(tracked_in, uri):
        say(
            f"not stored     the run is tracked in {tracked_in}, not in the store of output_dir={output_dir}; "
            f"tracking.uri={tracked_in} sends the results there"
        )
        return
    from parking_exp.tracking.mirror import later, try_mirror

    if problem := try_mirror(directory, uri):
        say(f"not stored     {problem}; {later(directory.output_dir, uri)}")


def _simulated(env: EnvConfig, simulator: Simulation) -> EnvConfig:
    return env.model_copy(update={"simulator": simulator})


def _folder_name(request: EvaluationRequest, run: RunConfig, env: EnvConfig) -> str:
    name = f"{env.name}-{request.model}-scenes-{request.first_scene}-{request.first_scene + request.n_scenes - 1}"
    if request.simulator != "highway_env":
        name += f"-{request.simulator}"
    if env != _simulated(run.env, request.simulator):
        # The same option with other values is another evaluation.
        name += f"-{short_hash(env.model_dump())}"
    return name
