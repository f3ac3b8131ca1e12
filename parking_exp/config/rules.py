"""Rules between the keys of a config."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing

from parking_exp.config.argument_limits import HER_OPTIONS
from parking_exp.config.schema import RunConfig
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.task import Task

HER_CLASSES = ("HerBuffer", "HerReplayBuffer")
FAR_FACTOR = 8
"""A ratio is far from the suggested one if it is larger or smaller by more than this factor."""
MAX_ENVS_FOR_FEW = 32
"""The most envs for which envs=few is an alternative."""
MAX_ROUND = 1000
"""The most steps of each env from one round of updates to the next."""


def rule_problems(run: RunConfig) -> Iterator[str]:
    """Yield a sentence for each rule between keys that the config violates."""
    yield from run.env.problems()
    if run.init_buffer and run.init is None:
        yield "init_buffer=true needs init=RUN, whose replay buffer it takes"
    yield from _buffer_problems(run)
    yield from _algorithm_problems(run)
    if run.is_trained:
        yield from _round_problems(run)
    yield from _evaluation_problems(run)
    yield from _tracking_problems(run)


def _buffer_problems(run: RunConfig) -> Iterator[str]:
    her_options = [name for name in HER_OPTIONS if name in run.buffer.arguments]
    if her_options and run.buffer.arguments.get("goal_selection_strategy", "future") is None:
        yield (
            f"buffer.{her_options[0]} has no effect without virtual goals; leave it out, or use "
            "buffer=her_future"
        )
    if not run.buffer.demonstrations:
        stored = run.buffer.model_dump()  # without defaults
        for name in ("demonstration_share", "demonstrator"):
            if name in stored:
                yield (
                    f"buffer.{name} has no effect without demonstrations; leave it out, or set "
                    "buffer.demonstrations=N"
                )
    longest = run.env.for_training().episode_steps
    if longest is not None and run.is_trained:
        yield from _length_problems(run, longest)
    if run.is_trained:
        yield from run.env.model_problems(run.algorithm.features, run.buffer)
    if run.buffer.arguments.get("copy_info_dict"):
        yield (
            "buffer.copy_info_dict=true: checkpoints do not have infos; use "
            "buffer._target_=parking_exp.buffers.HerBuffer, which stores what the reward needs"
        )


def _length_problems(run: RunConfig, longest: int) -> Iterator[str]:
    """Yield a sentence for each key that is too small for the longest training episode."""
    starts = run.algorithm.arguments.get("learning_starts")
    buffer = run.buffer.arguments
    n_steps = longest * run.n_envs
    is_her = run.buffer.class_name in HER_CLASSES or any(name in buffer for name in HER_OPTIONS)
    default_strategy = "future" if is_her else None
    relabels = buffer.get("goal_selection_strategy", default_strategy) is not None
    # A replay buffer that was taken over has finished episodes.
    if relabels and not run.init_buffer and (not isinstance(starts, int) or starts < n_steps):
        key = "algorithm.learning_starts"
        if starts is not None:
            key += f"={starts}"
        yield (
            f"{key}: HER samples finished episodes only; give at least {n_steps}: {longest} "
            f"steps of the longest training episode x {run.n_envs} envs"
        )
    elif isinstance(starts, int) and run.total_timesteps <= starts:
        yield (
            f"total_timesteps={run.total_timesteps} ends before the first update; give at least "
            f"{starts + 1}"
        )
    if run.buffer.buffer_size // run.n_envs <= longest:
        yield (
            f"buffer.buffer_size={run.buffer.buffer_size} holds no whole episode of each env; "
            f"give at least {(longest + 1) * run.n_envs}"
        )


def task_problems(runs: Iterable[RunConfig]) -> Iterator[str]:
    """Yield what is wrong with the tasks of runs, and with keys whose limits only a task knows.

    Each task is made once, which may take seconds.
    """
    runs_by_env: dict[str, list[RunConfig]] = {}
    for run in runs:
        runs_by_env.setdefault(run.env.model_dump_json(), []).append(run)

    for runs_of_env in runs_by_env.values():
        env = runs_of_env[0].env
        with closing(make_task(env)) as task:
            problems = list(task.problems())
            yield from problems
            if problems:
                return
            for run in runs_of_env:
                if run.is_trained and env.for_training().episode_steps is None:
                    yield from _length_problems(run, task.episode_steps)
                yield from _noise_problems(run, task)


def _noise_problems(run: RunConfig, task: Task) -> Iterator[str]:
    noise = run.algorithm.arguments.get("action_noise")
    if noise is None:
        return
    if not isinstance(noise, Mapping) or "_target_" not in noise:
        yield f"algorithm.action_noise={noise} has no _target_; give one, or null"
        return
    lists = {name: values for name, values in noise.items() if isinstance(values, list)}
    if not lists:
        return  # an environment need not be made
    (size,) = task.prediction_env().action_space.shape or (1,)
    for name, values in lists.items():
        if len(values) != size:
            yield (
                f"algorithm.action_noise.{name} has {len(values)} entries; an action has {size} "
                "dimensions"
            )


def _algorithm_problems(run: RunConfig) -> Iterator[str]:
    algorithm = run.algorithm
    if run.is_trained and run.total_timesteps == 0:
        yield f"total_timesteps=0: algorithm={algorithm.name} is trained; give at least 1"
    if algorithm.normalize and algorithm.features != "raw":
        yield (
            f"algorithm.normalize needs algorithm.features=raw; {algorithm.features} does its own "
            "scaling"
        )


def _tracking_problems(run: RunConfig) -> Iterator[str]:
    if run.tracking.mlflow and run.experiment_name == "Default":
        yield "experiment_name=Default is reserved by MLflow; choose another name"


def update_ratio_warning(run: RunConfig) -> str | None:
    """Return a sentence if the update-to-data ratio is far from what the number of envs suggests.

    The suggestion comes from experiment=envs_and_updates. Up to 8 envs, one update per env step
    learns well for its cost. With more, 8 updates per step of all envs do.
    """
    suggested = min(1, 8 / run.n_envs)
    is_near = suggested / FAR_FACTOR <= run.updates_per_step <= suggested * FAR_FACTOR
    if is_near or not run.is_trained:
        return None
    warning = (
        f"updates_per_step={run.updates_per_step} is far from {suggested:.5g}, which "
        f"n_envs={run.n_envs} suggests"
    )
    if run.n_envs <= MAX_ENVS_FOR_FEW and run.updates_per_step < suggested:
        warning += "; envs=few sets 8 envs and the keys that depend on their number"
    return warning


def _round_problems(run: RunConfig) -> Iterator[str]:
    """Yield a sentence for keys that set another round of updates, and for rounds that are long."""
    ratio = f"updates_per_step={run.updates_per_step}"
    train_freq, gradient_steps = run.update_round()
    for name, number in (("train_freq", train_freq), ("gradient_steps", gradient_steps)):
        given = run.algorithm.arguments.get(name)
        if given not in (None, number):
            yield (
                f"algorithm.{name}={given}: it follows from {ratio} and n_envs={run.n_envs}, which "
                f"make it {number}; leave it null"
            )
    if train_freq > MAX_ROUND:
        near = run.update_ratio.limit_denominator(MAX_ROUND)
        yield (
            f"{ratio}: updates would come after {train_freq} steps of each env; try "
            f"updates_per_step={float(near)}"
        )


def _evaluation_problems(run: RunConfig) -> Iterator[str]:
    evaluation = run.evaluation
    final = evaluation.final_n_scenes
    for name in ("n_scenes", "video_episodes"):
        if final < getattr(evaluation, name):
            yield (
                f"evaluation.final_n_scenes={final} is below "
                f"evaluation.{name}={getattr(evaluation, name)}"
            )
    overlap = run.env.overlap_problem("evaluation.first_scene", evaluation.first_scene, final)
    if overlap is not None:
        yield overlap
