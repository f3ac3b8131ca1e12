"""One contract for all launchers: what runs, what fails, and that the same command goes on."""

import os
import pickle
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from support.sweep_processes import FAILING, SLOW, begin, stages, statuses, sweep, trained, wait_until

from parking_exp.errors import FailedRunError
from parking_exp.sweeps import slurm as slurm_launcher

RAY = Path(sys.executable).with_name("ray")
LOCAL = ("hydra/launcher=local",)
BASIC = ("hydra/launcher=basic",)
SLURM = ("hydra/launcher=slurm", "hydra.launcher.executor=local", "hydra.launcher.n_jobs=2")
SLURM_CLUSTER = ("hydra/launcher=slurm", "hydra.launcher.parameters.mem_gb=1", "hydra.launcher.n_jobs=2")
RAY_CLUSTER = ("hydra/launcher=ray",)
LAUNCHERS = [LOCAL, BASIC, SLURM, SLURM_CLUSTER, RAY_CLUSTER]


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
def slurm():
    """A Slurm with two idle CPUs; tests use the real one, and are skipped where there is none."""
    if shutil.which("sinfo") is None or subprocess.run(["sinfo"], capture_output=True, check=False).returncode:
        pytest.skip("there is no Slurm")


def jobs_of_slurm():
    """{job: state} of what is queued or runs."""
    done = subprocess.run(["squeue", "-h", "-r", "-o", "%i %T"], capture_output=True, text=True, check=True)
    return dict(line.split() for line in done.stdout.splitlines())


@pytest.fixture
def launcher(request):
    if request.param == SLURM_CLUSTER:
        request.getfixturevalue("slurm")
    if request.param == RAY_CLUSTER:
        pytest.importorskip("ray")
        request.getfixturevalue("cluster")
    return request.param


