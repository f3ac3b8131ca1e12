"""Evaluate a stored run on real highway-env: rates with intervals, an episodes table, a video."""

from pathlib import Path

from omegaconf import DictConfig

from parking_exp.config.paths import default_uri, directory_path, is_same_store
from parking_exp.config.rules import check_env
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import (
    TRAINING_SCENES_START,
    Count,
    EnvConfig,
    Name,
    NumberOfScenes,
    Scene,
    Simulation,
    StoreConfig,
)
from parking_exp.config.validate import parse, refuse
from parking_exp.errors import ConfigError, plural
from parking_exp.evaluation.agents import Agent, AgentRequest, is_pretrained
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.terminal import Screen, say

EPISODES, PRETRAINED_EPISODES = 100, 20  # by default; the cards of pretrained agents have the rates of 500


class ResultsTracking(StoreConfig):
    """Where results go besides the run directory."""

    mlflow: bool


class EvaluationRequest(AgentRequest):
    """The config of scripts/evaluate.py."""

    episodes: NumberOfScenes | None
    first_scene: Scene
    simulator: Simulation
    video: Count
    gif: bool
    name: Name | None
    tracking: ResultsTracking
    env: EnvConfig | None = None

    @property
    def scenes(self) -> range:
        """Scenes that the policy is evaluated on."""
        n_scenes = self.episodes or (PRETRAINED_EPISODES if is_pretrained(self.run) else EPISODES)
        return range(self.first_scene, self.first_scene + n_scenes)


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Validate a composed config."""
    request = parse(EvaluationRequest, config)
    n_scenes = len(request.scenes)
    if request.video > n_scenes:
        raise ConfigError(f"video={request.video} is above episodes; the closest valid choice is {n_scenes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video; set video=N as well")
    if request.scenes.stop > TRAINING_SCENES_START:
        highest = TRAINING_SCENES_START - n_scenes
        raise ConfigError(f"first_scene={request.first_scene} reaches into the training scenes; at most {highest}")
    if request.env is not None:
        _env(request, request.env)
    return request


def evaluate_run(config: DictConfig) -> Path:
    """Evaluate, print, and store; return the folder of the results."""
    request = validate_request(config)
    agent = request.agent()
    env = _env(request, request.env or agent.config.env)
    folder = agent.folder / "evaluations" / (request.name or _folder_name(request, agent, env))
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")
    _evaluate(request, agent, env, folder)
    if agent.directory is not None and request.tracking.mlflow:
        _store(request, agent.directory)
    say(f"results        {folder}")
    return folder


def _evaluate(request: EvaluationRequest, agent: Agent, env: EnvConfig, folder: Path) -> None:
    from rich.progress import Progress

    from parking_exp.algorithms.build_model import greedy_policy, torch_settings
    from parking_exp.evaluation.evaluate_policy import describe, evaluate, intervals, summarise
    from parking_exp.evaluation.video import record

    policy, scenes, screen = greedy_policy(agent.model(env)), request.scenes, Screen(stderr=True)
    with torch_settings(agent.config), Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task(f"{plural(len(scenes), 'episode')} of {env.name}", total=len(scenes))
        episodes = evaluate(policy, env, scenes, on_step=lambda finished: bar.update(task, completed=finished))
    folder.mkdir(parents=True, exist_ok=True)
    for outdated in folder.glob("video.*"):
        outdated.unlink()
    episodes.to_csv(folder / "episodes.csv", index=False)
    chosen = request.model_dump(include={"simulator", "model", "first_scene"})
    rates = {**summarise(episodes), "intervals": intervals(episodes)}
    write_json(folder / "summary.json", {"env": env.name, **chosen, "episodes": len(episodes), **rates})
    say(
        f"{agent.name} on {plural(len(scenes), 'scene')} of {env.name}, from scene {request.first_scene}, "
        f"simulated by {request.simulator}",
        *describe(episodes).split("\n"),
    )
    if request.video:
        record(policy, env, scenes[: request.video], folder / "video.mp4", request.gif)
        say(*(f"video          {path}" for path in sorted(folder.glob("video.*"))))


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


def _env(request: EvaluationRequest, env: EnvConfig) -> EnvConfig:
    """Return an `env` group with the request's simulator; ConfigError where they do not go together."""
    env = env.model_copy(update={"simulator": request.simulator})
    refuse(check_env(env))
    return env


def _folder_name(request: EvaluationRequest, agent: Agent, env: EnvConfig) -> str:
    name = f"{env.name}-{request.model}-scenes-{request.scenes[0]}-{request.scenes[-1]}"
    if request.simulator != "highway_env":
        name += f"-{request.simulator}"
    if env != agent.config.env.model_copy(update={"simulator": request.simulator}):
        name += f"-{short_hash(env.model_dump())}"  # the same option with other values is another evaluation
    return name
