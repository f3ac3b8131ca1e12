"""Rules between the keys of a config; each error suggests the closest valid choice."""

import re
from collections.abc import Mapping
from importlib.metadata import entry_points
from itertools import pairwise

from parking_exp.config.allowlist import is_trusted
from parking_exp.config.her_options import HER_OPTIONS
from parking_exp.config.limits import check_limits
from parking_exp.config.schema import DEFAULT_FEATURES, DEFAULT_SCALES, TRAINING_SCENES_START, EnvConfig, RunConfig
from parking_exp.config.targets import UnknownTarget, find
from parking_exp.resources import total_memory

STORES = ("sqlite", "http", "https", "postgresql", "mysql", "mssql", "databricks")  # MLflow's own
HER_CLASSES = ("HerBuffer", "HerReplayBuffer")
# What is needed at least: `HerBuffer` takes 113 bytes a transition, other buffers and a batch of tensors more.
TRANSITION_BYTES, SCENE_BYTES = 113, 1000


def check_env(env: EnvConfig) -> list[str]:
    """Rules between the keys of the `env` group."""
    problems = []
    if len(env.observation.scales) != len(env.observation.features):
        problems.append(
            f"env.observation.scales has {len(env.observation.scales)} entries and env.observation.features "
            f"{len(env.observation.features)}; give one scale for each feature"
        )
    if not (env.action.longitudinal or env.action.lateral):
        problems.append("env.action.longitudinal and env.action.lateral are both false; set one of them to true")
    for name in ("acceleration_range", "steering_range", "speed_range"):
        bounds = getattr(env.action, name)
        if bounds is not None and not bounds[0] < bounds[1]:
            problems.append(f"env.action.{name}={bounds} is empty; the closest valid choice is {sorted(bounds)}")
    if (env.training_success_goal_reward or 0) > env.success_goal_reward:
        problems.append(
            f"env.training_success_goal_reward={env.training_success_goal_reward} is above env.success_goal_reward="
            f"{env.success_goal_reward}, so that agents would learn to stop short of it; the closest valid choice is "
            f"{env.success_goal_reward}"
        )
    if env.policy_frequency > env.simulation_frequency:
        problems.append(
            f"env.policy_frequency={env.policy_frequency} is above env.simulation_frequency="
            f"{env.simulation_frequency}; the closest valid choice is {env.simulation_frequency}"
        )
    if env.simulator == "vectorized":
        problems += [
            f"env.{option} is not simulated by env.simulator=vectorized; use env.simulator=highway_env"
            for option in env.uncovered
        ]
    if not is_trusted(env.other_vehicles_type):  # which is one of highway-env's, and takes a second to import
        try:
            find(env.other_vehicles_type)
        except UnknownTarget as error:
            problems.append(f"env.other_vehicles_type={env.other_vehicles_type}: {error}")
    return problems


def check_rules(run: RunConfig) -> list[str]:
    """Check the ranges of well-known arguments, and rules between keys of different groups."""
    limits = [
        *check_limits("algorithm", run.algorithm.arguments, run.algorithm.target),
        *check_limits("buffer", run.buffer.arguments, run.buffer.target),
    ]
    if limits:
        return limits
    checks = (_check_memory, _check_buffer, _check_algorithm, _check_evaluation, _check_tracking)
    return check_env(run.env) + [problem for check in checks for problem in check(run)]


def _check_memory(run: RunConfig) -> list[str]:
    """Refuse what can never fit; how much memory is free now is no matter."""
    per_unit = {
        "buffer.buffer_size": (run.buffer.buffer_size, TRANSITION_BYTES),
        "algorithm.batch_size": (run.algorithm.arguments.get("batch_size"), TRANSITION_BYTES),
        "algorithm.net_arch": (sum(wide * high for wide, high in pairwise([1, *run.algorithm.net_arch, 1])), 4),
        "n_envs": (run.n_envs, SCENE_BYTES),
        "evaluation.final_n_scenes": (run.evaluation.final_n_scenes, SCENE_BYTES),
    }
    total = total_memory()
    return [
        f"{key} takes {number * size / 1e9:,.1f} GB of memory or more ({number} x {size} bytes), and this machine has "
        f"{total / 1e9:,.1f} GB; choose a smaller one"
        for key, (number, size) in per_unit.items()
        if isinstance(number, int) and number * size > total
    ]


