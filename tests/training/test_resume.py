"""A run that was interrupted and resumed equals one that was not: every number, to the last bit."""

import os
import random
import signal
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from support.interruptions import InterruptionError, cut, cut_at
from support.marks import slow_but
from support.models import model_of
from support.run_equality import differences, leaves
from support.runs import only_run

from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.config.compose import compose
from parking_exp.errors import FailedRunError, InterruptedRunError
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.evaluation.video import record_video
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.registry import make_task
from parking_exp.training import checkpoints, rollout_state, run_session
from parking_exp.training.training_session import RolloutCallback, TrainingSession

SMOKE = (
    "experiment=smoke",
    "total_timesteps=160",
    "evaluation.every_n_steps=60",
    "checkpoint.every_n_steps=50",
    "evaluation.n_scenes=1",
    "evaluation.final_n_scenes=2",
    "evaluation.video_episodes=0",
    "env.duration=2",
    "tracking.mlflow=false",
    "tracking.progress_bar=false",
    "tracking.tensorboard=false",
)
OTHERS_BUFFER = ("~buffer.relabel_collision", "~buffer.relabel_terminated", "~buffer.goal_velocity")
HIGHWAY = "env.simulator=highway_env"
KINDS = {
    "sac": (),
    "sac with gSDE": (
        "algorithm.use_sde=true",
        "algorithm.sde_sample_freq=4",
        "updates_per_step=0.125",  # an update in four steps of both envs
        "tracking.log_interval=1",
    ),
    "sac, three updates in ten steps, in one highway_env, replay": (
        HIGHWAY,
        "n_envs=1",
        "updates_per_step=0.3",
        "buffer=replay",
    ),
    "td3, EMA, random goals, a full buffer": (
        "algorithm=td3",
        "algorithm.policy_ema_half_life=20",
        "buffer=her_random",
        "buffer.buffer_size=100",
    ),
    "td3 with Ornstein-Uhlenbeck noise, in highway_envs": (
        HIGHWAY,
        "algorithm=td3",
        "buffer=her_episode",
        "algorithm.action_noise._target_=stable_baselines3.common.noise.OrnsteinUhlenbeckActionNoise",
    ),
    "ddpg with Stable-Baselines3's HER": (
        "algorithm=ddpg",
        "buffer._target_=stable_baselines3.HerReplayBuffer",
        *OTHERS_BUFFER,
    ),
    "Stable-Baselines3's ddpg, one env, its replay": (
        "algorithm=ddpg",
        "algorithm._target_=stable_baselines3.DDPG",
        "n_envs=1",
        *OTHERS_BUFFER,
        "buffer._target_=stable_baselines3.common.buffers.DictReplayBuffer",
        "~buffer.n_sampled_goal",
        "~buffer.goal_selection_strategy",
    ),
    "tqc": ("algorithm=tqc", "buffer=her_final"),
    "crossq": ("algorithm=crossq",),
    "sac with another activation and optimizer": (
        "+algorithm.policy_kwargs={activation_fn:torch.nn.Tanh,optimizer_class:{_target_:torch.optim.AdamW,_partial_:true}}",
    ),
}


@cache
def composed_once(*overrides):
    return compose(*SMOKE, *overrides)


def configured(output_dir, *overrides):
    return composed_once(*overrides).model_copy(update={"output_dir": str(output_dir)})


def run(output_dir, *overrides, cuts=()):
    """The directory of a run that each of `cuts` interrupts in turn, and that is then finished."""
    config = configured(output_dir, *overrides)
    for interruption in cuts:
        disturb()
        with interruption, pytest.raises(FailedRunError) as failure:
            train(config)
        assert isinstance(failure.value.__cause__, InterruptionError)
    disturb()
    train(config)
    return only_run(output_dir).path


def disturb():
    """Another process would have other random numbers."""
    random.seed()
    np.random.seed()
    torch.seed()


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    return run(tmp_path_factory.mktemp("uninterrupted"))


FAST = ("td3, EMA, random goals, a full buffer", "ddpg with Stable-Baselines3's HER")


@pytest.mark.parametrize("kind", slow_but(FAST, KINDS))
def test_a_run_that_was_interrupted_twice_equals_one_that_was_not(tmp_path, kind):
    """Between checkpoints, in the middle of episodes; before the first update and later."""
    whole = run(tmp_path / "whole", *KINDS[kind])
    pieces = run(tmp_path / "pieces", *KINDS[kind], cuts=[cut_at(71), cut_at(137)])
    assert differences(whole, pieces) == []


