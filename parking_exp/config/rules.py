"""Rules between the keys of a config."""

import re
from collections.abc import Iterator, Mapping

from parking_exp.config.allowlist import ALLOWED
from parking_exp.config.argument_limits import HER_OPTIONS
from parking_exp.config.constructor_arguments import find
from parking_exp.config.schema import DEFAULT_FEATURES, DEFAULT_SCALES, TRAINING_SCENES_START, EnvConfig, RunConfig
from parking_exp.errors import ConfigError

HER_CLASSES = ("HerBuffer", "HerReplayBuffer")


def check_rules(run: RunConfig) -> Iterator[str]:
    """Yield a sentence for each rule between keys that the config violates."""
    yield from check_env(run.env)
    for check in (_check_buffer, _check_algorithm, _check_evaluation, _check_tracking):
        yield from check(run)


def check_env(env: EnvConfig) -> Iterator[str]:
    """Yield a sentence for each rule of the `env` group that is violated."""
    observation, action = env.observation, env.action
    if len(observation.scales) != len(observation.features):
        yield "env.observation.scales has another length than env.observation.features; give one scale for each"
    if not (action.longitudinal or action.lateral):
        yield "env.action.longitudinal and env.action.lateral are both false; set one of them to true"
    if env.training_success_goal_reward is not None and env.training_success_goal_reward > env.success_goal_reward:
        yield (
            f"env.training_success_goal_reward={env.training_success_goal_reward} is above "
            f"env.success_goal_reward={env.success_goal_reward}: agents would learn to stop short of the goal"
        )
    if env.policy_frequency > env.simulation_frequency:
        yield f"env.policy_frequency={env.policy_frequency} is above env.simulation_frequency"
    if env.simulator == "vectorized" and action.dynamical:
        yield "env.action.dynamical is not simulated by env.simulator=vectorized; use env.simulator=highway_env"
    if env.other_vehicles_type not in ALLOWED:  # the import takes a second
        try:
            find(env.other_vehicles_type)
        except ConfigError as error:
            yield f"env.other_vehicles_type={env.other_vehicles_type}: {error}"


def _check_buffer(run: RunConfig) -> Iterator[str]:
    arguments, starts = run.buffer.arguments, run.algorithm.arguments.get("learning_starts")
    her_options = [name for name in HER_OPTIONS if name in arguments]
    without_goals = arguments.get("goal_selection_strategy", "future") is None
    is_her = run.buffer.class_name in HER_CLASSES or bool(her_options) or "goal_selection_strategy" in arguments
    relabels = is_her and not without_goals
    if without_goals and her_options:
        yield f"buffer.{her_options[0]} has no effect without virtual goals; leave it out, or use buffer=her_future"
    longest = run.env.for_training().episode_steps()
    if relabels and (not isinstance(starts, int) or starts < longest * run.n_envs):
        key = "algorithm.learning_starts" if starts is None else f"algorithm.learning_starts={starts}"
        yield (
            f"{key}: HER samples finished episodes only; give at least "
            f"{longest * run.n_envs}: {longest} steps of the longest training episode x {run.n_envs} envs"
        )
    elif isinstance(starts, int) and run.total_timesteps <= starts:
        yield f"total_timesteps={run.total_timesteps} ends before the first update; give at least {starts + 1}"
    if run.buffer.buffer_size // run.n_envs <= longest:
        yield (
            f"buffer.buffer_size={run.buffer.buffer_size} holds no whole episode of each env; "
            f"give at least {(longest + 1) * run.n_envs}"
        )
    observation = run.env.observation
    if relabels and (observation.features != DEFAULT_FEATURES or observation.scales != DEFAULT_SCALES):
        yield "env.observation: HER needs the features and scales of conf/env/parking.yaml; or use buffer=replay"


def _check_algorithm(run: RunConfig) -> Iterator[str]:
    arguments, action = run.algorithm.arguments, run.env.action
    if run.env.observation.features != DEFAULT_FEATURES and run.algorithm.features != "raw":
        yield "algorithm.features needs the observation features of conf/env/parking.yaml; or use raw"
    train_freq, noise = arguments.get("train_freq"), arguments.get("action_noise")
    if isinstance(train_freq, list):
        number, unit = train_freq if len(train_freq) == 2 else (0, None)
        if type(number) is not int or number < 1 or unit not in ("step", "episode"):
            yield f"algorithm.train_freq={train_freq} is neither NUMBER nor [NUMBER, step] nor [NUMBER, episode]"
        elif unit == "episode" and run.n_envs > 1:
            yield "algorithm.train_freq counts episodes, which works with one env only; set n_envs=1"
    if noise is not None and not (isinstance(noise, Mapping) and "_target_" in noise):
        yield f"algorithm.action_noise={noise} has no _target_; give one, or null"
    for name in ("mean", "sigma"):
        values = noise.get(name) if isinstance(noise, Mapping) else None
        if isinstance(values, list) and len(values) != action.longitudinal + action.lateral:
            yield f"algorithm.action_noise.{name} has {len(values)} entries; give one for each dimension of the action"


def _check_evaluation(run: RunConfig) -> Iterator[str]:
    evaluation = run.evaluation
    final = evaluation.final_n_scenes
    for name in ("n_scenes", "video_episodes"):
        if final < getattr(evaluation, name):
            yield f"evaluation.final_n_scenes={final} is below evaluation.{name}={getattr(evaluation, name)}"
    if evaluation.first_scene + final > TRAINING_SCENES_START:
        yield (
            f"evaluation.first_scene={evaluation.first_scene} reaches into the training scenes; "
            f"it can be {TRAINING_SCENES_START - final} at most"
        )


def _check_tracking(run: RunConfig) -> Iterator[str]:
    """Yield what no store accepts; a server may also be down, which is no error of the config."""
    uri = run.tracking.uri
    if run.tracking.mlflow and run.experiment_name == "Default":
        yield "experiment_name=Default is MLflow's own, which keeps artifacts elsewhere; take another name"
    stores = r"sqlite:///[^?]+|(https?|postgresql|mysql|mssql)(\+\w+)?://.+|databricks.*"
    if run.tracking.mlflow and uri is not None and re.fullmatch(stores, uri) is None:
        yield f"tracking.uri={uri} is no MLflow store; use sqlite:///PATH, or http://HOST:PORT of a tracking server"