def _check_buffer(run: RunConfig) -> list[str]:
    problems = []
    without = run.buffer.arguments.get("goal_selection_strategy", "future") is None
    is_her = run.buffer.class_name in HER_CLASSES or not {*HER_OPTIONS, "goal_selection_strategy"}.isdisjoint(
        run.buffer.arguments
    )
    relabels = is_her and not without
    idle = [name for name in HER_OPTIONS if name in run.buffer.arguments]
    if without and idle:
        problems.append(f"buffer.{idle[0]} has no effect without virtual goals; leave it out, or use buffer=her_future")
    longest = run.env.for_training().episode_steps()
    where = f"the longest training episode ({longest} steps) x n_envs ({run.n_envs})"
    starts = run.algorithm.arguments.get("learning_starts")
    if relabels and not isinstance(starts, int):
        problems.append(f"algorithm.learning_starts is missing; give at least {longest * run.n_envs}, {where}")
    elif relabels and isinstance(starts, int) and starts < longest * run.n_envs:
        problems.append(
            f"algorithm.learning_starts={starts} is shorter than {where}, and HER samples finished episodes only; "
            f"the closest valid choice is {longest * run.n_envs}"
        )
    elif isinstance(starts, int) and run.total_timesteps <= starts:
        problems.append(
            f"total_timesteps={run.total_timesteps} is not above algorithm.learning_starts={starts}, the env steps "
            f"before the first update; the closest valid choice is {starts + 1}"
        )
    if run.buffer.buffer_size // run.n_envs <= longest:
        problems.append(
            f"buffer.buffer_size={run.buffer.buffer_size} cannot hold one whole episode of each env, {where}; "
            f"the closest valid choice is {(longest + 1) * run.n_envs}"
        )
    observation = run.env.observation
    if relabels and (observation.features != DEFAULT_FEATURES or observation.scales != DEFAULT_SCALES):
        problems.append(
            f"env.observation: HER computes rewards of goals in highway-env's own features and scales, "
            f"{DEFAULT_FEATURES} and {DEFAULT_SCALES}; use these, or buffer=replay"
        )
    return problems


def _check_algorithm(run: RunConfig) -> list[str]:
    problems = []
    if run.env.observation.features != DEFAULT_FEATURES and run.algorithm.features != "raw":
        problems.append(
            f"algorithm.features={run.algorithm.features} reads the observation features "
            f"{', '.join(DEFAULT_FEATURES)} in this order; the closest valid choice is algorithm.features=raw"
        )
    train_freq = run.algorithm.arguments.get("train_freq")
    if isinstance(train_freq, list):
        number, unit = train_freq if len(train_freq) == 2 else (0, "")
        if type(number) is not int or number < 1 or unit not in ("step", "episode"):
            problems.append(
                f"algorithm.train_freq={train_freq} is neither a number nor [NUMBER, step] nor [NUMBER, episode], "
                "with a NUMBER of 1 or more"
            )
        elif train_freq[1] == "episode" and run.n_envs > 1:
            problems.append("algorithm.train_freq counts episodes, which works with one env only; set n_envs=1")
    actions = run.env.action.longitudinal + run.env.action.lateral
    noise = run.algorithm.arguments.get("action_noise")
    if noise is not None and not (isinstance(noise, Mapping) and "_target_" in noise):
        problems.append(f"algorithm.action_noise={noise} has no _target_; give one, or null")
    for name in ("mean", "sigma"):
        values = noise.get(name) if isinstance(noise, Mapping) else None
        if isinstance(values, list) and len(values) != actions:
            problems.append(
                f"algorithm.action_noise.{name} has {len(values)} entries and the action {actions}; "
                "give one entry for each action"
            )
    return problems


def _check_evaluation(run: RunConfig) -> list[str]:
    problems, evaluation = [], run.evaluation
    if evaluation.final_n_scenes < evaluation.n_scenes:
        problems.append(
            f"evaluation.final_n_scenes={evaluation.final_n_scenes} is below evaluation.n_scenes="
            f"{evaluation.n_scenes}; the closest valid choice is {evaluation.n_scenes}"
        )
    if evaluation.video_episodes > evaluation.final_n_scenes:
        problems.append(
            f"evaluation.video_episodes={evaluation.video_episodes} is above evaluation.final_n_scenes; "
            f"the closest valid choice is {evaluation.final_n_scenes}"
        )
    if evaluation.first_scene + evaluation.final_n_scenes > TRAINING_SCENES_START:
        problems.append(
            f"evaluation.first_scene={evaluation.first_scene} reaches into the training scenes; "
            f"the closest valid choice is {TRAINING_SCENES_START - evaluation.final_n_scenes}"
        )
    return problems


def _check_tracking(run: RunConfig) -> list[str]:
    """Refuse a store that can never work; one that is only down is none of these."""
    uri = run.tracking.uri
    if not run.tracking.mlflow:
        return []
    if run.experiment_name == "Default":
        return ["experiment_name=Default is MLflow's own, which keeps artifacts elsewhere; take another name"]
    if uri is None:
        return []
    scheme = uri.partition(":")[0].partition("+")[0]
    if scheme == "sqlite" and re.fullmatch(r"sqlite:///[^?]+", uri) is None:
        return [f"tracking.uri={uri} is not sqlite:///PATH, with nothing after the path"]
    if scheme in STORES or any(plugin.name == scheme for plugin in entry_points(group="mlflow.tracking_store")):
        return []
    return [f"tracking.uri={uri} is no MLflow store; use sqlite:///PATH, or http://HOST:PORT of a tracking server"]
