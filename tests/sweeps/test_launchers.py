"""One contract for all launchers: what runs, what fails, and what a rerun resumes."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.sweep_processes import (
    FAILING,
    SLOW,
    begin,
    errors_by_label,
    saved,
    stages,
    sweep,
    trained,
    wait_until,
)

from parking_exp.errors import FailedRunError, UntrustedError
from parking_exp.sweeps import slurm as slurm_launcher

RAY = Path(sys.executable).with_name("ray")
BASIC = ("hydra/launcher=basic",)
SLURM = (
    "hydra/launcher=slurm",
    "hydra.launcher.parameters.mem_gb=1",
    "hydra.launcher.n_jobs=2",
)
RAY_CLUSTER = ("hydra/launcher=ray",)
LAUNCHERS = [BASIC, SLURM, RAY_CLUSTER]  # test_sweep.py is about the local one


def ray(*arguments):
    environment = {**os.environ, **FAILING, "RAY_USAGE_STATS_ENABLED": "0"}
    return subprocess.run(
        [RAY, *arguments], check=True, capture_output=True, text=True, timeout=120, env=environment
    )


@pytest.fixture(scope="module")
def cluster():
    """A Ray cluster with a head that runs nothing and two local nodes of one core each."""
    port = "6391"
    ray("start", "--head", f"--port={port}", "--num-cpus=0", "--include-dashboard=false")
    for _ in range(2):
        ray("start", f"--address=127.0.0.1:{port}", "--num-cpus=1")
    yield f"127.0.0.1:{port}"
    ray("stop", "--force")


@pytest.fixture
def slurm():
    """A Slurm with two idle CPUs; tests use the real one, and are skipped where there is none."""
    if (
        shutil.which("sinfo") is None
        or subprocess.run(["sinfo"], capture_output=True, check=False).returncode
    ):
        pytest.skip("there is no Slurm")


@pytest.fixture
def launcher(request):
    if request.param == SLURM:
        request.getfixturevalue("slurm")
    if request.param == RAY_CLUSTER:
        pytest.importorskip("ray")
        request.getfixturevalue("cluster")
    return request.param


@pytest.mark.slow
@pytest.mark.parametrize("launcher", LAUNCHERS, indirect=True, ids=":".join)
def test_every_run_is_trained_failures_are_reported_and_nothing_is_done_twice(tmp_path, launcher):
    targets = (
        "algorithm._target_=parking_exp.algorithms.SAC,"
        "support.user_algorithms.Raises,support.user_algorithms.IsKilled"
    )
    sweep(tmp_path, targets, *launcher, code=2, timeout=300)
    assert errors_by_label(tmp_path) == {
        "SAC": None,
        "Raises": "RuntimeError: a bad <day> [bold]",
        "IsKilled": "killed by SIGKILL (out of memory?)",
    }
    again = sweep(tmp_path, targets, *launcher, "dry_run=true")
    assert "3 runs, 1 to run\n" in again.stdout
    assert trained(tmp_path) == [1, 1, 1]


@pytest.mark.usefixtures("slurm")
@pytest.mark.slow
def test_a_rerun_resumes_a_sweep_that_was_killed(tmp_path):
    process = begin(tmp_path, "seeds=3", *SLOW, *SLURM)
    wait_until(lambda: saved(tmp_path))
    process.kill()
    process.communicate()
    sweep(tmp_path, "seeds=3", *SLOW, *SLURM, timeout=300)
    # Submitit's jobs outlive the sweep that submitted them.
    wait_until(lambda: stages(tmp_path) == ["done"] * 3)


@pytest.mark.usefixtures("slurm")
@pytest.mark.slow
def test_ctrl_c_saves_what_is_under_way(tmp_path):
    process = begin(tmp_path, "seeds=2", *SLOW[:2], "checkpoint.every_n_steps=null", *SLURM)
    wait_until(lambda: any(tmp_path.glob("*/*/*/metrics.jsonl")))
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130
    wait_until(lambda: "running" not in stages(tmp_path))
    assert saved(tmp_path)


@pytest.fixture
def fake(tmp_path, monkeypatch, srun):
    """Put shell scripts on PATH: the n-th call of a command does its n-th line, further ones its
    last.
    """
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(slurm_launcher, "POLL_S", 0)

    def write(name, *lines):
        cases = "".join(f"{number}) {line};;\n" for number, line in enumerate(lines[:-1], 1))
        path = tmp_path / name
        path.write_text(
            f"#!/bin/sh\necho {name} >> {tmp_path}/calls\n"
            f"case $(grep -c {name} {tmp_path}/calls) in\n{cases}*) {lines[-1]};;\nesac\n"
        )
        path.chmod(0o755)

    return write


def train_on_slurm(tmp_path, n_jobs=None):
    """Train two runs, which the fake Slurm never starts."""
    pytest.importorskip("submitit")
    launcher = slurm_launcher.SlurmLauncher(n_jobs, str(tmp_path / "submitit"), {"mem_gb": 1})
    problem = launcher.train([tmp_path / f"seed={seed}" for seed in range(2)])
    return problem, (tmp_path / "calls").read_text().split()


def test_a_job_is_waited_for_while_squeue_lists_it_or_fails_and_its_log_is_named(
    tmp_path, fake, capsys
):
    fake("sbatch", "echo Submitted batch job 7", "echo Submitted batch job 8")
    fake("squeue", "echo 7; echo 70", "echo no controller >&2; exit 1", "echo 70", "echo 8", "true")
    problem, calls = train_on_slurm(tmp_path, n_jobs=1)
    assert calls == ["sbatch", *["squeue"] * 3, "sbatch", *["squeue"] * 2]
    assert capsys.readouterr().err.count("warning: ") == 1
    assert problem.startswith(
        "2 of 2 jobs ended early, stopped by Slurm or a signal; the first log: "
    )
    assert problem.endswith(f"{tmp_path}/submitit/7/7_0_log.err")


def test_a_job_that_slurm_refuses_cancels_those_before_it(tmp_path, fake):
    fake("sbatch", "echo Submitted batch job 7", "echo over the limit >&2; exit 1")
    fake("scancel", f"echo $2 >> {tmp_path}/calls")
    fake("squeue", "true")
    with pytest.raises(FailedRunError, match="over the limit"):
        train_on_slurm(tmp_path)
    assert (tmp_path / "calls").read_text().split() == [
        "sbatch",
        "sbatch",
        "scancel",
        "7",
        "squeue",
    ]


@pytest.mark.usefixtures("srun")
def test_a_link_out_of_the_output_directory_is_refused_where_submitit_would_write(tmp_path):
    pytest.importorskip("submitit")
    output_dir = tmp_path / "outputs"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    output_dir.mkdir()
    (output_dir / ".submitit").symlink_to(elsewhere)
    launcher = slurm_launcher.SlurmLauncher(1, None, {})
    with pytest.raises(UntrustedError, match=r"\.submitit is a symbolic link that leads out"):
        launcher.train([output_dir / "sweep" / "cell" / "seed=0"])
    assert list(elsewhere.iterdir()) == []


def test_a_launcher_of_a_users_package_trains_the_runs(tmp_path):
    options = tmp_path / "my_conf" / "hydra" / "launcher"
    options.mkdir(parents=True)
    (options / "mine.yaml").write_text("_target_: support.user_launchers.Sequential\n")

    done = sweep(tmp_path, "seeds=2", f"--config-dir={tmp_path}/my_conf", "hydra/launcher=mine")

    assert trained(tmp_path) == [1, 1]
    assert "Sequential seed=0" in done.stdout
