"""Start sweeps in processes of their own, and look at their run directories and workers."""

import subprocess
import time

import psutil

from parking_exp.runs.foreign_files import read_json
from support.runs import ROOT, run_script, script

QUICK = (
    "experiment=smoke",
    "total_timesteps=60",
    "evaluation.final_n_scenes=3",
    "evaluation.every_n_steps=null",
    "evaluation.video_episodes=0",
    "tracking.mlflow=false",
    "tracking.tensorboard=false",
)
SLOW = (
    "algorithm._target_=support.user_algorithms.Lingers",
    "total_timesteps=200",
    "checkpoint.every_n_steps=50",
)
FAILING = {"PYTHONPATH": str(ROOT / "tests")}


def sweep(output_dir, *arguments, code=0, timeout=180):
    """Run a sweep to its end, and check its exit status."""
    options = (*QUICK, f"output_dir={output_dir}", *arguments)
    return run_script("train", *options, env=FAILING, timeout=timeout, code=code)


def begin(output_dir, *arguments, name="train", options=QUICK):
    """Start a sweep or a search in a session of its own, as a terminal would."""
    command, keywords = script(name, *options, f"output_dir={output_dir}", *arguments, env=FAILING)
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, **keywords
    )


def statuses(output_dir):
    """{(cell, seed): status.json} of all runs."""
    files = output_dir.glob("*/*/seed=*/status.json")
    return {(file.parents[1].name, file.parent.name): read_json(file) for file in files}


def errors_by_label(output_dir):
    """Errors of runs, by the last part of their labels."""
    by_label = {}
    for status in statuses(output_dir).values():
        by_label[status["label"].rpartition(".")[2]] = status.get("error")
    return by_label


def stages(output_dir):
    return sorted(status["status"] for status in statuses(output_dir).values())


def saved(output_dir):
    """Run directories that have a checkpoint."""
    return {path.parents[1] for path in output_dir.glob("*/*/*/checkpoints/step=*")}


def wait_until(condition, timeout=90, poll_s=0.05):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(poll_s)


def workers(output_dir):
    """Pids of the processes that train runs under an output directory."""
    pids = {status.get("pid") for status in statuses(output_dir).values()}
    return [pid for pid in pids if pid and is_alive(pid)]


def is_alive(pid):
    """Whether a process runs, which a zombie does not."""
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


def trained(output_dir):
    """How often each run was begun, from the logs of their workers."""
    logs = output_dir.glob("*/*/seed=*/log.txt")
    return sorted(log.read_text().count("env steps, in") for log in logs)
