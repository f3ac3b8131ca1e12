"""Weights come from the file, all of them, or the file is refused by name."""

import io
import os

import pytest
import torch
from support.model_zips import rewritten
from support.models import make_model
from support.run_equality import leaves

from parking_exp.algorithms.model_files import load_weights
from parking_exp.errors import ModelError
from parking_exp.training.checkpoints import save_model


def built(*overrides, seed=0):
    return make_model("experiment=smoke", "algorithm.learning_starts=40", *overrides, seed=seed)


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
    with pytest.raises(ModelError, match=rf"^{path} is damaged") as refusal:
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
        with pytest.raises(ModelError, match=rf"^{path} is damaged"):
            load_weights(path, model)
    path.write_bytes(rewritten(content, data=b'{"policy_class": {":serialized:": "no pickle"}}'))
    load_weights(path, built())  # the pickled part is not read
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (["algorithm.net_arch=[16,16,16]"], "actor.latent_pi.4.weight"),
        (["algorithm=td3", "algorithm.net_arch=[16,16]"], "log_ent_coef"),
        (["algorithm.ent_coef=0.1"], "ent_coef_tensor"),
    ],
)
def test_a_file_of_another_model_is_refused(content, tmp_path, overrides, named):
    path = tmp_path / "model.zip"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=rf"^{path} .*{named}"):
        load_weights(path, built(*overrides))


@pytest.mark.parametrize("now", [0.0, 1.6e8, 5e9])  # 1970, 1975, 2128
def test_a_wrong_clock_keeps_no_model_from_being_saved(model, tmp_path, now, monkeypatch):
    monkeypatch.setattr("time.time", lambda: now)
    save_model(model, tmp_path / "model.zip")
    load_weights(tmp_path / "model.zip", model)
    assert (tmp_path / "model.zip").stat().st_size > 1000
