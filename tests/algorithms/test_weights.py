"""Weights come from the file, all of them, or the file is refused in a sentence that names it."""

import io
import os
import random
import re
import zipfile

import pytest
import torch
from stable_baselines3.common.logger import Logger
from support.run_equality import leaves, parameters
from support.runs import make_config

from parking_exp.algorithms.build import build_model
from parking_exp.algorithms.model_files import load_weights, read_weights, save_model
from parking_exp.cli.command import fail
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import DamagedModelError, ModelError
from parking_exp.runs.files import replacing
from parking_exp.training import checkpoints
from parking_exp.training.checkpoints import Progress

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


def member(content, name):
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return archive.read(name)


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


def test_all_weights_of_a_file_are_loaded(model, content, tmp_path):
    (tmp_path / "model.zip").write_bytes(content)
    other = built(seed=1)
    assert state(other) != state(model)
    load_weights(tmp_path / "model.zip", other)
    assert state(other) == state(model)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda content: b"", "is empty"),
        (lambda content: content[:3000], "is damaged (File is not a zip file)"),
        (lambda content: content[:-1], "is damaged ("),
        (lambda content: flipped(content, content.index(b"policy.pth") + 3000), "is damaged (the checksum of policy.pth is wrong)"),
        (lambda content: flipped(content, content.index(b"data") + 300), "is damaged (the checksum of data is wrong)"),
        (lambda content: rewritten(content, policy_pth=b""), "policy.pth, is damaged (File is not a zip file)"),
        (lambda content: rewritten(content, policy_pth=flipped(member(content, "policy.pth"), 9000)), "policy.pth, is damaged (the checksum of "),
        (lambda content: rewritten(content, pytorch_variables_pth=tensors([1])), "is damaged ("),
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused_and_changes_nothing(model, content, tmp_path, damage, words):
    path = tmp_path / "model.zip"
    path.write_bytes(damage(content))
    before = state(model)
    with pytest.raises(DamagedModelError) as refusal:
        load_weights(path, model)
    assert str(refusal.value).startswith(str(path))
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert state(model) == before


