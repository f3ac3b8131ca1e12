"""One contract for all launchers: what runs, what fails, and that the same command goes on."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from support.sweep_processes import FAILING, SLOW, begin, stages, statuses, sweep, trained, wait_until

RAY = Path(sys.executable).with_name("ray")
LOCAL = ("hydra/launcher=local",)
BASIC = ("hydra/launcher=basic",)
SLURM = ("hydra/launcher=slurm", "hydra.launcher.executor=local", "hydra.launcher.n_jobs=2")
RAY_CLUSTER = ("hydra/launcher=ray",)
LAUNCHERS = [LOCAL, BASIC, SLURM, RAY_CLUSTER]


def ray(*arguments):
    environment = {**os.environ, **FAILING, "RAY_USAGE_STATS_ENABLED": "0"}
    return subprocess.run([RAY, *arguments], check=True, capture_output=True, text=True, timeout=120, env=environment)


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
def launcher(request):
    if request.param == RAY_CLUSTER:
        pytest.importorskip("ray")
        request.getfixturevalue("cluster")
    return request.param


@pytest.mark.slow
@pytest.mark.parametrize("launcher", LAUNCHERS, indirect=True, ids=lambda value: value[0])
def test_every_run_is_trained_a_failure_is_told_and_nothing_is_done_twice(tmp_path, launcher):
    targets = "algorithm._target_=parking_exp.algorithms.SAC,support.failing_algorithms.Raises,support.failing_algorithms.IsKilled"
    done = sweep(tmp_path, targets, *launcher, timeout=300)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == (
        "error: of 3 runs, 2 failed; type the same command to go on; retry=failed runs failed ones again"
    )
    errors = {status["label"].rpartition(".")[2]: status.get("error") for status in statuses(tmp_path).values()}
    assert errors == {
        "SAC": None, "Raises": "RuntimeError: a bad <day> [bold]", "IsKilled": "killed by SIGKILL (out of memory?)"
    }  # fmt: skip
    again = sweep(tmp_path, targets, *launcher, "dry_run=true")
    assert "3 runs: 1 done, 1 failed before (retry=failed runs them again), 1 to run" in again.stdout
    assert trained(tmp_path) == [1, 1, 1]


@pytest.mark.slow
def test_on_ray_a_run_is_killed_a_node_stops_and_typed_again_the_sweep_is_completed(tmp_path, cluster):
    """The node's run is taken up by the other node, or else by the sweep that is typed again."""
    process = begin(tmp_path, "seeds=4", *SLOW, *RAY_CLUSTER)
    wait_until(
        lambda: stages(tmp_path).count("running") == 2 and len(list(tmp_path.glob("*/*/*/checkpoints/step=*"))) > 1
    )
    first, second = (status["pid"] for status in statuses(tmp_path).values() if status["status"] == "running")
    os.kill(first, signal.SIGKILL)
    (raylet,) = [one for one in psutil.Process(second).parents() if one.name() == "raylet"]
    raylet.kill()
    out, errors = process.communicate(timeout=300)
    assert process.returncode == 2, errors
    assert "killed by SIGKILL (out of memory?)" in out
    ray("start", f"--address={cluster}", "--num-cpus=1")
    done = sweep(tmp_path, "seeds=4", *SLOW, *RAY_CLUSTER, timeout=300)
    assert done.returncode == 0, done.stderr
    assert stages(tmp_path) == ["done"] * 4
    assert sum(trained(tmp_path)) >= 6  # two of them in two pieces


@pytest.mark.parametrize("launcher", [LOCAL, BASIC, SLURM], ids=lambda value: value[0])
@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on_when_typed_again(tmp_path, launcher):
    process = begin(tmp_path, "seeds=3", *SLOW, *launcher)
    wait_until(lambda: any(tmp_path.glob("*/*/*/checkpoints/step=*")))
    process.kill()
    process.communicate()
    done = sweep(tmp_path, "seeds=3", *SLOW, *launcher, timeout=300)
    assert done.returncode == 0, done.stderr
    wait_until(lambda: stages(tmp_path) == ["done"] * 3)  # submitit's jobs outlive the sweep that submitted them


@pytest.mark.parametrize("launcher", [BASIC, SLURM], ids=lambda value: value[0])
@pytest.mark.slow
def test_ctrl_c_saves_what_is_under_way(tmp_path, launcher):
    process = begin(tmp_path, "seeds=2", *SLOW[:2], "checkpoint.every_n_steps=null", *launcher)
    wait_until(lambda: any(tmp_path.glob("*/*/*/metrics.jsonl")))
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130
    wait_until(lambda: "running" not in stages(tmp_path))
    assert any(tmp_path.glob("*/*/*/checkpoints/step=*"))
