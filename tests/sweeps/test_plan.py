"""Duration estimates of sweeps and searches: from finished runs that do the same work for an env step."""

import pytest
from support.runs import make_config, type_here

from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.sweeps import plan
from parking_exp.sweeps.plan import duration_estimate

NONE_OF_KIND = "; no run of its kind has finished yet to tell the time by"


def finish(output_dir, wall_s, *overrides):
    """Write the directory of a finished run."""
    config = make_config(*overrides, f"output_dir={output_dir}")
    directory = RunDirectory(config.run_dir)
    directory.create(config)
    directory.finish(RunResult(str(directory.path), None, config.total_timesteps, {}), wall_s=wall_s)
    return directory


def planned(output_dir, *overrides):
    """What a dry run says after `N to run`."""
    done = type_here("train", *overrides, f"output_dir={output_dir}", "dry_run=true")
    assert done.returncode == 0, done.stderr
    return " ".join(done.stdout.split()).partition(" to run")[2]


def test_a_run_is_timed_by_its_cell_else_by_its_kind_in_the_sweep_else_in_the_output_directory(tmp_path):
    sweep = ("experiment=smoke", "algorithm.gamma=0.9,0.95", "seeds=2", "hydra.launcher.n_jobs=1")
    finish(tmp_path, 10, "experiment=smoke", "experiment_name=another", "algorithm.gamma=0.8")
    assert planned(tmp_path, *sweep) == ", about 40 s"
    finish(tmp_path, 20, "experiment=smoke", "algorithm.gamma=0.9")
    assert planned(tmp_path, *sweep) == ", about 60 s"
    finish(tmp_path, 30, "experiment=smoke", "algorithm.gamma=0.95")
    assert planned(tmp_path, *sweep) == ", about 50 s"
    assert planned(tmp_path, *sweep[:3], "hydra.launcher.n_jobs=2") == ", about 25 s with 2 at a time"


def test_a_kind_that_the_sweep_has_finished_is_not_timed_by_other_experiments(tmp_path):
    finish(tmp_path, 10, "experiment=smoke", "experiment_name=another", "total_timesteps=800")
    finish(tmp_path, 7, "experiment=smoke", "experiment_name=another", "algorithm.net_arch=[8,8]")
    finish(tmp_path, 20, "experiment=smoke", "algorithm.gamma=0.9")
    axes = ("experiment=smoke", "algorithm.gamma=0.9,0.95", "algorithm.net_arch=[16,16],[8,8]")
    assert planned(tmp_path, *axes, "hydra.launcher.n_jobs=1") == ", about 34 s"  # 20 + 7 + 7


def test_runs_that_do_other_work_for_an_env_step_tell_no_time(tmp_path):
    tutorial = ("experiment=tutorial", "hydra.launcher.n_jobs=1", "seeds=2")
    assert planned(tmp_path, *tutorial) == "; no run has finished yet to tell the time by"
    finish(tmp_path, 16)
    assert planned(tmp_path, *tutorial) == NONE_OF_KIND
    finish(tmp_path, 250, "experiment=tutorial", "experiment_name=mine", "total_timesteps=5000")
    assert planned(tmp_path, *tutorial) == ", about 17 min"


def test_a_plan_says_how_many_of_its_runs_it_has_a_time_for(tmp_path):
    finish(tmp_path, 16)
    axes = ("algorithm.net_arch=[64,64],[256,256]", "experiment_name=nets", "seeds=3")
    others = "for 3 of them; of the others no run of their kind has finished yet"
    assert planned(tmp_path, *axes, "hydra.launcher.n_jobs=2") == f", about 24 s with 2 at a time {others}"
    assert planned(tmp_path, *axes, "hydra.launcher.n_jobs=8") == f", about 16 s with 8 at a time {others}"


def test_the_longest_runs_tell_the_time_since_start_up_takes_most_of_short_ones(tmp_path):
    finish(tmp_path, 6, "total_timesteps=32000")
    assert duration_estimate(make_config(f"output_dir={tmp_path}"), 256_000, 1) == ", about 48 s"
    finish(tmp_path, 16)
    finish(tmp_path, 5, "experiment=smoke")
    assert duration_estimate(make_config(f"output_dir={tmp_path}"), 256_000, 1) == ", about 16 s"
    assert planned(tmp_path, "algorithm.gamma=0.9", "seeds=2", "hydra.launcher.n_jobs=1") == ", about 32 s"
    sweep = ("total_timesteps=32000,256000,512000", "seeds=[0]", "hydra.launcher.n_jobs=1")
    assert planned(tmp_path, *sweep) == ", about 32 s"


@pytest.mark.parametrize(
    "override",
    [
        "env.simulator=highway_env",
        "n_envs=128",
        "updates_per_step=0.0625",
        "algorithm.gradient_steps=4",
        "algorithm._target_=stable_baselines3.TD3",
        "algorithm.net_arch=[64,64,64]",
        "algorithm.batch_size=256",
        "device=cuda",
    ],
)
def test_what_changes_the_work_of_an_env_step_makes_another_kind(tmp_path, override):
    finish(tmp_path, 16)
    changed = make_config(f"output_dir={tmp_path}", override)
    assert duration_estimate(changed, 256_000, 1) == NONE_OF_KIND
    RunDirectory(changed.run_dir).create(changed)
    RunDirectory(changed.run_dir).finish(RunResult("", None, changed.total_timesteps, {}), wall_s=80)
    assert duration_estimate(changed, 512_000, 2) == ", about 80 s"


@pytest.mark.parametrize(
    "override", ["algorithm.features=raw", "env=parking_sparse", "buffer=replay", "evaluation.n_scenes=7", "seed=1"]
)
def test_what_hardly_changes_the_work_of_an_env_step_makes_no_other_kind(tmp_path, override):
    finish(tmp_path, 16)
    assert duration_estimate(make_config(f"output_dir={tmp_path}", override), 512_000, 1) == ", about 32 s"


def test_an_estimate_reads_one_config_a_cell_and_not_too_many(tmp_path, monkeypatch):
    for seed in range(3):
        finish(tmp_path, 16, f"seed={seed}")
    finish(tmp_path, 250, "experiment=tutorial")
    tutorial = make_config("experiment=tutorial", f"output_dir={tmp_path}")
    monkeypatch.setattr(plan, "MOST_CONFIGS", 2)
    assert duration_estimate(tutorial, 10_000, 1) == ", about 4 min"
    monkeypatch.setattr(plan, "MOST_CONFIGS", 1)  # that of the longer runs
    assert duration_estimate(tutorial, 10_000, 1) == NONE_OF_KIND


def test_a_config_that_cannot_be_read_tells_no_time(tmp_path):
    finish(tmp_path, 16)
    damaged = finish(tmp_path, 900, "total_timesteps=512000")
    (damaged.path / "config.yaml").write_text("a: [b")
    assert duration_estimate(make_config(f"output_dir={tmp_path}"), 256_000, 1) == ", about 16 s"
