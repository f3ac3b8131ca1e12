"""Exported policies give the model's actions."""

import re
import shutil
import subprocess
import sys

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from safetensors.numpy import load
from support.marks import slow_but
from support.models import make_model
from support.runs import ROOT, call_script, names_in, refusal, run_script

from parking_exp.algorithms import onnx_export
from parking_exp.algorithms.onnx_export import export_onnx
from parking_exp.algorithms.policy_files import export_safetensors
from parking_exp.errors import ModelError
from parking_exp.evaluation import export_run
from parking_exp.evaluation.agents import PRETRAINED_DIR

NAMES = ["achieved_goal", "desired_goal", "observation"]
FORMATS = ("onnx", "safetensors")
BLOCKED = (
    "import sys; sys.modules |= dict.fromkeys(['torch', 'stable_baselines3', 'parking_exp'])\n"
)
AGENTS = {
    **{f"td3 {features}": ("algorithm=td3", f"algorithm.features={features}")
       for features in ("raw", "ego", "ego_fine", "ego_mirrored")},
    "td3 among cars": ("algorithm=td3", "env.observation.vehicles_count=3", "env.vehicles_count=5"),
    "td3 with rays": ("algorithm=td3", "env.observation.rays=5"),
    "td3 with moving goals": ("env=parking_stop", "algorithm=td3"),
    "sac": ("algorithm=sac",),
    "sac with gSDE": ("algorithm=sac", "algorithm.use_sde=true", "algorithm.features=raw"),
    "tqc": ("algorithm=tqc",),
    "crossq": ("algorithm=crossq", "algorithm.features=raw"),
    "a shared features extractor": ("algorithm=sac", "algorithm.features=raw",
                                    "+algorithm.policy_kwargs.share_features_extractor=true"),
}  # fmt: skip
EXPENSIVE = ["sac with gSDE", "tqc", "a shared features extractor"]


def agent(name):
    """A model that has learned nothing, and says something."""
    model = make_model("experiment=smoke", *AGENTS[name], seed=3, for_training=False)
    with torch.no_grad():
        for weight in model.actor.parameters():
            weight.mul_(3)  # so that actions are not all close to zero
    return model


@pytest.mark.parametrize(
    "name", slow_but([name for name in AGENTS if name not in EXPENSIVE], AGENTS)
)
def test_an_onnx_file_gives_the_actions_of_predict_whatever_the_batch(name):
    model = agent(name)
    content = export_onnx(model)
    session = onnxruntime.InferenceSession(content)
    inputs = [(node.name, node.shape, node.type) for node in session.get_inputs()]
    sizes = {key: space.shape[0] for key, space in model.observation_space.items()}
    assert inputs == [(name, ["batch", sizes[name]], "tensor(float)") for name in NAMES]
    rng = np.random.default_rng(7)
    for batch in (1, 7, 200):
        observations = {
            name: rng.normal(0, 0.3, (batch, sizes[name])).astype(np.float32) for name in NAMES
        }
        (actions,), (expected, _) = (
            session.run(["action"], observations),
            model.predict(observations, None, None, True),
        )
        assert (actions.shape, actions.dtype) == ((batch, 2), np.float32)
        assert np.abs(actions - expected).max() < 1e-5
    assert np.abs(expected).max() > 0.1
    assert str(ROOT).encode() not in content
    assert b"site-packages" not in content
    onnx.checker.check_model(onnx.load_from_string(content), full_check=True)


def test_a_safetensors_file_has_the_weights_of_actor_and_critics():
    model = agent("sac")
    stored, weights = load(export_safetensors(model)), model.policy.state_dict()
    assert sorted(stored) == sorted(
        name for name in weights if name.startswith(("actor.", "critic."))
    )
    assert all(np.array_equal(stored[name], weights[name].numpy()) for name in stored)


def test_a_file_whose_actions_differ_is_not_written(monkeypatch):
    monkeypatch.setattr(onnx_export, "TOLERANCE", -1.0)
    with pytest.raises(ModelError, match="actions differ"):
        export_onnx(agent("sac"))


@pytest.fixture(scope="module")
def run(smoke, tmp_path_factory):
    """A copy of the smoke run."""
    copy = tmp_path_factory.mktemp("export") / "outputs"
    shutil.copytree(smoke.output_dir, copy, ignore=shutil.ignore_patterns("mlflow*", "checkpoints"))
    return next(copy.glob("*/*/seed=*"))


