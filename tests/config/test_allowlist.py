"""A run directory may come from elsewhere: nothing that it names is executed without the user's word."""

import shutil
import sys

import pytest
from omegaconf import OmegaConf
from support.runs import make_config, options, type_here

from parking_exp.config.allowlist import ALLOWED, check_trust, is_trusted
from parking_exp.config.compose import composed
from parking_exp.config.targets import find
from parking_exp.config.validate import validate
from parking_exp.errors import UntrustedError
from parking_exp.evaluation.evaluate_run import evaluate_run

SIDE_EFFECT = "from pathlib import Path\nPath({path!r}).touch()\ndef make(**_):\n    Path({path!r}).touch()\n    raise LookupError\nclass Made: pass\n"


@pytest.fixture
def from_elsewhere(smoke, tmp_path):
    """A function that writes a run directory with entries of its config changed, and returns it."""
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


@pytest.mark.parametrize("target", ["hostile.make", "hostile.Made"])
@pytest.mark.parametrize(
    "key",
    [
        "algorithm._target_",
        "algorithm.learning_rate._target_",
        "algorithm.action_noise",
        "algorithm.policy_kwargs.optimizer_kwargs.nested",
        "algorithm.ent_coef",
        "buffer._target_",
        "env.other_vehicles_type",
        "buffer.deep",
        "algorithm.policy_kwargs.activation_fn",
        "algorithm.policy_kwargs.optimizer_class",
    ],
)
def test_what_is_not_of_a_run_is_refused_and_not_even_imported(from_elsewhere, hostile, key, target):
    at_node = key.endswith(("_target_", "_type"))
    value = target if at_node else [{"_target_": target}] if key == "buffer.deep" else {"_target_": target}
    directory = from_elsewhere(key, value)
    named = key if at_node else f"{key}.0._target_" if key == "buffer.deep" else f"{key}._target_"
    with pytest.raises(UntrustedError) as refusal:
        evaluate(directory)
    assert str(refusal.value).startswith(f"{named}={target} in {directory / 'config.yaml'} is not on the allow-list; ")
    assert "trust=true" in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert not hostile.exists()
    assert "hostile" not in sys.modules


@pytest.mark.parametrize(
    ("value", "named"),
    [
        ("hostile.Made", ""),
        ({"_target_": "hydra.utils.get_class", "path": "hostile.Made"}, "._target_"),
        ({"_target_": "hydra.utils.get_object", "path": "hostile.make"}, "._target_"),
        ({"_target_": "torch.nn.Tanh", "nested": {"_target_": "hostile.make"}}, ".nested._target_"),
    ],
)
@pytest.mark.parametrize("name", ["activation_fn", "optimizer_class", "features_extractor_class"])
def test_a_class_argument_is_refused_like_a_target(from_elsewhere, hostile, name, value, named):
    directory = from_elsewhere(f"algorithm.policy_kwargs.{name}", value)
    with pytest.raises(UntrustedError) as refusal:
        evaluate(directory)
    assert str(refusal.value).startswith(f"algorithm.policy_kwargs.{name}{named}=hostile.")
    assert not hostile.exists()
    assert "hostile" not in sys.modules


@pytest.mark.parametrize(
    "node",
    [
        {"_target_": "hydra.utils.get_class", "_args_": ["hostile.Made"]},
        {"_target_": "hydra.utils.get_class", "path": "torch.nn.Tanh", "_args_": ["hostile.Made"]},
        {"_target_": "hydra.utils.get_class", "path": {"_target_": "hostile.make"}},
        {"_target_": "hydra.utils.get_method", "path": "hostile.make"},
    ],
)
def test_a_lookup_is_trusted_for_a_trusted_path_alone(from_elsewhere, hostile, node):
    with pytest.raises(UntrustedError):
        evaluate(from_elsewhere("algorithm.policy_kwargs.activation_fn", node))
    assert not hostile.exists()


