"""Runs that are killed at any step end as if they had not been (`make test-slow`)."""

import json
import random
import subprocess
import time

import pytest
from support.run_equality import differences, stored
from support.runs import assert_store_is_whole, only_run, run_script, script

pytestmark = pytest.mark.slow


# Other algorithms, buffers and noises are interrupted within one process:
# tests/training/test_resume.py.
KINDS = {
    "sac": ("experiment=smoke",),
    "sac, normalised, FetchReach in two processes": (
        "env=fetch_reach",
        "algorithm=sac",
        "n_envs=2",
        "env.vectorization=async",
        "total_timesteps=400",
        "algorithm.learning_starts=100",
        "evaluation.every_n_steps=100",
        "evaluation.n_scenes=3",
        "evaluation.final_n_scenes=5",
    ),
    "sac, three updates in ten steps of one highway_env, gSDE": (
        "experiment=smoke",
        "env.simulator=highway_env",
        "n_envs=1",
        "updates_per_step=0.3",
        "algorithm.use_sde=true",
    ),
    "td3, EMA, Ornstein-Uhlenbeck noise, a full buffer": (
        "experiment=smoke",
        "algorithm=td3",
        "algorithm.policy_ema_half_life=30",
        "buffer.buffer_size=200",
        "n_envs=4",
        "algorithm.learning_starts=48",
        "algorithm.action_noise._target_=stable_baselines3.common.noise.OrnsteinUhlenbeckActionNoise",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_killed_at_random_moments_is_the_run_that_was_not(tmp_path, kind):
    """All files and all numbers in the store are equal to the last bit, but for clocks."""
    arguments = ("evaluation.video_episodes=0", "checkpoint.every_n_steps=25", *KINDS[kind])
    whole = tmp_path / "whole"
    pieces = tmp_path / "pieces"
    run_script("train", *arguments, f"output_dir={whole}", code=0)
    lasted = seconds_of_training(only_run(whole))
    command, keywords = script("train", *arguments, f"output_dir={pieces}")
    moments, killed, run_ids = random.Random(kind), [], set()
    # A random while after the checkpoint of each of these steps, the last in the final evaluation.
    for step in (0, 80, 160, 240, 400):
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **keywords
        )
        started = time.time()
        while process.poll() is None and not (
            is_training(pieces, started) and last_step(pieces) >= step
        ):
            time.sleep(0.01)
        time.sleep(moments.uniform(0, 0.5 if step == 400 else lasted / 8))
        if process.poll() is not None:
            break
        process.kill()
        process.wait()
        killed.append(last_step(pieces))
        run_ids.add(only_run(pieces).run_id)
    run_script("train", *arguments, f"output_dir={pieces}", code=0)
    print(f"{kind}: killed {len(killed)} times, last checkpoints {killed}")
    assert len(killed) >= 4  # it may have been done before the last
    assert len(run_ids) == 1
    assert differences(only_run(whole).path, only_run(pieces).path) == []
    assert_store_is_whole(pieces, last_step(whole))
    assert stored(whole, only_run(whole).run_id) == stored(pieces, only_run(pieces).run_id)


def last_step(output_dir):
    """The last checkpoint's step; 0 where there is none."""
    steps = [
        int(path.name.removeprefix("step=")) for path in output_dir.glob("*/*/*/checkpoints/step=*")
    ]
    return max(steps, default=0)


def is_training(output_dir, since):
    """Whether a process that was started then has made its logger, which opens this file."""
    return any(path.stat().st_mtime > since for path in output_dir.glob("*/*/seed=*/progress.csv"))


def seconds_of_training(directory):
    """From the making of the envs to the last checkpoint, before the final evaluation."""
    start = json.loads((directory.path / "monitor.csv").read_text().split("\n", 1)[0][1:])[
        "t_start"
    ]
    return (
        max(path.stat().st_mtime for path in directory.checkpoints.glob("step=*/manifest.json"))
        - start
    )
