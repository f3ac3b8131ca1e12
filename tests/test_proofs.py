"""Proofs that take minutes: `make test-slow`."""

import itertools
import multiprocessing
import random
import statistics
import subprocess
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from conftest import assert_store_is_whole, make_config, only_run, options, run_script, script
from exactness import KINDS, actions_of, record, repeat
from test_simulator import different_scenes

from parking_exp.algorithms import build_model, greedy_policy
from parking_exp.envs.vector import make_training_envs
from parking_exp.training import train

pytestmark = pytest.mark.slow


def test_the_default_recipe_parks(tmp_path):
    """The median of three seeds, since one seed in five may stay below."""
    rates = []
    for seed in (0, 1, 2):
        config = make_config(f"seed={seed}", f"output_dir={tmp_path}", "evaluation.video_episodes=0")
        rates.append(train(config).metrics["certified/success_rate"])
    assert statistics.median(rates) >= 0.9


@pytest.mark.parametrize("overrides", [(), ("algorithm=td3",), ("buffer=replay", "n_envs=1")])
def test_a_run_killed_again_and_again_loses_nothing(tmp_path, overrides):
    arguments = ("experiment=smoke", f"output_dir={tmp_path}", "evaluation.video_episodes=0", *overrides)
    command, keywords = script("train", *arguments)
    moments = random.Random(0)
    for _ in range(5):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **keywords)
        time.sleep(moments.uniform(1, 12))
        process.kill()
        process.wait()
    run_ids = {only_run(tmp_path).run_id}
    done = run_script("train", *arguments)
    assert done.returncode == 0, done.stderr
    run_ids.add(only_run(tmp_path).run_id)
    assert len(run_ids - {None}) == 1
    assert_store_is_whole(tmp_path, 400)


@pytest.fixture(scope="module")
def trained_policy():
    """A policy that parks most of the time, and sometimes well."""
    config = make_config("total_timesteps=20000")
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    return greedy_policy(model.learn(config.total_timesteps))


@pytest.mark.parametrize("option", options("env"))
def test_200_000_steps_on_1_000_scenes_without_one_mismatch(option, trained_policy):
    config, block = make_config(f"env={option}", "algorithm.learning_starts=100000").env, 50
    steps, scenes, waiting = 0, 0, []
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        for kind in itertools.cycle(KINDS):
            if steps >= 200_000 and scenes >= 1000:
                break
            seeds = range(scenes, scenes + block)
            rng = np.random.default_rng(scenes)
            starts, records = record(config, seeds, actions_of(kind, rng, (block, 2), trained_policy))
            waiting.append(pool.submit(repeat, config, seeds, starts, records))
            steps, scenes = steps + sum(len(episode) for episode in records), scenes + block
        mismatches = [mismatch for future in waiting for mismatch in future.result()]
    print(f"{option}: {steps} steps on {scenes} scenes, {len(mismatches)} mismatches")
    assert mismatches == []


@pytest.mark.parametrize("parked", [0, 10])
def test_10_000_scenes_bit_for_bit(parked):
    assert different_scenes(range(10_000), parked) == []
