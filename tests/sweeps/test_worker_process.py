"""Processes of workers: forked from one server, or fresh ones."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from support.run_equality import differences
from support.runs import call_script, run_code, run_script, store
from support.sweep_processes import (
    QUICK,
    SLOW,
    begin,
    is_alive,
    saved,
    stages,
    statuses,
    sweep,
    wait_until,
    workers,
)

from parking_exp.results.frames import load
from parking_exp.sweeps import local
from parking_exp.sweeps.resources import available_cores, divide_cores

TWO = ("seeds=2", "hydra.launcher.n_jobs=2")
TELLS = "algorithm._target_=support.user_algorithms.Tells"
START_METHODS = [
    method
    for method in ("forkserver", "spawn")
    if method in multiprocessing.get_all_start_methods()
]
FORKED = pytest.mark.skipif(
    local.LOCAL_START_METHOD != "forkserver", reason="workers are not forked on this system"
)

SERVER = """
import sys, psutil, parking_exp.sweeps.fork_server, torch
assert "parking_exp.training.train_run" in sys.modules
assert not {"mlflow", "optuna", "sqlalchemy"} & {*sys.modules}
assert not torch.cuda.is_initialized()
assert psutil.Process().num_threads() == 1
"""


def test_the_fork_server_imports_the_training_without_threads_cuda_or_mlflow():
    run_code(SERVER)


@pytest.mark.parametrize("start_method", START_METHODS)
def test_runs_of_workers_equal_a_run_of_train_py(tmp_path, monkeypatch, start_method):
    """Two runs share a server, and with it the states of the random generators at the fork."""
    monkeypatch.setattr(local, "LOCAL_START_METHOD", start_method)
    single = tmp_path / "single"
    together = tmp_path / "together"
    options = (*QUICK, "total_timesteps=200")
    for output_dir, seeds in ((single, ["seed=1"]), (together, ["seeds=2"])):
        call_script("train", *options, *seeds, f"output_dir={output_dir}", code=0)
    (trained,) = single.glob("smoke/*/seed=1")
    (of_worker,) = together.glob("smoke/*/seed=1")
    assert differences(trained, of_worker) == []


@FORKED
def test_workers_share_a_server_but_have_cores_devices_and_the_environment_of_their_sweep(
    tmp_path, monkeypatch
):
    """Two sweeps one after the other, whose workers import no MLflow."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,5")
    options = (*QUICK, TELLS, *TWO, "tracking.mlflow=true", "torch_threads=null")
    parents = set()
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.setenv("TELLS", str(folder))
        call_script("train", *options, f"output_dir={folder / 'outputs'}", code=0)
        runs = load("smoke", output_dir=folder / "outputs").runs
        assert runs["status"].tolist() == ["done", "done"]

        told = [json.loads(path.read_text()) for path in folder.glob("*.json")]
        told.sort(key=lambda facts: (facts["cores"], facts["devices"]))
        assert [facts["cores"] for facts in told] == divide_cores(available_cores(), 2)
        assert [facts["devices"] for facts in told] == ["4", "5"]
        for facts in told:
            threads = {*facts["threads"].values(), str(facts["torch"])}
            assert threads == {str(len(facts["cores"]))}
            assert (folder / f"{facts['session']}.json").exists()
            assert facts["store_modules"] == []
        parents |= {facts["parent"] for facts in told}
    (server,) = parents
    assert psutil.Process(server).ppid() == psutil.Process().pid


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    """As all programs that start processes with `multiprocessing`, it would be imported by each of
    them.
    """
    arguments = ["train", *QUICK, "seeds=2", f"output_dir={tmp_path / 'outputs'}"]
    program = tmp_path / "mine.py"
    program.write_text(
        "import sys\n"
        "print('once')\n"
        f"sys.argv = {arguments}\n"
        "from parking_exp.cli.train import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, program], check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    logs = [path.read_text() for path in tmp_path.glob("outputs/*/*/*/log.txt")]
    assert [done.stdout.count("once"), *(log.count("once") for log in logs)] == [1, 0, 0]


def test_workers_import_the_package_of_their_sweep_and_not_that_of_the_working_directory(tmp_path):
    (tmp_path / "parking_exp").mkdir()
    (tmp_path / "parking_exp" / "__init__.py").write_text(
        "raise RuntimeError('another checkout')\n"
    )
    run_script(
        "train", *QUICK, "seeds=2", f"output_dir={tmp_path / 'outputs'}", cwd=tmp_path, code=0
    )


@pytest.mark.slow
@FORKED
def test_the_server_outlives_signals_and_ends_with_a_sweep_that_is_killed(tmp_path):
    process = begin(tmp_path, *TWO, *SLOW)
    wait_until(lambda: len(list(tmp_path.glob("*/*/*/metrics.jsonl"))) == 2)
    (server,) = {psutil.Process(worker).ppid() for worker in workers(tmp_path)}
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGUSR2):
        os.kill(server, number)
    time.sleep(1)
    assert is_alive(server)
    process.kill()
    process.communicate()
    wait_until(lambda: workers(tmp_path) == [] and not is_alive(server), timeout=5)


@pytest.mark.slow
@FORKED
def test_runs_whose_server_is_killed_end_and_the_next_sweep_resumes_them(tmp_path):
    process = begin(tmp_path, *TWO, *SLOW)
    wait_until(lambda: len(saved(tmp_path)) == 2)
    pids = workers(tmp_path)
    (server,) = {psutil.Process(worker).ppid() for worker in pids}
    psutil.Process(server).kill()
    wait_until(lambda: not any(map(is_alive, pids)), timeout=5)
    process.communicate(timeout=60)
    assert process.returncode == 2
    assert {status["error"] for status in statuses(tmp_path).values()} == {
        "its process was lost, as the server that it was forked from was killed"
    }
    sweep(tmp_path, *TWO, *SLOW)
    assert stages(tmp_path) == ["done"] * 2


def test_a_sweep_sends_checkpoints_while_its_runs_train_and_provenance_needs_no_store(tmp_path):
    """`Lingers` leaves time to look."""
    stored = tmp_path / "stored"
    untracked = tmp_path / "untracked"
    process = begin(stored, *SLOW, *TWO, "tracking.mlflow=true", "total_timesteps=100000")
    wait_until(lambda: statuses_in_store(stored) == ["RUNNING", "RUNNING"])
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert statuses_in_store(stored) == ["KILLED", "KILLED"]
    sweep(untracked, "seeds=1", "retry=failed")
    (path,) = untracked.glob("smoke/*/seed=0/provenance.json")
    assert json.loads(path.read_text())["tags"]["cpu"]
    assert not (untracked / "mlflow.db").exists()


def statuses_in_store(output_dir):
    """Status of each run as MLflow's UI shows it; none before there is a store."""
    if not (output_dir / "mlflow.db").exists():
        return []
    return [run.info.status for run in store(output_dir).search_runs(["1"])]
