"""Any goal environment of Gymnasium as a task: what is refused, what an episode is, learning, exact
resume.
"""

import json
import os
import re
import signal

import numpy as np
import pandas as pd
import pytest
from support.marks import slow_but
from support.models import model_of
from support.runs import call_script, config_refusal, only_run, options, run_script
from support.sweep_processes import begin, wait_until
from support.user_policies import FunctionPolicy, constant
from support.user_tasks import write_option
from support.vec_env_equality import step_alike

from parking_exp.config.compose import compose, compose_configs
from parking_exp.errors import VideoError
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.evaluation.evaluation_request import validate_evaluation
from parking_exp.tasks import gymnasium_task
from parking_exp.tasks.environment_checks import resumes_exactly
from parking_exp.tasks.gymnasium_env import GymnasiumReward
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import get_state, make_training_envs, set_state

TOY = "support.toy_tasks:"
GYMNASIUM = ("env=gymnasium", "algorithm.learning_starts=400")


def config(env_id, *overrides):
    return compose(*GYMNASIUM, f"env.id={env_id}", *overrides)


@pytest.mark.parametrize(
    ("env_id", "overrides", "reason"),
    [
        (
            "FetchReech-v4",
            [],
            "not registered with Gymnasium; .*MODULE:FetchReech-v4; did you mean 'FetchReach-v4'",
        ),
        ("no_such_module:X-v0", [], "needs the module no_such_module, which is not installed"),
        (f"{TOY}Worded-v0", [], "compute_reward depends on more than goals and the numbers"),
        ("racetrack-v0", [], "not a goal environment: its observation has no desired_goal"),
        (f"{TOY}Discrete-v0", [], r"Discrete\(8\).* continuous"),
        (f"{TOY}Silent-v0", [], "neither is_success nor success.*env.success_key"),
        (f"{TOY}Broken-v0", [], "env.id=.*Broken-v0: RuntimeError: no licence found"),
        (f"{TOY}BitFlip-v0", ["buffer.relabel_collision=keep"], "buffer.relabel_collision=keep"),
        (f"{TOY}OneByOne-v0", [], "compute_reward is not vectorized"),
        (
            f"{TOY}OtherReward-v0",
            [],
            "compute_reward gives -1 for a step of reward -1.5.*env.failure_key",
        ),
        (f"{TOY}Endless-v0", [], "set env.max_episode_steps"),
        (f"{TOY}BitFlip-v0", ["env.failure_key=lots"], "env.failure_key=lots.* is_success, lost"),
        (f"{TOY}BitFlip-v0", ["env.success_key=won"], "env.success_key=won"),
        (
            f"{TOY}BitFlip-v0",
            ["env.failure_key=is_success"],
            "^env.failure_key=is_success tells of success",
        ),
        (
            f"{TOY}BitFlip-v0",
            ["env.success_key=lost", "env.failure_key=lost"],
            "^env.failure_key=lost tells of success",
        ),
        (f"{TOY}BitFlip-v0", ["+env.kwargs.bits=3"], "env.kwargs.*bits"),
        (
            f"{TOY}BitFlip-v0",
            ["algorithm.features=ego", "algorithm.normalize=false"],
            "algorithm.features=ego",
        ),
        (
            f"{TOY}BitFlip-v0",
            ["algorithm.learning_starts=63"],
            "algorithm.learning_starts=63: .* at least 64",
        ),
        (
            f"{TOY}BitFlip-v0",
            ["env.max_steps=3"],
            "env.max_steps.*did you mean 'max_episode_steps'",
        ),
        (f"{TOY}OwnGoal-v0", [], "compute_reward ignores its desired_goal"),
        (f"{TOY}AnyBits-v0", [], "compute_reward ignores its achieved_goal"),
        (
            f"{TOY}IntegerActions-v0",
            [],
            r"actions Box\(-5, 5, \(8,\), int64\); they have to be continuous, a Box of float32",
        ),
        (
            f"{TOY}Drawn-v0",
            ["+env.kwargs.render_mode=human"],
            "env.kwargs.render_mode=human: envs open no windows",
        ),
        ("PandaReach-v3", [], "name the module that registers it: env.id=MODULE:PandaReach-v3"),
        (f"{TOY}BitFlop-v0", [], "toy_tasks registers no BitFlop-v0; did you mean 'BitFlip-v0'"),
        (
            f"{TOY}BitFlip-v0",
            ["env.vectorization=threads"],
            "env.vectorization='threads'.*'sync' or 'async'",
        ),
    ],
)
def test_what_is_no_goal_task_is_refused_in_a_sentence_that_says_why(env_id, overrides, reason):
    assert re.search(reason, config_refusal(*GYMNASIUM, f"env.id={env_id}", *overrides))