@pytest.mark.parametrize(
    "activation",
    ["torch.nn.Tanh", {"_target_": "hydra.utils.get_class", "path": "torch.nn.Tanh"}, {"_target_": "torch.nn.LeakyReLU", "_partial_": True}],
)  # fmt: skip
def test_runs_with_classes_among_their_arguments_need_no_word(from_elsewhere, activation):
    assert evaluate(from_elsewhere("algorithm.policy_kwargs", {"activation_fn": activation})).exists()


def test_with_the_users_word_it_is_executed(from_elsewhere, hostile):
    directory = from_elsewhere("algorithm.learning_rate._target_", "hostile.make")
    with pytest.raises(Exception, match=r"hostile\.make"):
        evaluate(directory, "trust=true")
    assert hostile.exists()
    del sys.modules["hostile"]


def test_on_the_command_line_it_is_one_sentence(from_elsewhere, tmp_path):
    directory = from_elsewhere("algorithm.learning_rate", {"_target_": "os.mkdir", "path": str(tmp_path / "made")})
    done = type_here("evaluate", f"run={directory}", "episodes=1")
    assert done.returncode == 2
    assert done.stderr.startswith("error: algorithm.learning_rate._target_=os.mkdir in ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "made").exists()


def test_a_run_as_this_project_makes_it_needs_no_word(from_elsewhere):
    assert evaluate(from_elsewhere("seed", 5)).exists()


@pytest.mark.parametrize("group", ["algorithm", "buffer"])
def test_every_option_of_ours_is_trusted(group, tmp_path):
    for option in options(group):
        for config in composed("config", [f"{group}={option}"]):
            assert check_trust(validate(config), tmp_path) is None  # it raises otherwise
    noise = "algorithm.action_noise._target_=stable_baselines3.common.noise.OrnsteinUhlenbeckActionNoise"
    assert check_trust(make_config("algorithm=td3", noise), tmp_path) is None


@pytest.mark.parametrize("target", sorted(ALLOWED))
def test_every_class_on_the_list_exists_under_that_name_in_a_library_of_a_run(target):
    found = find(target)
    assert is_trusted(target)
    assert isinstance(found, type)
    assert found.__name__ == target.rpartition(".")[2]
    assert found.__module__.partition(".")[0] == target.partition(".")[0]


@pytest.mark.parametrize(
    "target",
    [
        "os.system", "builtins.eval", "eval", "", ".", "torch.nn.", "torch.nn..ReLU", "torch.nn./tmp/torch/nn/hostile.X", None, 3, ["os.system"],
        # Functions of trusted packages, what they import from elsewhere, and methods.
        "stable_baselines3.common.save_util.load_from_pkl", "stable_baselines3.common.utils.set_random_seed", "torch.load", "torch.nn.functional",
        "stable_baselines3.common.utils.deque", "stable_baselines3.common.noise.copy.deepcopy", "torch.nn.functional.relu", "torch.nn.Module.apply",
        # Classes whose construction does more than that.
        "stable_baselines3.common.logger.CSVOutputFormat", "stable_baselines3.common.monitor.ResultsWriter", "parking_exp.runs.directory.RunDirectory",
        "stable_baselines3.common.vec_env.SubprocVecEnv", "subprocess.Popen", "stable_baselines3.common.save_util.os.system",
    ],
)  # fmt: skip
def test_anything_else_is_not(target):
    assert not is_trusted(target)


@pytest.mark.parametrize("sequence", [list, tuple])
def test_targets_are_found_in_whatever_holds_them(tmp_path, sequence):
    nested = sequence([sequence(["a", {"_target_": "os.mkdir"}])])
    config = make_config()
    extra = {**config.algorithm.arguments, "policy_kwargs": {"optimizer_kwargs": {"betas": nested}}}
    hostile = config.model_copy(update={"algorithm": config.algorithm.model_copy(update=extra)})
    with pytest.raises(UntrustedError, match=r"betas\.0\.1\._target_=os\.mkdir"):
        check_trust(hostile, tmp_path)
