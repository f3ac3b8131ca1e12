"""Videos show the episodes that an evaluation has."""

import imageio.v3 as iio
import numpy as np
from support.toy_tasks import BITS, BitFlip
from support.user_policies import Flipper

from parking_exp.config.compose import compose
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.evaluation.video import record_video
from parking_exp.tasks.registry import make_task

SEEDS = [3, 0]
LAST_FRAMES = 4  # a second


def drawn_task():
    return make_task(compose("env=gymnasium", "env.id=support.toy_tasks:Drawn-v0").env)


def goal(seed):
    observation, _ = BitFlip().reset(seed=seed)
    return observation["desired_goal"]


def test_a_policy_that_plans_solves_the_filmed_episodes_as_it_did_the_evaluated_ones(tmp_path):
    task = drawn_task()
    policy = Flipper(task, seed=0)
    episodes = evaluate_policy(policy, task, SEEDS)
    assert set(episodes["outcome"]) == {"success"}

    frames = list(task.frames(policy, SEEDS))

    shown = [frame[-1, ::10, 0] / 255 for frame in frames]  # below the captions
    ends = np.cumsum(1 + episodes["steps"] + LAST_FRAMES) - 1
    assert len(shown) == ends.iloc[-1] + 1
    for seed, end in zip(SEEDS, ends, strict=True):
        assert shown[end].tolist() == goal(seed).tolist()

    path = tmp_path / "video.mp4"
    assert record_video(policy, task, SEEDS, path) is None
    assert iio.imread(path, plugin="FFMPEG").shape == (len(frames), 40, 10 * BITS, 3)
