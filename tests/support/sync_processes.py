"""Processes that sync run directories at once, or are killed while they do: `python
sync_processes.py WHAT PATHS`.

One process imports mlflow and forks the others, which start at the same moment. Nothing here
imports torch.
"""

import os
import shutil
import signal
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import sha256
from parking_exp.runs.metric_logs import MetricsLog, copy_logs, read_metrics
from parking_exp.tracking.client import ENVIRONMENT
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import sync_run

KEYS = ("eval/success_rate", "rollout/ep_rew_mean", "train/loss")
WATCHED = (
    "parking_exp/tracking/client.py",
    "parking_exp/tracking/store.py",
    "parking_exp/tracking/sync.py",
    "parking_exp/tracking/write_run.py",
    "parking_exp/tracking/embedded_store.py",
    "parking_exp/tracking/run_snapshot.py",
    "parking_exp/runs/atomic_files.py",
    "parking_exp/runs/directory.py",
    "parking_exp/runs/foreign_files.py",
    "mlflow/tracking/client.py",
    "mlflow/store/tracking/sqlalchemy_store.py",
    "mlflow/store/artifact/local_artifact_repo.py",
)


def sync(directory):
    """Sync with the store that the run was tracked in."""
    sync_run(directory, Store(directory.tracking_uri, directory.output_dir))


def grow(directory, rows, checkpoint=True):
    """Log rows as training does; then save what looks like a checkpoint."""
    log = MetricsLog(directory.path / "metrics.jsonl")
    start = max((record["step"] for record in read_metrics(log.path)), default=0)
    for step in range(start + 1, start + rows + 1):
        log.append(step, {key: step + number / 8 for number, key in enumerate(KEYS)})
    if checkpoint:
        folder = directory.checkpoints / f"step={start + rows:010d}"
        folder.mkdir(parents=True)
        (folder / "model.zip").write_bytes(b"model" * 1000)
        (folder / "replay_buffer.npz").write_bytes(b"buffer")
        write_json(folder / "state.json", {"progress": {}})
        copy_logs(directory.path, folder)
        files = {file.name: sha256(file) for file in folder.iterdir()}
        write_json(folder / "manifest.json", files)
        for stale in sorted(directory.checkpoints.iterdir())[:-2]:
            shutil.rmtree(stale)


def forked(task, *arguments):
    """Start a process of its own for a task; it exits with 0, or with a traceback and 1."""
    if (pid := os.fork()) == 0:
        status = 1
        try:
            task(*arguments)
            status = 0
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(status)
    return pid


def exit_codes(pids):
    return [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in pids]


def train(directory, rows, checkpoints):
    with directory.training_lock():
        for _ in range(checkpoints):
            grow(directory, rows)
            sync(directory)
        directory.update_status(status="done")
        sync(directory)


def killed_sync(directory, moment):
    """Sync, and kill this process at the n-th call or return in the modules that do it; 0: return
    how many there are.
    """
    passed = 0

    def count(frame, event, _):
        nonlocal passed
        if event in {"call", "return"} and frame.f_code.co_filename.endswith(WATCHED):
            passed += 1
            if passed == moment:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.setprofile(count)
    sync(directory)
    sys.setprofile(None)
    return passed


if __name__ == "__main__":
    command, *paths = sys.argv[1:]
    directories = [RunDirectory(Path(path)) for path in paths]
    os.environ.update(ENVIRONMENT)
    import mlflow.store.tracking.sqlalchemy_store  # noqa: F401 - once, before it is forked

    if command == "at-once":
        sys.exit(any(exit_codes([forked(train, directory, 180, 2) for directory in directories])))
    if command == "kill":
        first, *others = directories
        calls = killed_sync(first, 0)
        moments = [1 + number * calls // len(others) for number in range(len(others))]
        endings = [
            exit_codes([forked(killed_sync, *pair)])[0]
            for pair in zip(others, moments, strict=True)
        ]
        print(calls, *endings)
