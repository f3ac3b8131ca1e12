"""Evaluate a stored run on real highway-env: rates with intervals, an episodes table, a video."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.allowlist import check_trust
from parking_exp.config.paths import default_uri, directory_path, is_same_store, without_password
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
from parking_exp.errors import ConfigError, DamagedModelError, ModelError, RunNotFoundError, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.files import write_json
from parking_exp.runs.lookup import find_run
from parking_exp.terminal import say


class ResultsTracking(StoreConfig):
    """Where results go besides the run directory."""

    mlflow: bool


class EvaluationRequest(ConfigModel):
    """The config of scripts/evaluate.py."""

    run: Annotated[str, Field(min_length=1)]
    output_dir: str
    model: Literal["final", "best"]
    episodes: NumberOfScenes
    first_scene: Scene
    simulator: Simulation
    video: Count
    gif: bool
    name: Name | None
    trust: bool
    tracking: ResultsTracking
    env: EnvConfig | None = None


def validate_request(config: DictConfig) -> EvaluationRequest:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong.
    """
    request = parse(EvaluationRequest, config)
    if request.video > request.episodes:
        raise ConfigError(f"video={request.video} is above episodes; the closest valid choice is {request.episodes}")
    if request.gif and not request.video:
        raise ConfigError("gif=true needs a video to be made from; set video=N as well")
    if request.first_scene + request.episodes > TRAINING_SCENES_START:
        raise ConfigError(
            f"first_scene={request.first_scene} reaches into the training scenes; "
            f"the closest valid choice is {TRAINING_SCENES_START - request.episodes}"
        )
    if request.env is not None:
        # One key says what simulates: request.simulator.
        env = _simulated(request.env, request.simulator)
        request = request.model_copy(update={"env": env})
        if problems := check_env(env):
            raise ConfigError("\n".join(problems))
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
    directory = find_run(request.run, output_dir, having=f"models/{request.model}.zip")
    weights = directory.models / f"{request.model}.zip"
    if not weights.exists():
        state = "is gone" if directory.status == "done" else "has not been made yet"
        ways = _ways_out(directory, request.model, "type its training command again, which makes it")
        raise RunNotFoundError(f"run={request.run}: {weights} {state}; {ways}")
    run = directory.config()
    directory.check_links()
    if not request.trust:
        check_trust(run, directory.path / "config.yaml")
    env = request.env or _simulated(run.env, request.simulator)
    if problems := check_env(env):
        raise ConfigError("\n".join(problems))
    folder = directory.path / "evaluations" / (request.name or _folder_name(request, run, env))
    say(f"run directory  {directory.path}")
    precision = directory.read_status().get("precision", "highest")
    try:
        _evaluate(request, run, env, weights, folder, precision)
    except ModelError as error:
        ways = _ways_out(directory, request.model, "delete it and type its training command again, which makes it")
        if not isinstance(error, DamagedModelError):
            ways = f"put back the config.yaml that it was trained with, or {ways}"
        raise ModelError(f"{error}; {ways}") from error
    _store(request, directory, output_dir)
    say(f"results        {folder}")
    return folder


def _ways_out(directory: RunDirectory, model: str, again: str) -> str:
    """Say what to type where a run's model is gone or damaged; `again` has the last checkpoint make it."""
    other = "best" if model == "final" else "final"
    ways = [f"try model={other}"] if (directory.models / f"{other}.zip").exists() else []
    if directory.status != "done":
        return (ways or ["let it train first"])[0]
    if directory.final_checkpoint.exists():
        ways.append(f"{again} from the last checkpoint")
    else:
        ways.append(f"delete {directory.path} to train it afresh, since no checkpoint of its end is left")
    return ", or ".join(ways)


def _evaluate(
    request: EvaluationRequest, run: RunConfig, env: EnvConfig, weights: Path, folder: Path, precision: object
) -> None:
    """Load the model, evaluate it, write the results into a folder, and print them."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    from parking_exp.algorithms.build import build_model, greedy_policy, torch_settings
    from parking_exp.algorithms.model_files import load_weights
    from parking_exp.algorithms.save_check import check_saving
    from parking_exp.envs.highway import make_env
    from parking_exp.evaluation.description import describe, intervals
    from parking_exp.evaluation.evaluate import evaluate, summarise
    from parking_exp.evaluation.video import record

    check_saving(run)
    model = build_model(run, DummyVecEnv([lambda: make_env(env)]), seed=0, for_training=False)
    load_weights(weights, model)
    policy = greedy_policy(model)
    scenes = range(request.first_scene, request.first_scene + request.episodes)
    what = f"{plural(request.episodes, 'episode')} of {env.name}"
    with torch_settings(run, precision), _progress(what, request.episodes) as update:
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
        f"{request.model} model on {plural(request.episodes, 'scene')} of {env.name}, from scene "
        f"{request.first_scene}, simulated by {request.simulator}"
    )
    say(*describe(episodes).split("\n"))
    if request.video:
        with _progress(f"video of {plural(request.video, 'episode')}", request.video) as update:
            record(policy, env, scenes[: request.video], folder / "video.mp4", request.gif, on_episode=update)


@contextmanager
def _progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar, and yield what moves it."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)

        def update(finished: int) -> None:
            bar.update(task, completed=finished)

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
        place = without_password(tracked_in)
        say(
            f"not stored     the run is tracked in {place}, not in the store of output_dir={output_dir}; "
            f"tracking.uri={place} sends the results there"
        )
        return
    from parking_exp.tracking.sync import try_sync
    from parking_exp.tracking.tracker import later

    if problem := try_sync(directory, uri):
        say(f"not stored     {problem}; {later(directory.output_dir, uri)}")


def _simulated(env: EnvConfig, simulator: Simulation) -> EnvConfig:
    return env.model_copy(update={"simulator": simulator})


def _folder_name(request: EvaluationRequest, run: RunConfig, env: EnvConfig) -> str:
    name = f"{env.name}-{request.model}-scenes-{request.first_scene}-{request.first_scene + request.episodes - 1}"
    if request.simulator != "highway_env":
        name += f"-{request.simulator}"
    if env != _simulated(run.env, request.simulator):
        # The same option with other values is another evaluation.
        name += f"-{short_hash(env.model_dump())}"
    return name
