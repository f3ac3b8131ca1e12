"""A run directory may come from elsewhere: nothing that it names is executed without the user's word."""

import shutil
import sys

import pytest
from omegaconf import OmegaConf
from support.runs import make_config, options

from parking_exp.config.allowlist import ALLOWED, check_trust
from parking_exp.config.compose import composed
from parking_exp.config.constructor_arguments import find
from parking_exp.errors import UntrustedError
from parking_exp.evaluation.evaluate_run import evaluate_run

SIDE_EFFECT = "from pathlib import Path\nPath({path!r}).touch()\ndef make(**_):\n    Path({path!r}).touch()\n    raise LookupError\nclass Made: pass\n"


@pytest.fixture
def from_elsewhere(smoke, tmp_path):
    """A function that writes a run directory with an entry of its config changed, and returns it."""
    directory = tmp_path / "run"
    (directory / "models").mkdir(parents=True)
    for name in ("config.yaml", "status.json", "models/final.zip"):
        shutil.copyfile(smoke[0].path / name, directory / name)

    def change(key, value):
        config = OmegaConf.load(directory / "config.yaml")
        OmegaConf.update(config, key, value, merge=False)
        OmegaConf.save(config, directory / "config.yaml")
        return directory

    return change


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """A module that touches a file when it is imported, and when its function is called."""
    (tmp_path / "hostile.py").write_text(SIDE_EFFECT.format(path=str(tmp_path / "touched")))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "touched"


def evaluate(directory, *arguments):
    (config,) = composed("evaluate", [f"run='{directory}'", "episodes=1", "tracking.mlflow=false", *arguments])
    return evaluate_run(config)


ACTIVATION = "algorithm.policy_kwargs.activation_fn"


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        *((key, target, key) for target in ("hostile.make", "hostile.Made") for key in (
            "algorithm._target_", "buffer._target_", "env.other_vehicles_type", "algorithm.learning_rate._target_", ACTIVATION,
            "algorithm.policy_kwargs.optimizer_class", "algorithm.policy_kwargs.features_extractor_class",
        )),
        *((key, {"_target_": "hostile.make"}, f"{key}._target_") for key in (
            "algorithm.action_noise", "algorithm.policy_kwargs.optimizer_kwargs.nested", "algorithm.ent_coef", ACTIVATION,
        )),
        ("buffer.deep", [{"_target_": "hostile.make"}], "buffer.deep.0._target_"),
        (ACTIVATION, {"_target_": "torch.nn.Tanh", "nested": {"_target_": "hostile.make"}}, f"{ACTIVATION}.nested._target_"),
        (ACTIVATION, {"_target_": "hydra.utils.get_class", "path": "hostile.Made"}, f"{ACTIVATION}._target_"),
        (ACTIVATION, {"_target_": "hydra.utils.get_method", "_args_": ["hostile.make"]}, f"{ACTIVATION}._target_"),
    ],
)  # fmt: skip
def test_what_is_not_of_a_run_is_refused_and_not_even_imported(from_elsewhere, hostile, key, value, named):
    directory = from_elsewhere(key, value)
    with pytest.raises(UntrustedError) as refusal:
        evaluate(directory)
    assert str(refusal.value).startswith(f"{named}=h")
    assert str(directory / "config.yaml") in str(refusal.value)
    assert "trust=true" in str(refusal.value)
    assert not hostile.exists()
    assert "hostile" not in sys.modules


def test_with_the_users_word_it_is_executed(from_elsewhere, hostile):
    directory = from_elsewhere("algorithm.learning_rate._target_", "hostile.make")
    with pytest.raises(Exception, match=r"hostile\.make"):
        evaluate(directory, "trust=true")
    assert hostile.exists()
    del sys.modules["hostile"]


def test_every_option_of_ours_is_trusted(tmp_path):
    noise = "algorithm.action_noise._target_=stable_baselines3.common.noise.OrnsteinUhlenbeckActionNoise"
    lines = [f"{group}={option}" for group in ("algorithm", "buffer") for option in options(group)]
    for overrides in [*([line] for line in lines), ["algorithm=td3", noise]]:
        assert check_trust(make_config(*overrides), tmp_path) is None  # it raises otherwise


def test_every_class_on_the_list_exists_under_that_name_in_a_library_of_a_run():
    for target in ALLOWED:
        found = find(target)
        assert isinstance(found, type)
        assert found.__name__ == target.rpartition(".")[2]
        assert found.__module__.partition(".")[0] == target.partition(".")[0]


@pytest.mark.parametrize(
    "target",
    [
        "os.system", "builtins.eval", "eval", "", ".", "torch.nn.", "torch.nn..ReLU", "torch.nn./tmp/torch/nn/hostile.X", None, 3, ["os.system"],
        # Functions of trusted packages, what they import from elsewhere, and methods.
        "stable_baselines3.common.save_util.load_from_pkl", "torch.load", "torch.nn.functional.relu", "torch.nn.Module.apply",
        "stable_baselines3.common.utils.deque", "stable_baselines3.common.noise.copy.deepcopy",
        # Classes whose construction does more than that.
        "stable_baselines3.common.logger.CSVOutputFormat", "parking_exp.runs.directory.RunDirectory", "subprocess.Popen",
    ],
)  # fmt: skip
def test_anything_else_is_refused_in_whatever_holds_it(tmp_path, target):
    config = make_config()
    nested = [("a", {"_target_": target})]
    extra = {**config.algorithm.arguments, "policy_kwargs": {"optimizer_kwargs": {"betas": nested}}}
    foreign = config.model_copy(update={"algorithm": config.algorithm.model_copy(update=extra)})
    with pytest.raises(UntrustedError, match=r"betas\.0\.1\._target_="):
        check_trust(foreign, tmp_path)
