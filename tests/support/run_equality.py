"""Compare all that two runs left behind bit for bit, without what a clock says."""

import csv
import io
import json
import warnings
import zipfile

import numpy as np
import torch

from support.runs import CLOCKED, history, store


def differences(run_dir, other_run_dir):
    """Names of what two runs left behind and where that is not the same, to the last bit."""
    values = contents(run_dir)
    others = contents(other_run_dir)
    names = sorted({*values, *others})
    return [name for name in names if name not in values or others.get(name) != values[name]]


def contents(path):
    """All values of a run directory by name: arrays as bytes, the rest as it is. The state is the
    last checkpoint's.
    """
    folder = sorted((path / "checkpoints").glob("step=*"))[-1]
    values = {
        "checkpoint": folder.name,
        "metrics": metrics(path),
        "episodes.csv": (path / "episodes.csv").read_text(),
        "paths.csv.gz": (path / "paths.csv.gz").read_bytes(),
        "monitor.csv": table(path / "monitor.csv", comment=1, without={"t"}),
        "progress.csv": table(path / "progress.csv"),
        **events(path / "tensorboard"),
        **state(folder / "state.pt"),
    }
    with np.load(folder / "replay_buffer.npz") as arrays:
        for name in arrays:
            values[f"replay_buffer.npz/{name}"] = exact(arrays[name])
    models = path / "models"
    for model in (folder / "model.zip", models / "best.zip", models / "final.zip"):
        for name, value in parameters(model).items():
            values[f"{model.name}/{name}"] = value
    return values


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
    rows = list(csv.DictReader(lines))
    for row in rows:
        for name in without:
            row.pop(name, None)
    return rows


def events(path):
    """TensorBoard's points by tag, each once."""
    if not path.exists():
        return {}
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (folder,) = path.iterdir()
    board = EventAccumulator(str(folder), size_guidance={"scalars": 0}, purge_orphaned_data=False)
    board.Reload()
    tags = without_clock(dict.fromkeys(board.Tags()["scalars"]))
    points = {}
    for tag in tags:
        points[f"tensorboard/{tag}"] = [(event.step, event.value) for event in board.Scalars(tag)]
    return points


def state(path):
    saved = torch.load(path, weights_only=True)
    for name in ("cpu_s", "wall_s"):
        del saved["progress"][name]
    for episode in saved["model"]["ep_info_buffer"]:
        del episode["t"]
    for waiting in saved["rollout"]["metrics"].values():
        for name in CLOCKED:
            waiting.pop(name, None)
    return leaves(saved, path.name)


def parameters(path):
    """Parameters, optimizers and other tensors of a Stable-Baselines3 zip."""
    tensors = {}
    with zipfile.ZipFile(path) as archive, warnings.catch_warnings(action="ignore"):
        for name in archive.namelist():
            if name.endswith(".pth"):
                file = io.BytesIO(archive.read(name))
                tensors |= leaves(torch.load(file, weights_only=True), name)
    return tensors


def leaves(node, name):
    if torch.is_tensor(node):
        return {name: exact(node.detach().numpy())}
    if not isinstance(node, dict | list | tuple):
        return {name: node}
    values = {}
    for part, child in node.items() if isinstance(node, dict) else enumerate(node):
        values |= leaves(child, f"{name}/{part}")
    return values


def exact(array):
    return array.dtype.descr, array.shape, array.tobytes()
