"""Weights come from the file, all of them, or the file is refused by name."""

import io
import os
import zipfile

import pytest
import torch
from stable_baselines3.common.logger import Logger
from support.run_equality import leaves, parameters
from support.runs import make_config

from parking_exp.algorithms.build_model import build_model
from parking_exp.algorithms.model_files import load_weights, save_model
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import DamagedModelError, ModelError

CPU = torch.device("cpu")


def built(*overrides, seed=0):
    config = make_config("experiment=smoke", "algorithm.learning_starts=40", *overrides)
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed)
    model.set_logger(Logger(None, []))
    return model


@pytest.fixture(scope="module")
def model():
    """A trained one."""
    return built().learn(60)


@pytest.fixture(scope="module")
def content(model, tmp_path_factory):
    """The bytes of its file."""
    path = tmp_path_factory.mktemp("model") / "final.zip"
    save_model(model, path)
    return path.read_bytes()


def rewritten(content, **members):
    """A file whose checksums are right, with other members; None leaves one out."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            member = members.get(name.replace(".", "_"), old.read(name))
            if member is not None:
                new.writestr(name, member)
    return file.getvalue()


def tensors(value):
    file = io.BytesIO()
    torch.save(value, file)
    return file.getvalue()


def flipped(content, position, bit=0):
    changed = bytearray(content)
    changed[position] ^= 1 << bit
    return bytes(changed)


def state(model):
    return leaves([model.get_parameters(), model.log_ent_coef], "")


def test_a_saved_file_has_the_models_tensors_and_all_of_them_are_loaded(model, content, tmp_path):
    path = tmp_path / "model.zip"
    path.write_bytes(content)
    saved = parameters(path)
    assert len([name for name in saved if name.startswith("policy.pth/")]) == len(model.policy.state_dict())
    assert saved["pytorch_variables.pth/log_ent_coef"] == leaves(model.log_ent_coef, "")[""]
    other = built(seed=1)
    assert state(other) != state(model)
    load_weights(path, other)
    assert state(other) == state(model)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:3000],
        lambda content: content[:-1],
        lambda content: flipped(content, content.index(b"policy.pth") + 3000),
        lambda content: rewritten(content, policy_pth=b""),
    ],
)
def test_a_damaged_file_is_refused_and_changes_nothing(model, content, tmp_path, damage):
    path = tmp_path / "model.zip"
    path.write_bytes(damage(content))
    before = state(model)
    with pytest.raises(DamagedModelError, match=rf"^{path} is damaged") as refusal:
        load_weights(path, model)
    assert "\n" not in str(refusal.value)
    assert state(model) == before


def test_what_is_no_weight_is_not_executed(model, content, tmp_path):
    class Hostile:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "executed"),)

    path = tmp_path / "model.zip"
    for member in ("policy_pth", "pytorch_variables_pth"):
        path.write_bytes(rewritten(content, **{member: tensors(Hostile())}))
        with pytest.raises(DamagedModelError, match=rf"^{path} is damaged"):
            load_weights(path, model)
    path.write_bytes(rewritten(content, data=b'{"policy_class": {":serialized:": "no pickle"}}'))
    load_weights(path, built())  # the pickled part is not read
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (["algorithm.net_arch=[8,8]"], "actor.latent_pi.0.weight"),
        (["algorithm.net_arch=[16,16,16]"], "actor.latent_pi.4.weight"),
        (["algorithm=td3", "algorithm.net_arch=[16,16]"], "log_ent_coef"),
        (["algorithm.ent_coef=0.1"], "ent_coef_tensor"),
    ],
)
def test_a_file_of_another_model_is_refused(content, tmp_path, overrides, named):
    path = tmp_path / "model.zip"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=rf"^{path} does not fit .*{named}"):
        load_weights(path, built(*overrides))


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("pytorch_variables_pth", None, "log_ent_coef"),
        ("pytorch_variables_pth", tensors({"log_ent_coef": None}), "NoneType"),
        ("actor_optimizer_pth", None, "actor.optimizer"),
        ("actor_optimizer_pth", tensors({"state": {}, "param_groups": []}), "parameter groups"),
        ("policy_pth", tensors([1]), "list"),
    ],
)
def test_a_file_without_all_weights_is_refused(content, tmp_path, name, value, named):
    path = tmp_path / "model.zip"
    path.write_bytes(rewritten(content, **{name: value}))
    with pytest.raises(ModelError, match=rf"^{path} does not fit SAC .*{named}"):
        load_weights(path, built())
