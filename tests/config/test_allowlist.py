"""A stored config may come from elsewhere: no class outside the allow-list is executed unless the
user trusts it.
"""

import re
import shutil
import sys

import pytest
from omegaconf import OmegaConf
from support.runs import ROOT, evaluate_stored

from parking_exp.config.allowlist import ALLOWED, check_trust
from parking_exp.config.compose import compose
from parking_exp.dotted_paths import import_object
from parking_exp.errors import UntrustedError
from parking_exp.runs.run_files import read_config

SIDE_EFFECT = """
from pathlib import Path
Path({path!r}).touch()
def make(**_):
    Path({path!r}).touch()
    raise LookupError
class Made: pass
"""
ACTIVATION = "algorithm.policy_kwargs.activation_fn"


@pytest.fixture
def foreign_run(smoke, tmp_path):
    """A function that writes a run directory with an entry of its config changed, and returns
    it.
    """
    directory = tmp_path / "run"
    (directory / "models").mkdir(parents=True)
    for name in ("config.yaml", "status.json", "models/final.zip"):
        shutil.copyfile(smoke.path / name, directory / name)

    def change(key, value):
        config = OmegaConf.load(directory / "config.yaml")
        OmegaConf.update(config, key, value, merge=False)
        OmegaConf.save(config, directory / "config.yaml")
        return directory

    return change


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """The file that module `hostile` touches when it is imported, and when its function is
    called.
    """
    (tmp_path / "hostile.py").write_text(SIDE_EFFECT.format(path=str(tmp_path / "touched")))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "touched"


def test_evaluating_a_foreign_run_refuses_its_class_until_the_user_trusts_it(foreign_run, hostile):
    directory = foreign_run("algorithm.learning_rate._target_", "hostile.make")
    with pytest.raises(
        UntrustedError, match=r"^algorithm\.learning_rate\._target_=hostile\.make.*trust=true"
    ):
        evaluate_stored(directory)
    assert not hostile.exists()
    with pytest.raises(Exception, match=r"hostile\.make"):
        evaluate_stored(directory, "trust=true")
    assert hostile.exists()
    del sys.modules["hostile"]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"id": "hostile:Env-v0"}, "env.id=hostile:Env-v0"),
        ({"kwargs": {"config": {"other_vehicles_type": "hostile.Made"}}}, "env.kwargs.config="),
        ({"kwargs": {"xml_file": "/etc/passwd"}}, "env.kwargs.xml_file=/etc/passwd"),
        ({"metrics": ["hostile.metric"]}, "env.metrics.0=hostile.metric"),
    ],
)
def test_an_environment_imports_and_opens_nothing_until_the_user_trusts_it(
    foreign_run, hostile, changes, named
):
    env = OmegaConf.to_container(OmegaConf.load(ROOT / "conf/env/gymnasium.yaml").env)
    directory = foreign_run("env", {**env, "id": "highway-v0", **changes})
    with pytest.raises(UntrustedError, match=rf"^{re.escape(named)}.*trust=true"):
        evaluate_stored(directory)
    assert not hostile.exists()


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        *(
            (key, "hostile.Made", key)
            for key in (
                "algorithm._target_",
                "buffer._target_",
                "algorithm.learning_rate._target_",
                ACTIVATION,
                "algorithm.policy_kwargs.optimizer_class",
                "algorithm.policy_kwargs.features_extractor_class",
            )
        ),
        *(
            (key, {"_target_": "hostile.make"}, f"{key}._target_")
            for key in (
                "algorithm.action_noise",
                "algorithm.policy_kwargs.optimizer_kwargs.nested",
                ACTIVATION,
            )
        ),
        ("buffer.deep", [{"_target_": "hostile.make"}], "buffer.deep.0._target_"),
        (
            ACTIVATION,
            {"_target_": "torch.nn.Tanh", "nested": {"_target_": "hostile.make"}},
            f"{ACTIVATION}.nested._target_",
        ),
        (
            ACTIVATION,
            {"_target_": "hydra.utils.get_class", "path": "hostile.Made"},
            f"{ACTIVATION}._target_",
        ),
        (
            ACTIVATION,
            {"_target_": "hydra.utils.get_method", "_args_": ["hostile.make"]},
            f"{ACTIVATION}._target_",
        ),
    ],
)
def test_a_class_outside_the_allowlist_is_refused_without_importing_it(
    foreign_run, hostile, key, value, named
):
    path = foreign_run(key, value) / "config.yaml"
    config = read_config(path.parent, path.parent)
    with pytest.raises(UntrustedError) as refusal:
        check_trust(config, path)
    assert str(refusal.value).startswith(f"{named}=h")
    assert str(path) in str(refusal.value)
    assert not hostile.exists()
    assert "hostile" not in sys.modules


def test_every_class_on_the_list_exists_under_that_name():
    for target in ALLOWED:
        cls = import_object(target)
        assert isinstance(cls, type)
        assert cls.__name__ == target.rpartition(".")[2]
        assert cls.__module__.partition(".")[0] == target.partition(".")[0]


@pytest.mark.parametrize(
    "target",
    [
        "os.system",
        "builtins.eval",
        "eval",
        "",
        ".",
        "torch.nn.",
        "torch.nn..ReLU",
        "torch.nn./tmp/torch/nn/hostile.X",
        None,
        3,
        ["os.system"],
        # Functions of trusted packages, what they import from elsewhere, and methods.
        "stable_baselines3.common.save_util.load_from_pkl",
        "torch.load",
        "torch.nn.functional.relu",
        "torch.nn.Module.apply",
        "stable_baselines3.common.utils.deque",
        "stable_baselines3.common.noise.copy.deepcopy",
        # Classes whose construction does more than that.
        "stable_baselines3.common.logger.CSVOutputFormat",
        "parking_exp.runs.directory.RunDirectory",
        "subprocess.Popen",
    ],
)
def test_unlisted_targets_are_refused_in_nested_containers(tmp_path, target):
    config = compose()
    nested = [("a", {"_target_": target})]
    extra = {**config.algorithm.arguments, "policy_kwargs": {"optimizer_kwargs": {"betas": nested}}}
    foreign = config.model_copy(update={"algorithm": config.algorithm.model_copy(update=extra)})
    with pytest.raises(UntrustedError, match=r"betas\.0\.1\._target_="):
        check_trust(foreign, tmp_path)
