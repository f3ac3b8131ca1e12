"""Sweeps: planned, frozen, launched, interrupted in every way, rerun."""

import io
import json
import os
import signal
import time

import pytest
from support.runs import call_script, refusal, run_script
from support.sweep_processes import (
    QUICK,
    SLOW,
    begin,
    errors_by_label,
    saved,
    stages,
    statuses,
    sweep,
    trained,
    wait_until,
    workers,
)

from parking_exp.config.compose import compose_runs
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_plans import write_plan
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.launchers import make_launcher
from parking_exp.sweeps.local import LocalLauncher
from parking_exp.sweeps.monitor import Monitor
from parking_exp.sweeps.sweep import plan
from parking_exp.terminal import Screen

TWO = ("hydra.launcher.n_jobs=2",)  # at a time, on however many cores


def test_a_rerun_does_only_what_is_missing_and_retry_runs_a_failed_run_again(tmp_path):
    command = ("train", *QUICK, f"output_dir={tmp_path}", "seeds=2")
    _, failed = plan(compose_runs("config", list(command[1:])))
    directory = RunDirectory(failed.path)
    write_plan(directory, failed.config, failed.label, None)
    directory.update_status(status="failed", error="a bad day")
    first = call_script(*command, *TWO, code=2)
    assert [line.split()[0] for line in first.stderr.splitlines()] == ["started", "done", "error:"]
    assert f"runs in {tmp_path}/" in first.stdout
    assert first.stderr.endswith(
        "error: of 2 runs, 1 failed; retry=failed runs failed ones again\n"
    )
    call_script(*command, "retry=failed", code=0)
    assert stages(tmp_path) == ["done"] * 2
    assert trained(tmp_path) == [1, 1]
    before = statuses(tmp_path)
    rerun = call_script(*command, code=0)
    assert rerun.stderr == ""
    assert "2 runs, 0 to run\n" in rerun.stdout
    assert statuses(tmp_path) == before
    planned = call_script(*command[:-1], "seeds=3", "algorithm=sac,td3", "dry_run=true")
    assert "6 runs, 4 to run\n" in planned.stdout


@pytest.mark.slow
def test_every_way_to_fail_is_reported_and_the_other_runs_go_on(tmp_path):
    kinds = ["Raises", "Exits", "IsKilled", "Vanishes"]
    targets = ",".join(
        ["parking_exp.algorithms.SAC", *(f"support.user_algorithms.{kind}" for kind in kinds)]
    )
    done = sweep(tmp_path, f"algorithm._target_={targets}", code=2)
    reasons = errors_by_label(tmp_path)
    assert reasons["SAC"] is None
    assert reasons["Raises"] == "RuntimeError: a bad <day> [bold]"
    assert reasons["Exits"] == "SystemExit: 3"
    assert reasons["IsKilled"] == "killed by SIGKILL (out of memory?)"
    assert reasons["Vanishes"].startswith(
        "its process ended with status 0 and without a result; see "
    )
    for kind in kinds:
        assert (
            f"failed   _target_=support.user_algorithms.{kind} seed=0: {reasons[kind]}"
            in done.stdout
        )
    assert "of 5 runs, 4 failed" in done.stderr.splitlines()[-1]
    # A kill says nothing about the run; the others would fail again.
    again = sweep(tmp_path, f"algorithm._target_={targets}", "dry_run=true")
    assert "5 runs, 1 to run\n" in again.stdout
    again = sweep(tmp_path, f"algorithm._target_={targets}", "retry=failed", "dry_run=true")
    assert "5 runs, 4 to run\n" in again.stdout


@pytest.mark.slow
def test_a_run_that_hangs_past_its_time_is_failed(tmp_path):
    hangs = (
        "algorithm._target_=support.user_algorithms.Hangs",
        "timeout_s=2",
        "hydra/launcher=local",
    )
    sweep(tmp_path, "seeds=[0]", *hangs, code=2, timeout=60)
    (status,) = statuses(tmp_path).values()
    assert (status["status"], status["error"]) == ("failed", "ran past timeout_s=2")
    assert "killed" not in status


