"""Proofs that take minutes: `make test-slow`."""

import random
import statistics
import subprocess
import time

import pytest
from conftest import assert_store_is_whole, make_config, only_run, run_script, script

from parking_exp.training import train

pytestmark = pytest.mark.slow


def test_the_default_recipe_parks(tmp_path):
    """The median of three seeds, since one seed in five may stay below."""
    rates = []
    for seed in (0, 1, 2):
        config = make_config(f"seed={seed}", f"output_dir={tmp_path}", "evaluation.video_episodes=0")
        rates.append(train(config).metrics["final/success_rate"])
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
