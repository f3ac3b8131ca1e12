"""Exported policies: what is in the files, that they give the model's actions, and what is refused."""

import re
import shutil
import subprocess
import sys
from functools import cache

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from safetensors.numpy import load_file
from support.marks import slow_but
from support.runs import ROOT, call_script, make_config

from parking_exp.algorithms import policy_export
from parking_exp.algorithms.build_model import build_model, greedy_policy
from parking_exp.algorithms.policy_export import export_policy
from parking_exp.errors import ModelError
from parking_exp.evaluation import export_run
from parking_exp.evaluation.agents import PRETRAINED_DIR
from parking_exp.evaluation.export_run import sample_observations
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs

NAMES = ["achieved_goal", "desired_goal", "observation"]
FORMATS = {"onnx": ".onnx", "torchscript": ".pt", "safetensors": ".safetensors"}
BLOCKED = "import sys; sys.modules |= dict.fromkeys(['torch', 'stable_baselines3', 'parking_exp'])\n"
AGENTS = {
    **{f"td3 {features}": ("algorithm=td3", f"algorithm.features={features}")
       for features in ("raw", "ego", "ego_fine", "ego_mirrored")},
    "td3 with moving goals": ("env=parking_stop", "algorithm=td3"),
    "sac": ("algorithm=sac",),
    "sac with gSDE": ("algorithm=sac", "algorithm.use_sde=true", "algorithm.features=raw"),
    "tqc": ("algorithm=tqc",),
    "crossq": ("algorithm=crossq", "algorithm.features=raw"),
    "steering alone": ("algorithm=td3", "env.action.longitudinal=false", "algorithm.action_noise=null"),
    "a shared features extractor": ("algorithm=sac", "algorithm.features=raw",
                                    "+algorithm.policy_kwargs.share_features_extractor=true"),
}  # fmt: skip

EXPENSIVE = ["sac with gSDE", "tqc", "a shared features extractor"]


@cache
def agent(name):
    """A model that has learned nothing, and says something; and observations of episodes that it drives."""
    config = make_config("experiment=smoke", *AGENTS[name])
    model = build_model(config, make_training_envs(config.env, 1), seed=3, for_training=False)
    with torch.no_grad():
        for weight in model.actor.parameters():
            weight.mul_(3)  # so that actions are not all close to zero
    return model, sample_observations(greedy_policy(model), make_task(config.env), 200)


def rows(observations, wanted):
    return {name: value[wanted].astype(np.float32) for name, value in observations.items()}


def run_onnx(path, observations):
    return onnxruntime.InferenceSession(path).run(["action"], observations)[0]


def run_torchscript(path, observations):
    return torch.jit.load(path)({name: torch.as_tensor(value) for name, value in observations.items()}).numpy()


@pytest.mark.parametrize("name", slow_but([name for name in AGENTS if name not in EXPENSIVE], AGENTS))
def test_files_give_the_actions_of_predict_whatever_the_batch(name, tmp_path):
    model, observations = agent(name)
    expected, _ = model.predict(observations, deterministic=True)
    assert np.abs(expected).max() > 0.1
    for file_format, run in (("onnx", run_onnx), ("torchscript", run_torchscript)):
        path = tmp_path / "policy"
        assert export_policy(model, file_format, path, observations) < 1e-5
        for wanted in (slice(0, 1), slice(20, 27), slice(None)):
            actions = run(path, rows(observations, wanted))
            assert (actions.shape, actions.dtype) == (expected[wanted].shape, np.float32)
            assert np.abs(actions - expected[wanted]).max() < 1e-5


def test_an_onnx_file_is_one_file_of_the_whole_observation_without_paths_of_the_machine(tmp_path):
    model, observations = agent("td3 ego_mirrored")
    export_policy(model, "onnx", tmp_path / "policy.onnx", observations)
    assert [path.name for path in tmp_path.iterdir()] == ["policy.onnx"]
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    inputs = [(node.name, node.shape, node.type) for node in session.get_inputs()]
    assert inputs == [(name, ["batch", 6], "tensor(float)") for name in NAMES]
    outputs = [(node.name, node.shape, node.type) for node in session.get_outputs()]
    assert outputs == [("action", ["batch", 2], "tensor(float)")]
    content = (tmp_path / "policy.onnx").read_bytes()
    assert str(ROOT).encode() not in content
    assert b"site-packages" not in content
    onnx.checker.check_model(onnx.load_from_string(content), full_check=True)


