"""Compare all that two runs left behind bit for bit, without what a clock says."""

import csv
import io
import json
import warnings
import zipfile

import numpy as np
import torch

from support.runs import CLOCKED, history, store


def differences(one, two):
    """What two runs left behind and where that is not the same, to the last bit; both are run
    directories.
    """
    ours, theirs = contents(one), contents(two)
    return sorted(
        name for name in {*ours, *theirs} if name not in ours or theirs.get(name) != ours[name]
    )


def contents(path):
    """All values of a run directory by name: arrays as bytes, the rest as it is. The state is the
    last checkpoint's.
    """
    folder = sorted((path / "checkpoints").glob("step=*"))[-1]
    found = {
        "metrics": metrics(path),
        "progress.csv": table(path / "progress.csv"),
        **events(path / "tensorboard"),
    }
    found["episodes.csv"] = (path / "episodes.csv").read_text()
    found["monitor.csv"] = table(path / "monitor.csv", comment=1, without={"t"})
    found |= state(folder / "state.pt") | {"checkpoint": folder.name}
    for archive in (folder / "replay_buffer.npz",):
        with np.load(archive) as arrays:
            found |= {f"{archive.name}/{name}": exact(arrays[name]) for name in arrays}
    for model in (
        folder / "model.zip",
        path / "models" / "best.zip",
        path / "models" / "final.zip",
    ):
        found |= {f"{model.name}/{name}": value for name, value in parameters(model).items()}
    return found


def metrics(path):
    rows = [json.loads(line) for line in (path / "metrics.jsonl").read_text().splitlines()]
    return [(row["step"], without_clock(row["metrics"])) for row in rows]


def stored(output_dir, run_id):
    """What the store has of a run: every metric with its history."""
    client = store(output_dir)
    return {
        key: history(client, run_id, key)
        for key in client.get_run(run_id).data.metrics
        if key not in CLOCKED
    }


def without_clock(values):
    return {name: value for name, value in values.items() if name not in CLOCKED}


def table(path, comment=0, without=CLOCKED):
    """Rows of a CSV file as dicts, since its columns have no order of their own."""
    if not path.exists():
        return None  # not asked for
    lines = path.read_text().splitlines()[comment:]
    return [
        {name: cell for name, cell in row.items() if name not in without}
        for row in csv.DictReader(lines)
    ]


def events(path):
    """TensorBoard's points by tag, each once."""
    if not path.exists():
        return {}
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (folder,) = path.iterdir()
    board = EventAccumulator(str(folder), size_guidance={"scalars": 0}, purge_orphaned_data=False)
    board.Reload()
    tags = without_clock(dict.fromkeys(board.Tags()["scalars"]))
    return {
        f"tensorboard/{tag}": [(event.step, event.value) for event in board.Scalars(tag)]
        for tag in tags
    }


def state(path):
    found = torch.load(path, weights_only=True)
    for name in ("cpu_s", "wall_s"):
        del found["progress"][name]
    for episode in found["model"]["ep_info_buffer"]:
        del episode["t"]
    for waiting in found["rollout"]["metrics"].values():
        for name in CLOCKED:
            waiting.pop(name, None)
    return leaves(found, path.name)


def parameters(path):
    """Parameters, optimizers and other tensors of a Stable-Baselines3 zip."""
    found = {}
    with zipfile.ZipFile(path) as archive, warnings.catch_warnings(action="ignore"):
        for name in archive.namelist():
            if name.endswith(".pth"):
                found |= leaves(torch.load(io.BytesIO(archive.read(name)), weights_only=True), name)
    return found


def leaves(node, name):
    if isinstance(node, dict | list | tuple):
        items = node.items() if isinstance(node, dict) else enumerate(node)
        return {
            key: leaf
            for part, child in items
            for key, leaf in leaves(child, f"{name}/{part}").items()
        }
    return {name: exact(node.detach().numpy()) if torch.is_tensor(node) else node}


def exact(array):
    return array.dtype.descr, array.shape, array.tobytes()
