"""Evaluate a stored run, of parking on real highway-env: rates with intervals, an episodes table, a video."""

from pathlib import Path

from omegaconf import DictConfig

from parking_exp.config.paths import default_uri, directory_path, is_same_store
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig, StoreConfig
from parking_exp.config.validate import parse, refuse
from parking_exp.config_model import TRAINING_SEEDS_START, Count, EpisodeSeed, Name, NumberOfEpisodes
from parking_exp.errors import ConfigError, VideoError, plural
from parking_exp.evaluation.agents import Agent, AgentRequest, is_pretrained
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


class EvaluationRequest(AgentRequest):
    """The config of scripts/evaluate.py."""

    episodes: NumberOfEpisodes | None
    first_scene: EpisodeSeed
    simulator: str | None
    video: Count
    gif: bool
    name: Name | None
    tracking: ResultsTracking
    env: EnvConfig | None = None

    @property
    def seeds(self) -> range:
        """Seeds of the episodes."""
        n_episodes = self.episodes or (PRETRAINED_EPISODES if is_pretrained(self.run) else EPISODES)
        return range(self.first_scene, self.first_scene + n_episodes)


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Validate a composed config."""
    request = parse(EvaluationRequest, config, without=OF_RECIPES)
    n_episodes = len(request.seeds)
    if request.video > n_episodes:
        raise ConfigError(f"video={request.video} is above episodes; the closest valid choice is {n_episodes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video; set video=N as well")
    if request.seeds.stop > TRAINING_SEEDS_START:
        highest = TRAINING_SEEDS_START - n_episodes
        raise ConfigError(f"first_scene={request.first_scene} reaches into the seeds of training; at most {highest}")
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
    rates = {**summarise(episodes, task.metrics), "intervals": intervals(episodes, task.metrics)}
    write_json(folder / "summary.json", {"env": env.name, **chosen, "episodes": len(episodes), **rates})
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