def test_a_torchscript_file_has_no_critics_a_safetensors_file_the_actors_weights_and_the_model_is_unchanged(tmp_path):
    model, observations = agent("sac")
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    export_policy(model, "torchscript", tmp_path / "policy.pt", observations)
    loaded = torch.jit.load(tmp_path / "policy.pt")
    assert list(loaded.parameters()) == []  # frozen: weights are constants
    assert "critic" not in str(loaded.inlined_graph)
    assert export_policy(model, "safetensors", tmp_path / "policy.safetensors", observations) == 0.0
    stored = load_file(tmp_path / "policy.safetensors")
    assert sorted(stored) == sorted(name for name in before if name.startswith("actor."))
    assert all(np.array_equal(stored[name], before[name].numpy()) for name in stored)
    after = model.policy.state_dict()
    assert all(after[name].dtype == torch.float32 and torch.equal(after[name], before[name]) for name in before)


@pytest.mark.parametrize("file_format", FORMATS)
def test_a_file_whose_actions_differ_is_not_written(file_format, tmp_path, monkeypatch):
    (model, observations), path = agent("sac"), tmp_path / "policy"
    path.write_text("earlier")
    export = policy_export.EXPORTERS[file_format]
    for difference in (1.2e-4, np.nan):
        monkeypatch.setitem(policy_export.EXPORTERS, file_format, lambda *args, by=difference: export(*args) + by)
        with pytest.raises(ModelError, match=re.escape(str(path))):
            export_policy(model, file_format, path, observations)
        assert [file.read_text() for file in tmp_path.iterdir()] == ["earlier"]


@pytest.fixture(scope="module")
def run(smoke, tmp_path_factory):
    """A copy of the smoke run."""
    copy = tmp_path_factory.mktemp("export") / "outputs"
    shutil.copytree(smoke[2], copy, ignore=shutil.ignore_patterns("mlflow*", "checkpoints"))
    return next(copy.glob("*/*/seed=*"))


@pytest.mark.parametrize("file_format", FORMATS)
def test_the_command_writes_into_the_run_directory_or_to_a_path_and_prints_the_difference(file_format, run, tmp_path):
    done = call_script("export", f"run={run}", f"format={file_format}")
    path = run / "exports" / f"policy{FORMATS[file_format]}"
    assert (done.returncode, done.stderr) == (0, "")
    directory, exported, checked, file = done.stdout.splitlines()
    assert directory == f"run directory  {run}"
    assert exported == f"exported       final model as {file_format}, {path.stat().st_size / 1000:.1f} kB"
    assert file == f"file           {path}"
    assert 0 <= float(re.search(r"difference from torch (\S+) ", checked)[1]) < 1e-5
    arguments = (f"run={run}", "model=best", f"path=made/best{path.suffix}", f"format={file_format}")
    assert f"best model as {file_format}" in call_script("export", *arguments, cwd=tmp_path).stdout
    assert [path.name for path in (tmp_path / "made").iterdir()] == [f"best{path.suffix}"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["format=onx"], "format=onx"),
        (["path=."], "path=."),
        (["path=policy.onnx", "format=torchscript"], "path=policy.onnx"),
        (["run=parked"], "run=parked"),
        (["run={run}", "path=file/policy.onnx"], "File exists: {here}/file"),
    ],
)
def test_a_mistake_is_one_sentence_that_names_the_key(arguments, named, run, tmp_path):
    (tmp_path / "file").touch()
    done = call_script("export", *(argument.format(run=run) for argument in arguments), cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(f"error: {named.format(here=tmp_path)}")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_without_the_extra_onnx_is_refused(run, monkeypatch):
    monkeypatch.setattr(export_run, "find_spec", lambda name: None if name == "onnxruntime" else object())
    done = call_script("export", f"run={run}")
    assert done.stderr.startswith("error: format=onnx: onnxruntime ")


def drive(example, run, folder):
    """Export a pretrained agent and run an example of the docs beside the file; return what it prints."""
    assert call_script("export", f"run={run}", "path=policy.onnx", cwd=folder).returncode == 0
    (folder / "drive.py").write_text(BLOCKED + example)
    command = [sys.executable, "drive.py"]
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=folder).stdout


def docs_examples():
    text = (ROOT / "docs" / "exporting.md").read_text()
    return re.findall(r"^```python title=\"drive.py.*?\"\n(.*?)^```", text, re.M | re.S)


def test_the_example_of_the_docs_parks_without_torch_and_this_package(tmp_path):
    example, _ = docs_examples()
    assert len(example.splitlines()) <= 15
    assert drive(example, "pretrained", tmp_path) == "10 of 10 reached the slot\n"


@pytest.mark.slow
def test_with_the_changed_lines_of_the_docs_an_agent_parks_in_the_env_of_its_config(tmp_path):
    shutil.copy(PRETRAINED_DIR / "parked" / "config.yaml", tmp_path)
    example, changed = docs_examples()
    imports, _, *options = changed.splitlines()
    (made,) = (line for line in example.splitlines() if line.startswith("env, policy"))
    example = "\n".join([imports, *example.replace(made, "\n".join(options)).splitlines()[1:]])
    assert drive(example, "pretrained/parked", tmp_path) == "10 of 10 reached the slot\n"