@pytest.mark.slow
def test_no_worker_outlives_a_sweep_that_is_killed_and_a_rerun_resumes_it(tmp_path):
    process = begin(tmp_path, "seeds=3", *SLOW, *TWO)
    wait_until(lambda: len(saved(tmp_path)) == 2)
    assert len(workers(tmp_path)) == 2
    process.kill()
    process.communicate()
    time.sleep(5)
    assert workers(tmp_path) == []
    status = json.loads(run_script("status", "--json", f"output_dir={tmp_path}").stdout)
    assert [status[stage] for stage in ("done", "running", "failed", "pending")] == [0, 0, 0, 3]
    assert max(run["step"] for run in status["cells"][0]["runs"]) >= 50
    sweep(tmp_path, "seeds=3", *SLOW, *TWO)
    assert stages(tmp_path) == ["done"] * 3
    assert trained(tmp_path) == [1, 2, 2]


@pytest.mark.slow
def test_ctrl_c_saves_checkpoints_and_leaves_within_ten_seconds(tmp_path):
    process = begin(tmp_path, "seeds=2", *SLOW[:2], "checkpoint.every_n_steps=null", *TWO)
    wait_until(lambda: len(list(tmp_path.glob("*/*/*/metrics.jsonl"))) == 2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=10)
    assert process.returncode == 130
    assert "stopping after a checkpoint" in errors
    assert errors.splitlines()[-1] == "stopped; rerun the same command to resume"
    assert workers(tmp_path) == []
    assert stages(tmp_path) == ["interrupted", "interrupted"]
    assert len(saved(tmp_path)) == 2


@pytest.mark.slow
def test_two_sweeps_at_once_share_the_work(tmp_path):
    both = [
        begin(tmp_path, "seeds=4", "hydra.launcher.n_jobs=1", *SLOW[:1], "total_timesteps=100")
        for _ in range(2)
    ]
    wait_until(lambda: stages(tmp_path).count("running") == 2)  # with one job at a time each
    for process in both:
        _, errors = process.communicate(timeout=180)
        assert process.returncode == 0, errors
    assert stages(tmp_path) == ["done"] * 4
    assert trained(tmp_path) == [1] * 4


@pytest.mark.slow
def test_a_sweep_takes_over_what_another_one_leaves(tmp_path):
    other = begin(tmp_path, "seeds=2", *SLOW, *TWO)
    wait_until(lambda: stages(tmp_path).count("running") == 2)
    ours = begin(tmp_path, "seeds=2", *SLOW, *TWO)
    wait_until(lambda: len(saved(tmp_path)) == 2)
    time.sleep(3)
    assert ours.poll() is None  # it waits, though there is nothing for it to run
    other.kill()
    other.communicate()
    out, errors = ours.communicate(timeout=180)
    assert ours.returncode == 0, errors
    assert "2 runs, 0 to run\n" in out
    assert stages(tmp_path) == ["done"] * 2
    assert trained(tmp_path) == [2, 2]


def test_the_monitor_tells_whether_a_stopped_run_has_a_checkpoint(tmp_path):
    (run,) = plan(compose_runs("config", [*QUICK, "seeds=1", f"output_dir={tmp_path}"]))
    directory, out = RunDirectory(run.path), Screen(file=io.StringIO(), width=200)
    write_plan(directory, run.config, "her", None)

    def lines():
        return out.file.getvalue().splitlines()

    with Monitor(lambda: [run.path], 1, out):
        for _ in range(2):
            with directory.supervisor_lock():
                directory.update_status(status="running")
                wait_until(lambda: lines()[-1:] == ["started  her seed=0"])
            wait_until(lambda: lines()[-1].startswith("stopped"))
            (run.path / "checkpoints" / "step=300").mkdir(parents=True, exist_ok=True)
    assert lines() == [
        "started  her seed=0", "stopped  her seed=0, before its first checkpoint",
        "started  her seed=0", "stopped  her seed=0, at step 300",
    ]  # fmt: skip


def test_a_run_whose_frozen_config_is_broken_or_of_another_run_fails(tmp_path):
    broken, another, last = plan(
        compose_runs("config", [*QUICK, "seeds=3", f"output_dir={tmp_path}"])
    )
    for run, config in ((broken, broken.config), (another, last.config)):
        write_plan(RunDirectory(run.path), config, run.label, None)
    (broken.path / "config.yaml").write_text("a: [b")
    paths = [broken.path, another.path]
    LocalLauncher(1).train(paths)
    assert [read_state(path).stage for path in paths] == ["failed"] * 2
    assert all(str(path / "config.yaml") in read_state(path).reason for path in paths)