@pytest.mark.slow
def test_any_byte_may_be_flipped(model, content):
    """All of what describes the zip, and some of the rest: the same weights, or a refusal; never other ones."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        positions = set(range(archive.start_dir, len(content), 2))
        for one in archive.infolist():
            positions |= set(range(one.header_offset, one.header_offset + 30 + len(one.filename), 2))
    positions |= set(random.Random(0).sample(range(len(content)), 200))
    expected, refused = leaves(read_weights(content, "model.zip", CPU), ""), 0
    for position in sorted(positions):
        try:
            found = leaves(read_weights(flipped(content, position, position % 8), "model.zip", CPU), "")
        except DamagedModelError:
            refused += 1
            continue
        # Without a part of it, it does not fit.
        assert found.items() <= expected.items()
    assert refused > 300


def test_any_byte_of_tensors_may_be_flipped_where_the_outer_checksum_fits(model, content):
    policy, refused = member(content, "policy.pth"), 0
    expected = leaves(read_weights(content, "model.zip", CPU), "")
    for position in range(0, len(policy), 97):
        damaged = rewritten(content, policy_pth=flipped(policy, position, 3))
        try:
            assert leaves(read_weights(damaged, "model.zip", CPU), "") == expected
        except DamagedModelError:
            refused += 1
    assert refused > 100


def test_what_is_no_weight_is_named_and_not_executed(model, content, tmp_path):
    class Hostile:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "executed"),)

    path = tmp_path / "model.zip"
    path.write_bytes(rewritten(content, policy_pth=tensors(Hostile())))
    with pytest.raises(
        DamagedModelError, match=r"model.zip, policy.pth, names posix.mkdir, which is no weight, and is not"
    ):
        load_weights(path, model)
    assert not (tmp_path / "executed").exists()


def test_names_in_a_file_do_not_reach_the_terminal_as_they_are(model, content, tmp_path, capsys):
    file = io.BytesIO(content)
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("\x1b[31mred\x07\n.pth", tensors({}))
    (tmp_path / "model.zip").write_bytes(file.getvalue())
    with pytest.raises(ModelError) as refusal:
        load_weights(tmp_path / "model.zip", model)
    assert str(refusal.value).endswith("(it has \x1b[31mred\x07\n besides)")
    with pytest.raises(SystemExit):
        fail(refusal.value)
    said = capsys.readouterr().err
    assert said.endswith(r"(it has \x1b[31mred\x07\n besides)" + "\n")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["algorithm.net_arch=[8,8]"], "policy.actor.latent_pi.0.weight is float32 of shape [16, 19], and not float32 of shape [8, 19]"),
        (["algorithm.net_arch=[16,16,16]"], "policy has other parameters (actor.latent_pi.4.bias, actor.latent_pi.4.weight, critic.qf0.6.bias, critic.qf0.6.weight, ...)"),
        (["algorithm=td3", "algorithm.net_arch=[16,16]"], "it has ent_coef_optimizer, log_ent_coef besides"),
        (["algorithm.ent_coef=0.1"], "it lacks ent_coef_tensor and it has ent_coef_optimizer, log_ent_coef besides"),
    ],
)  # fmt: skip
def test_a_file_of_another_model_is_refused_and_changes_nothing(content, tmp_path, overrides, words):
    (tmp_path / "model.zip").write_bytes(content)
    other = built(*overrides)
    before = leaves(other.get_parameters(), "")
    with pytest.raises(ModelError, match=re.escape(f"as its config.yaml describes it ({words})")):
        load_weights(tmp_path / "model.zip", other)
    assert leaves(other.get_parameters(), "") == before


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("pytorch_variables_pth", None, "it lacks log_ent_coef"),
        ("pytorch_variables_pth", tensors({"log_ent_coef": None}), "log_ent_coef is a NoneType, and not float32 of shape [1]"),
        ("actor_optimizer_pth", None, "it lacks actor.optimizer"),
        ("actor_optimizer_pth", tensors({"state": {}, "param_groups": []}), "loaded state dict has a different number of parameter groups"),
        ("actor_optimizer_pth", tensors({}), "actor.optimizer has other parameters (param_groups, state)"),
        ("policy_pth", tensors([1]), "policy is a list, and not a dict"),
    ],
)  # fmt: skip
def test_a_file_without_all_weights_is_refused(model, content, tmp_path, name, value, words):
    (tmp_path / "model.zip").write_bytes(rewritten(content, **{name: value}))
    with pytest.raises(ModelError, match=re.escape(words)):
        load_weights(tmp_path / "model.zip", model)


def test_a_file_that_can_not_be_written_leaves_the_one_before_and_no_rest(tmp_path):
    path = tmp_path / "final.zip"
    path.write_bytes(b"before")
    with pytest.raises(OSError, match="full"), replacing(path) as temporary:
        temporary.write_bytes(b"half of it")
        raise OSError("full")
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: flipped(content, content.index(b"policy.pth") + 3000),
        lambda content: rewritten(content, actor_optimizer_pth=None),
    ],
)
def test_a_damaged_model_in_a_checkpoint_whose_manifest_fits_is_named(model, tmp_path, monkeypatch, damage):
    """As a disk leaves it that went wrong before the hash was taken."""
    best = tmp_path / "best.zip"
    with monkeypatch.context() as patch:
        save = type(model).save
        patch.setattr(
            type(model), "save", lambda self, path: save(self, path) or path.write_bytes(damage(path.read_bytes()))
        )
        folder = checkpoints.save(tmp_path / "run" / "checkpoints", model, Progress(step=60), best, 2)
    assert checkpoints.check(folder) is None
    with pytest.raises(ModelError, match=rf"^{folder / 'model.zip'}"):
        checkpoints.restore(folder, built(seed=1), best)


def test_a_saved_file_has_the_models_tensors(model, content, tmp_path):
    (tmp_path / "model.zip").write_bytes(content)
    found = parameters(tmp_path / "model.zip")
    assert len([name for name in found if name.startswith("policy.pth/")]) == len(model.policy.state_dict())
    assert found["pytorch_variables.pth/log_ent_coef"] == leaves(model.log_ent_coef, "")[""]