def test_the_comparison_sees_everything(uninterrupted, tmp_path):
    """Another seed differs in every kind of state that is compared."""
    other = run(tmp_path, "seed=1")
    different = " ".join(differences(uninterrupted, other))
    for name in (
        "episodes.csv",
        "paths.csv.gz",
        "metrics",
        "monitor.csv",
        "progress.csv",
        "best.zip/",
        "final.zip/",
        "model.zip/policy.pth/",
        "model.zip/actor.optimizer.pth/",
        "model.zip/critic.optimizer.pth/",
        "model.zip/ent_coef_optimizer.pth/",
        "model.zip/pytorch_variables.pth/log_ent_coef",
        "replay_buffer.npz/rows",
        "replay_buffer.npz/rng",
        "state.pt/model/_last_obs/observation",
        "state.pt/rollout/envs/envs/simulator/position",
        "state.pt/rollout/envs/monitor/episode_returns",
        "state.pt/rollout/numpy/state/key",
        "state.pt/rollout/python/1/1",
        "state.pt/rollout/torch",
    ):
        assert name in different


def cut_in_the_third_evaluation():
    calls = iter(range(100))
    return cut(run_session, "evaluate_policy", lambda *_: next(calls) == 2)


@pytest.mark.parametrize(
    "cuts",
    [
        [lambda: cut_at(31), cut_in_the_third_evaluation],
        [
            lambda: cut(
                checkpoints,
                "fsync",
                lambda path: path.name == "state.pt" and "100" in path.parent.name,
            )
        ],
        [lambda: cut(TrainingSession, "save_final", lambda *_: True)] * 2,
    ],
    ids=[
        "before any checkpoint and in an evaluation",
        "in a checkpoint",
        "between its end and its result, twice",
    ],
)
def test_a_run_that_was_interrupted_elsewhere(uninterrupted, tmp_path, cuts):
    assert differences(uninterrupted, run(tmp_path, cuts=[make() for make in cuts])) == []


def test_a_run_whose_logs_best_model_and_newest_checkpoint_were_damaged(uninterrupted, tmp_path):
    config = configured(tmp_path)
    with cut_at(151), pytest.raises(FailedRunError):
        train(config)
    directory = only_run(tmp_path)
    newest = sorted(directory.checkpoints.glob("step=*"))[-1]
    (newest / "state.pt").write_bytes(b"")
    (directory.models / "best.zip").write_bytes(b"")
    (directory.path / "metrics.jsonl").unlink()
    (directory.path / "episodes.csv").write_bytes(
        (directory.path / "episodes.csv").read_bytes()[:40]
    )
    (directory.path / "monitor.csv").write_bytes(b"\x00" * 40)
    train(config)
    assert differences(uninterrupted, directory.path) == []


@pytest.mark.parametrize("in_evaluation", [False, True])
def test_a_run_that_a_signal_stopped_between_checkpoints(uninterrupted, tmp_path, in_evaluation):
    """A checkpoint where none is due, without the evaluation that is, and with pending metrics."""
    config = configured(tmp_path)
    original = TrainingSession.evaluate if in_evaluation else RolloutCallback._on_step

    def ask(self, *rest):
        if in_evaluation or self.num_timesteps >= 133:
            (self if in_evaluation else self.session).stop.signal_number = signal.SIGTERM
        return original(self, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TrainingSession if in_evaluation else RolloutCallback, original.__name__, ask)
        with pytest.raises(InterruptedRunError) as stopped:
            train(config)
    assert stopped.tb is not None  # it refers to the logs, which would be closed with it
    assert only_run(tmp_path).path / "progress.csv" not in open_files()
    step = 60 if in_evaluation else 134
    state = checkpoints.load_state(only_run(tmp_path).checkpoints / f"step={step:010d}")
    assert state["progress"]["evaluated"] < 60 * (step // 60) or not in_evaluation
    assert "train/critic_loss" in state["rollout"]["metrics"]["name_to_value"] or in_evaluation
    train(config)
    assert differences(uninterrupted, only_run(tmp_path).path) == []


def open_files():
    """Return the paths of the files that this process has open."""
    return [Path(os.path.realpath(file)) for file in Path("/proc/self/fd").iterdir()]


def built(*overrides):
    return model_of(composed_once(*overrides))


@pytest.mark.parametrize("overrides", [(), ("algorithm.use_sde=true",), ("algorithm=crossq",)])
def test_evaluations_and_videos_leave_the_random_generators_of_the_training_alone(
    tmp_path, overrides
):
    env, model = composed_once(*overrides).env, built(*overrides).learn(20)
    before = comparable(rollout_state.get_state(model))
    evaluate_policy(GreedyPolicy(model), make_task(env), range(3), simulator="vectorized")
    if not overrides:
        evaluate_policy(GreedyPolicy(model), make_task(env), range(3), simulator="highway_env")
        path = tmp_path / "video.mp4"
        assert record_video(GreedyPolicy(model), make_task(env), range(1), path) is None
    assert comparable(rollout_state.get_state(model)) == before


def comparable(tree):
    return leaves(checkpoints.to_tensors(tree), "")