@pytest.mark.slow
def test_the_configs_of_queued_runs_are_frozen(tmp_path):
    """The experiment file changes while the sweep runs: its queued runs do not, new ones would."""
    (tmp_path / "mine" / "experiment").mkdir(parents=True)
    file = tmp_path / "mine" / "experiment" / "mine.yaml"
    text = (
        "# @package _global_\ndefaults: [smoke]\nexperiment_name: mine\nalgorithm: {gamma: 0.9}\n"
    )
    file.write_text(text)
    own = (f"--config-dir={tmp_path / 'mine'}", "experiment=mine", *QUICK[1:])
    process = begin(tmp_path / "outputs", "seeds=2", "hydra.launcher.n_jobs=1", options=own)
    wait_until(lambda: "running" in stages(tmp_path / "outputs"))
    file.write_text(text.replace("0.9", "0.8"))
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    configs = sorted((tmp_path / "outputs").glob("mine/*/seed=*/config.yaml"))
    assert [config.parent.name for config in configs] == ["seed=0", "seed=1"]
    assert all("gamma: 0.9" in config.read_text() for config in configs)


SLURM = ("hydra/launcher=slurm",)


def test_a_plan_warns_of_a_ratio_far_from_what_the_number_of_envs_suggests(tmp_path):
    done = call_script(
        "train", "n_envs=8", "seeds=2", "dry_run=true", f"output_dir={tmp_path}", code=0
    )
    assert done.stderr.startswith(
        "warning: updates_per_step=0.03125 is far from 1, which n_envs=8 suggests; envs=few "
    )
    assert done.stderr.count("\n") == 1


def test_a_launcher_in_an_experiment_file_makes_the_sweep_use_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))  # without Slurm's commands
    path = tmp_path / "mine.yaml"
    path.write_text("# @package _global_\ndefaults: [smoke, {override /hydra/launcher: slurm}]\n")
    command = ("train", f"experiment={path}", f"output_dir={tmp_path / 'outputs'}")
    assert "srun" in refusal(*command)
    path.write_text("# @package _global_\ndefaults: [smoke]\nhydra: {launcher: {n_jobs: 0}}\n")
    assert refusal(*command, "seeds=2").startswith("hydra.launcher.n_jobs=0")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.usefixtures("srun")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["retry=all"], "retry='all'"),
        (["dry_run=maybe"], "dry_run='maybe'"),
        (["hydra/launcher=locl"], "did you mean 'local'?"),
        (["hydra/launcher=ray_a"], "hydra/launcher=ray_a"),
        (["hydra.launcher.n_jobs=0"], "hydra.launcher.n_jobs=0"),
        (["hydra/launcher=ray"], "ray"),  # not installed, or without a cluster
        (
            [*SLURM, "hydra.launcher.parameters.slurm_nodelist=n1"],
            "hydra.launcher.parameters.slurm_nodelist",
        ),
        ([*SLURM, "+hydra.launcher.parameters.slurm_qso=high"], "qso"),
        ([*SLURM, "hydra.launcher.parameters.timeout_min=long"], "timeout_min"),
    ],
)
def test_a_sweep_or_launcher_that_is_wrong_is_refused_before_anything_is_made(
    tmp_path, arguments, words
):
    command = ("train", *QUICK, f"output_dir={tmp_path / 'outputs'}", "seeds=2")
    assert words in refusal(*command, *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("srun")
def test_keys_of_submitit_that_the_yaml_lists_or_that_are_added_are_accepted():
    keys = (
        "hydra.launcher.parameters.slurm_qos=high",
        "+hydra.launcher.parameters.slurm_nodelist=n1",
    )
    runs = compose_runs("config", [*SLURM, *keys])
    launcher = make_launcher([run.cell for run in runs])
    assert launcher.parameters["slurm_nodelist"] == "n1"


@pytest.mark.slow
def test_a_worker_that_slurm_signals_twice_still_saves_its_checkpoint(tmp_path):
    process = begin(
        tmp_path, "seeds=[0]", *SLOW[:2], "checkpoint.every_n_steps=null", "hydra/launcher=local"
    )
    wait_until(lambda: any(tmp_path.glob("*/*/*/metrics.jsonl")))
    (worker,) = workers(tmp_path)
    os.kill(worker, signal.SIGTERM)
    log = next(tmp_path.glob("*/*/*/log.txt"))
    wait_until(lambda: "stopping after a checkpoint" in log.read_text(), poll_s=0.001)
    os.kill(worker, signal.SIGTERM)
    process.communicate(timeout=30)
    assert stages(tmp_path) == ["interrupted"]
    assert len(saved(tmp_path)) == 1