@FunctionPolicy
def but_the_first(observation):
    """Flip the wrong bits, but for the first one: the goal is reached where that is right."""
    wrong = observation["observation"] != observation["desired_goal"]
    return np.where(np.arange(8) == 0, -1.0, wrong)


def test_an_episode_ends_at_the_goal_or_at_the_limit_with_seeds_that_reproduce_it():
    task = make_task(config(f"{TOY}BitFlip-v0").env)
    table = evaluate_policy(but_the_first, task, range(30))
    pd.testing.assert_frame_equal(table, evaluate_policy(but_the_first, task, range(30)))
    reached = table["outcome"] == "success"
    assert set(table["outcome"]) == {"timeout", "success"}
    assert (table.loc[~reached, "steps"] == 8).all()
    assert (table["return"] == reached - table["steps"]).all()
    failing = make_task(
        config(f"{TOY}BitFlip-v0", "env.success_key=lost", "env.failure_key=is_success").env
    )
    assert (evaluate_policy(but_the_first, failing, range(30))["outcome"] == "failure").equals(
        reached
    )


def test_the_reward_says_which_goals_are_reached_and_whether_an_episode_ends_there():
    reward = GymnasiumReward(config(f"{TOY}BitFlip-v0").env)
    goals = np.eye(8)
    rewards, reached = reward(goals, goals[[0, 1, 2, 0, 4, 5, 6, 0]])
    assert (
        reached.tolist()
        == (rewards == 0).tolist()
        == [True, True, True, False, True, True, True, False]
    )
    assert reward.terminates
    fetch, maze = (
        GymnasiumReward(compose(f"env={env}").env) for env in ("fetch_reach", "point_maze")
    )
    assert (fetch.terminates, maze.terminates) == (False, True)
    goal = np.zeros((1, 3))
    assert [fetch(goal + offset, goal)[1].item() for offset in (0.0, 0.02, 0.04)] == [
        True,
        True,
        False,
    ]
    at = np.array([[0.0, 0.0]])
    assert [maze(at + offset, at)[1].item() for offset in (0.0, 0.3, 0.35)] == [
        True,
        True,
        False,
    ]  # within 0.45 m


def test_what_the_reward_needs_of_info_is_stored_and_relabelled_with():
    model = model_of(config(f"{TOY}Priced-v0", "n_envs=2", "buffer.relabel_terminated=sb3"))
    model.learning_starts = 200
    model.learn(200)
    buffer = model.replay_buffer
    assert buffer.reward.info_keys == ("is_success", "lost", "price")
    batch, stored = buffer.sample(200), buffer.storage.data[:100]
    prices = set(np.float32(stored["info"][:, :, 2]).ravel().tolist())
    assert len(prices) > 150
    reached = (batch.next_observations["achieved_goal"] == batch.observations["desired_goal"]).all(
        dim=1
    )
    paid = (reached.float() - 1 - batch.rewards[:, 0]).numpy()
    assert np.abs(paid[:, None] - np.array(sorted(prices), np.float32)).min(axis=1).max() < 1e-6


SYNC, ASYNC = (
    ("env=gymnasium", f"env.id={TOY}BitFlip-v0", f"env.vectorization={name}")
    for name in ("sync", "async")
)
HIGHWAY = ("env=parking_sparse", "env.simulator=highway_env", "env.training_duration=2")
SIMULATED = ("env=parking_crowded", "env.training_duration=4")
VECTORIZED_TASK = ("env=steps",)
RESTORED = [SYNC, HIGHWAY, SIMULATED, VECTORIZED_TASK]