@pytest.mark.slow
@pytest.mark.parametrize("launcher", LAUNCHERS, indirect=True, ids=":".join)
def test_every_run_is_trained_a_failure_is_told_and_nothing_is_done_twice(tmp_path, launcher):
    targets = "algorithm._target_=parking_exp.algorithms.SAC,support.failing_algorithms.Raises,support.failing_algorithms.IsKilled"
    done = sweep(tmp_path, targets, *launcher, timeout=300)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == (
        "error: of 3 runs, 2 failed; rerun the same command to resume; retry=failed runs failed ones again"
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


@pytest.mark.parametrize("launcher", [LOCAL, BASIC, SLURM, SLURM_CLUSTER], indirect=True, ids=":".join)
@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on_when_typed_again(tmp_path, launcher):
    process = begin(tmp_path, "seeds=3", *SLOW, *launcher)
    wait_until(lambda: any(tmp_path.glob("*/*/*/checkpoints/step=*")))
    process.kill()
    process.communicate()
    done = sweep(tmp_path, "seeds=3", *SLOW, *launcher, timeout=300)
    assert done.returncode == 0, done.stderr
    wait_until(lambda: stages(tmp_path) == ["done"] * 3)  # submitit's jobs outlive the sweep that submitted them


@pytest.mark.parametrize("launcher", [BASIC, SLURM, SLURM_CLUSTER], indirect=True, ids=":".join)
@pytest.mark.slow
def test_ctrl_c_saves_what_is_under_way(tmp_path, launcher):
    process = begin(tmp_path, "seeds=2", *SLOW[:2], "checkpoint.every_n_steps=null", *launcher)
    wait_until(lambda: any(tmp_path.glob("*/*/*/metrics.jsonl")))
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130
    wait_until(lambda: "running" not in stages(tmp_path))
    assert any(tmp_path.glob("*/*/*/checkpoints/step=*"))


@pytest.mark.slow
def test_a_job_that_is_killed_is_reported_in_one_sentence_and_the_sweep_returns(tmp_path):
    process = begin(tmp_path, "seeds=2", *SLOW, *SLURM)
    wait_until(lambda: len({path.parents[1] for path in tmp_path.glob("*/*/*/checkpoints/step=*")}) == 2)
    (worker,) = [status["pid"] for (_, seed), status in statuses(tmp_path).items() if seed == "seed=0"]
    psutil.Process(worker).parent().kill()
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    (line,) = [line for line in errors.splitlines() if "ended early" in line]
    assert line.startswith(
        "error: 1 of 2 jobs ended early; the first: stopped from outside; rerun the same command (log: "
    )
    assert stages(tmp_path) == ["done", "running"]  # the second says so for good, and its lock is free
    assert errors.splitlines()[-1] == "error: of 2 runs, 1 not done; rerun the same command to resume"


@pytest.mark.slow
def test_on_slurm_a_sweep_returns_whose_running_and_waiting_jobs_are_cancelled(tmp_path, slurm):
    process = begin(tmp_path, "seeds=3", *SLOW[:2], "checkpoint.every_n_steps=null", *SLURM_CLUSTER)
    wait_until(lambda: len(list(tmp_path.glob("*/*/*/metrics.jsonl"))) == 2)
    assert sorted(jobs_of_slurm().values()) == ["PENDING", "RUNNING", "RUNNING"]
    subprocess.run(["scancel", *jobs_of_slurm()], check=True)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    (line,) = [line for line in errors.splitlines() if "ended early" in line]
    assert line.startswith("error: 3 of 3 jobs ended early; the first: stopped by Slurm; rerun the same command (log: ")
    assert errors.splitlines()[-1] == "error: of 3 runs, 3 not done; rerun the same command to resume"
    assert stages(tmp_path) == ["interrupted", "interrupted", "pending"]
    assert len(list(tmp_path.glob("*/*/*/checkpoints/step=*"))) == 2


@pytest.mark.slow
def test_on_slurm_a_sweep_beyond_the_largest_array_becomes_several(tmp_path, slurm, monkeypatch):
    monkeypatch.setattr("parking_exp.sweeps.slurm.max_array_size", lambda config: 2)
    folder = tmp_path / "submitit"
    done = slurm_launcher.launch(str.upper, [Path("a"), Path("b"), Path("c")], "slurm", None, folder, {"mem_gb": 1})
    assert done == ["A", "B", "C"]
    assert len(list(folder.glob("*_0"))) == 1
    assert jobs_of_slurm() == {}


@pytest.mark.parametrize(
    ("config", "size"),
    [("MaxArraySize            = 1001\n", 1001), ("MaxArraySize = 0\n", 1), ("ClusterName = x\n", 1001)],
)
def test_the_largest_array_is_what_slurm_is_configured_for(config, size):
    assert slurm_launcher.max_array_size("MaxArrayTasks = 7\n" + config) == size


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """Put shell scripts on PATH: the n-th call of a command does its n-th line, further ones its last."""
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(slurm_launcher, "SLURM_POLL_S", 0)

    def write(name, *lines):
        cases = "".join(f"{number}) {line};;\n" for number, line in enumerate(lines[:-1], 1))
        script = tmp_path / name
        script.write_text(
            f"#!/bin/sh\necho {name} >> {tmp_path}/calls\n"
            f"case $(grep -c {name} {tmp_path}/calls) in\n{cases}*) {lines[-1]};;\nesac\n"
        )
        script.chmod(0o755)

    return write


@pytest.fixture
def job(tmp_path):
    """A job of Slurm that has no result yet."""
    submitit = pytest.importorskip("submitit")
    folder = tmp_path / "submitit"
    folder.mkdir()
    return submitit.SlurmJob(folder, job_id="7_1", tasks=[0])


def write_result(job, outcome, value):
    job.paths.result_pickle.write_bytes(pickle.dumps((outcome, value)))


def calls(tmp_path):
    return (tmp_path / "calls").read_text().split() if (tmp_path / "calls").exists() else []


def test_a_job_without_a_result_is_under_way_while_squeue_lists_it(tmp_path, fake, job):
    fake("squeue", "echo 7_1; echo 7_10", "echo 7_10")
    assert slurm_launcher._under_way([job]) == [job]
    assert slurm_launcher._under_way([job]) == []
    write_result(job, "success", "done")
    assert slurm_launcher._under_way([job]) == []
    assert calls(tmp_path) == ["squeue"] * 2  # a job with a result is not asked about


def test_a_failing_squeue_warns_once_until_it_works_again(tmp_path, fake, job, capsys):
    fail = "echo no controller >&2; exit 1"
    fake("squeue", fail, fail, "echo 7_1", fail, fail, "true")
    slurm_launcher._wait([job])
    assert capsys.readouterr().err == "warning: squeue failed: no controller\n" * 2
    assert len(calls(tmp_path)) == 6


@pytest.mark.parametrize(("n_jobs", "order"), [(None, "sbatch sbatch squeue"), (2, "sbatch squeue sbatch squeue")])
def test_arrays_wait_for_each_other_only_where_n_jobs_is_set(tmp_path, fake, n_jobs, order):
    pytest.importorskip("submitit")
    fake("scontrol", "echo MaxArraySize = 2")
    fake("srun", "true")
    fake("sbatch", "echo Submitted batch job 7", "echo Submitted batch job 8")
    fake("squeue", "true")
    paths = [Path("a"), Path("b"), Path("c")]
    results = slurm_launcher.launch(str.upper, paths, "slurm", n_jobs, tmp_path / "submitit", {"mem_gb": 1})
    assert calls(tmp_path) == ["scontrol", *order.split()]
    assert [str(result).partition(";")[0] for result in results] == ["stopped by Slurm"] * 3


def test_an_array_that_slurm_refuses_cancels_those_before_it(tmp_path, fake):
    pytest.importorskip("submitit")
    fake("scontrol", "echo MaxArraySize = 1")
    fake("srun", "true")
    fake("sbatch", "echo Submitted batch job 7", "echo over the limit >&2; exit 1")
    fake("scancel", f"echo $2 >> {tmp_path}/calls")
    with pytest.raises(FailedRunError, match=r"submitit cannot submit: .*over the limit"):
        slurm_launcher.launch(str.upper, [Path("a"), Path("b")], "slurm", None, tmp_path / "submitit", {"mem_gb": 1})
    assert calls(tmp_path) == ["scontrol", "sbatch", "sbatch", "scancel", "7"]


def test_the_largest_array_is_slurms_default_where_scontrol_shows_none(fake):
    fake("scontrol", "echo ClusterName = x")
    assert slurm_launcher.max_array_size(slurm_launcher._output_of("scontrol", "show", "config")) == 1001


def test_a_command_of_slurm_that_is_missing_or_hangs_is_one_error(fake, monkeypatch):
    with pytest.raises(FailedRunError, match=r"no_such_command failed: .*No such file"):
        slurm_launcher._output_of("no_such_command")

    def hang(command, timeout, **_):
        raise subprocess.TimeoutExpired(command, timeout)

    monkeypatch.setattr(subprocess, "run", hang)
    with pytest.raises(FailedRunError, match=r"squeue failed: .*timed out after 60 seconds"):
        slurm_launcher._output_of("squeue")


@pytest.mark.parametrize(
    ("trace", "sentence"),
    [
        ("Traceback:\n  File x\nValueError: a bad day\n", "ValueError: a bad day"),
        (f"ValueError: a table\n{'-' * 30}\n", "ValueError: a table"),
    ],
)
def test_a_job_that_raised_is_reported_with_the_last_line_of_its_traceback(job, trace, sentence):
    write_result(job, "error", trace)
    assert str(slurm_launcher._result(job, "slurm")) == f"{sentence} (log: {job.paths.stderr})"


@pytest.mark.parametrize(
    ("text", "sentence"), [("no rule", "no rule"), ("", "RuntimeError"), ("-" * 50, "RuntimeError")]
)
def test_another_text_of_submitits_is_reported_as_well(job, monkeypatch, text, sentence):
    write_result(job, "error", "")
    monkeypatch.setattr(job, "exception", lambda: RuntimeError(text))
    assert str(slurm_launcher._result(job, "slurm")) == f"{sentence} (log: {job.paths.stderr})"


def test_an_unreadable_result_is_an_error_of_its_job_and_others_are_returned(job):
    job.paths.result_pickle.write_bytes(b"no pickle")
    error = slurm_launcher._result(job, "slurm")
    assert isinstance(error, FailedRunError)
    assert str(error).startswith(f"cannot read {job.paths.result_pickle}: ")
    write_result(job, "success", "done")
    assert slurm_launcher._result(job, "slurm") == "done"