@pytest.mark.parametrize("file_format", FORMATS)
def test_the_command_writes_into_the_run_directory_or_to_a_path(file_format, run, tmp_path):
    done = call_script("export", f"run={run}", f"format={file_format}")
    path = run / "exports" / f"policy.{file_format}"
    assert (done.returncode, done.stderr) == (0, "")
    directory, exported, file = done.stdout.splitlines()
    assert directory == f"run directory  {run}"
    assert (
        exported
        == f"exported       final model as {file_format}, {path.stat().st_size / 1000:.1f} kB"
    )
    assert file == f"file           {path}"
    arguments = (
        f"run={run}",
        "model=best",
        f"path=made/best{path.suffix}",
        f"format={file_format}",
    )
    assert f"best model as {file_format}" in call_script("export", *arguments, cwd=tmp_path).stdout
    assert names_in(tmp_path / "made") == [f"best{path.suffix}"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["format=onx"], "format='onx'"),
        (["path=."], "path=."),
        (["path=policy.onnx", "format=safetensors"], "path=policy.onnx"),
        (["run=pretrained,parked"], "run=parked"),
        (["run={run}", "path=file/policy.onnx"], "File exists: {here}/file"),
    ],
)
def test_a_mistake_is_one_sentence_that_names_the_key(arguments, named, run, tmp_path):
    (tmp_path / "file").touch()
    words = [argument.format(run=run) for argument in arguments]
    assert refusal("export", *words, cwd=tmp_path).startswith(named.format(here=tmp_path))
    assert names_in(tmp_path) == ["file"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["run=pretrained,pretrained/parked", "path=x.onnx"],
        ["run=pretrained,pretrained/default"],
        ["run={run}", "model=final,best"],
        ["run='{run}','{link}'"],
    ],
)
def test_two_policies_for_one_file_are_refused_before_anything_is_written(arguments, run, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(run)
    names = {"run": run, "link": link}
    before = sorted(run.rglob("*"))
    words = [argument.format(**names) for argument in arguments]
    sentence = refusal("export", *words, cwd=tmp_path)
    assert sentence.startswith("two of these policies would be written to one file; export them")
    assert [entry.name for entry in tmp_path.iterdir()] == ["link"]
    assert sorted(run.rglob("*")) == before


def test_several_agents_are_exported_to_their_own_files(tmp_path):
    both = "run=pretrained,pretrained/parked"
    call_script("export", both, "format=safetensors", cwd=tmp_path, code=0)
    files = sorted(tmp_path.rglob("*.safetensors"))
    for file, name in zip(files, ("default", "parked"), strict=True):
        assert file.read_bytes() == (PRETRAINED_DIR / name / "policy.safetensors").read_bytes()
    assert [str(file.relative_to(tmp_path)) for file in files] == [
        f"outputs/pretrained/{name}/exports/policy.safetensors" for name in ("default", "parked")
    ]


def test_an_export_starts_no_telemetry_of_onnxruntime(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    environment = {"HOME": str(home), "XDG_CACHE_HOME": "", "ORT_DISABLE_TELEMETRY": ""}
    arguments = ("run=pretrained", "path=x.onnx")
    run_script("export", *arguments, cwd=tmp_path, env=environment, code=0)
    written = {file.parent.name for file in home.rglob("*") if file.is_file()}
    assert written <= {"matplotlib"}


def test_without_the_extra_onnx_is_refused(run, monkeypatch):
    monkeypatch.setattr(
        export_run, "find_spec", lambda name: None if name == "onnxruntime" else object()
    )
    assert refusal("export", f"run={run}").startswith("format=onnx: onnxruntime ")


def drive(example, run, folder):
    """Export an agent, run an example of the docs beside it, and return what that prints."""
    call_script("export", f"run={run}", "path=policy.onnx", cwd=folder, code=0)
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
    (made,) = (line for line in example.splitlines() if line.startswith("env = "))
    example = "\n".join([imports, *example.replace(made, "\n".join(options)).splitlines()[1:]])
    assert drive(example, "pretrained/parked", tmp_path) == "10 of 10 reached the slot\n"