@pytest.mark.parametrize("overrides", slow_but(RESTORED, [*RESTORED, ASYNC]))
def test_training_envs_continue_identically_after_restoring(overrides, tmp_path):
    """In the middle of an episode; the next episodes are the same, too."""
    config_dir = write_option(tmp_path, "support.user_tasks.Steps")
    overrides = (*overrides, "n_envs=2", "algorithm.learning_starts=1000")
    task = make_task(compose(*overrides, config_dir=config_dir).env)
    first, second = make_training_envs(task, 2), make_training_envs(task, 2)
    first.seed(0)
    first.reset()
    size = first.action_space.shape[0]
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 2, size)).astype(np.float32)
    for action in actions[:13]:
        first.step(action)
    second.reset()
    set_state(second, get_state(first))
    step_alike(first, second, actions[13:])
    first.close()
    second.close()


@pytest.mark.parametrize(
    ("env_id", "exactly"),
    [
        (f"{TOY}BitFlip-v0", True),
        (f"{TOY}Unseeded-v0", False),
        ("FetchReach-v4", True),
        ("PointMaze_UMaze-v3", True),
    ],
)
def test_environments_that_cannot_resume_exactly_are_recognised(env_id, exactly):
    assert resumes_exactly(config(env_id, "n_envs=1").env) is exactly


def test_a_refusal_is_one_line_even_where_packages_print_notices():
    done = run_script("train", "env=gymnasium", "env.id=racetrack-v0", code=2)
    assert (done.stdout, done.stderr.count("\n")) == ("", 1)


def test_an_env_that_does_not_render_is_a_reason_to_have_no_video():
    task = make_task(config(f"{TOY}BitFlip-v0").env)
    with pytest.raises(VideoError, match="BitFlip-v0 does not render"):
        next(task.frames(constant(*[0.0] * 8), [0]))


def test_without_egl_and_osmesa_there_is_a_reason_and_no_video(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "none")
    task = make_task(compose("env=fetch_reach").env)
    monkeypatch.setattr(gymnasium_task.sys, "executable", "false")
    with pytest.raises(VideoError, match="EGL or OSMesa"):
        next(task.frames(constant(*[0.0] * 4), [0]))


def test_any_goal_task_can_be_searched(tmp_path):
    search = ("search=goal_task", "env=fetch_reach", "dry_run=true")
    call_script("tune", *search, f"output_dir={tmp_path}", code=0)


@pytest.mark.parametrize("option", options("env"))
def test_evaluate_takes_every_env(option):
    lines = [f"env={option}", *(["env.id=FetchReach-v4"] if option == "gymnasium" else [])]
    request = validate_evaluation(compose_configs("evaluate", lines)[0])
    assert request.env["name"] == option


@pytest.mark.slow
def test_ctrl_c_reaches_the_processes_of_envs_too_and_the_run_resumes(tmp_path):
    arguments = [
        "env=fetch_reach",
        "n_envs=2",
        "env.vectorization=async",
        "algorithm.learning_starts=100",
        "total_timesteps=2000",
        "evaluation.every_n_steps=null",
        "evaluation.n_scenes=5",
        "evaluation.final_n_scenes=5",
        "evaluation.video_episodes=0",
        "tracking.mlflow=false",
    ]
    process = begin(tmp_path, *arguments, options=())
    wait_until(lambda: process.poll() is not None or any(step > 200 for step in steps_of(tmp_path)))
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=60)
    directory = only_run(tmp_path)
    assert directory.read_status().status == "interrupted", errors
    assert len(list(directory.checkpoints.glob("step=*"))) == 1
    assert process.returncode == 130
    run_script("train", *arguments, f"output_dir={tmp_path}", code=0)
    assert only_run(tmp_path).read_result().steps == 2000


def steps_of(output_dir):
    return [
        json.loads(path.read_text())["step"] for path in output_dir.glob("*/*/seed=*/beat.json")
    ]
