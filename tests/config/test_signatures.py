"""Signatures read from source are those that Python sees."""

import inspect
import re
import subprocess
import sys

import pytest
from hydra.utils import get_class
from support.runs import make_config, options

from parking_exp.config.signatures import Parameter, may_derive_from, policy_signature, signature
from parking_exp.config.source_lookup import UnknownTarget

TARGETS = [
    "stable_baselines3.SAC",
    "stable_baselines3.TD3",
    "stable_baselines3.DDPG",
    "sb3_contrib.TQC",
    "sb3_contrib.CrossQ",
    "parking_exp.algorithms.crossq.CrossQ",
    "parking_exp.buffers.HerBuffer",
    "stable_baselines3.HerReplayBuffer",
    "stable_baselines3.common.buffers.DictReplayBuffer",
    "stable_baselines3.common.noise.NormalActionNoise",
    "stable_baselines3.common.noise.OrnsteinUhlenbeckActionNoise",
    "stable_baselines3.common.utils.LinearSchedule",
]


@pytest.mark.parametrize("target", TARGETS)
def test_static_signature_equals_the_imported_one(target):
    parameters = list(inspect.signature(get_class(target).__init__).parameters.values())[1:]
    found = signature(target)
    assert list(found.parameters) == [parameter.name for parameter in parameters]
    required = [parameter.name for parameter in parameters if parameter.default is parameter.empty]
    assert [name for name, parameter in found.parameters.items() if parameter.required] == required
    assert not found.open


def test_reading_a_signature_imports_nothing():
    code = (
        "import sys; from parking_exp.config.signatures import signature; "
        "signature('stable_baselines3.SAC'); print(sorted({'torch', 'stable_baselines3'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


ODD = {
    "__main__.X": "__main__ is a script",
    "builtins.dict": "builtins has no Python source",
    "zipimport.zipimporter": "zipimport has no Python source",
    "math.floor": "math has no Python source",
    "os.path.join": "there is no module 'path' in os",
    "namespace.X": "namespace has no Python source",
    "namespace.nowhere.X": "there is no module 'nowhere' in namespace",
    "broken.X": "is not valid Python",
    "binary.X": "is not valid Python",
    "..SAC": "is not a dotted path",
    "a/b.SAC": "is not a dotted path",
    "stable_baselines3.": "is not a dotted path",
    3: "is not a dotted path",
    None: "is not a dotted path",
}


@pytest.mark.parametrize("target", ODD)
def test_whatever_a_target_is_the_reason_is_a_phrase(target, tmp_path, monkeypatch):
    (tmp_path / "namespace").mkdir()
    (tmp_path / "broken.py").write_text("class X(:\n")
    (tmp_path / "binary.py").write_bytes(b"\0\xff")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UnknownTarget, match=re.escape(ODD[target])):
        signature(target)


def test_classes_in_namespace_packages_and_of_bases_of_their_own_name_are_found(tmp_path, monkeypatch):
    (tmp_path / "spread" / "out").mkdir(parents=True)
    source = "class Warning(Warning):\n    pass\nclass Mine:\n    def __init__(self, a, b=1): pass\n"
    (tmp_path / "spread" / "out" / "mine.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    assert list(signature("spread.out.mine.Mine").parameters) == ["a", "b"]
    assert signature("spread.out.mine.Warning").open


MADE = {
    "Plain": ("class Plain: pass", False),
    "OfABuiltin": ("class OfABuiltin(dict): pass", False),
    "OfAnotherLibrary": ("from json import JSONEncoder\nclass OfAnotherLibrary(JSONEncoder): pass", False),
    "Abstract": ("import abc\nfrom typing import Generic, TypeVar\nT = TypeVar('T')\nclass Abstract(abc.ABC, Generic[T]): pass", False),
    "Derived": ("from stable_baselines3 import SAC\nclass Own(SAC): pass\nclass Derived(Own): pass", True),
    "OfAMadeClass": ("def make(): ...\nclass OfAMadeClass(make()): pass", True),
    "OfAnUnknownClass": ("Base = type('Base', (), {})\nclass OfAnUnknownClass(Base): pass", True),
    "OfANativeClass": ("from zipimport import zipimporter\nclass OfANativeClass(zipimporter): pass", True),
}  # fmt: skip


@pytest.mark.parametrize("name", MADE)
def test_only_a_class_whose_bases_can_all_be_read_is_known_to_lack_one(name, tmp_path, monkeypatch):
    source, may = MADE[name]
    (tmp_path / f"made_{name}.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    assert may_derive_from(f"made_{name}.{name}", "OffPolicyAlgorithm") is may


@pytest.mark.parametrize("option", options("algorithm"))
def test_a_policys_signature_is_the_imported_ones(option):
    target = make_config(f"algorithm={option}").algorithm.target
    policy = get_class(target).policy_aliases["MultiInputPolicy"]
    expected = list(inspect.signature(policy.__init__).parameters)[1:]
    assert list(policy_signature(target, "MultiInputPolicy").parameters) == expected


def test_only_modules_are_suggested_as_modules():
    with pytest.raises(UnknownTarget) as refusal:
        signature("stable_baselines3.sacc.SAC")
    assert refusal.value.known == ["a2c", "common", "ddpg", "dqn", "her", "ppo", "sac", "td3"]
    with pytest.raises(UnknownTarget) as refusal:
        signature("torch.nn.Tan")
    assert "Tanh" in refusal.value.known
    assert not [name for name in refusal.value.known if name[0] in "_*"]


@pytest.mark.parametrize("target", ["SAC", "stable_baselines3.SACC", "stable_baselines3.nowhere.SAC", "nowhere.SAC"])
def test_an_unknown_target_raises(target):
    with pytest.raises(UnknownTarget):
        signature(target)


@pytest.mark.parametrize(
    ("annotation", "value", "fits"),
    [
        ("int", 1, True),
        ("int", 1.5, False),
        ("int", True, False),
        ("float", 1, True),
        ("float | Schedule", "fast", False),
        ("str | float", "auto", True),
        ("bool", 1, False),
        ("bool", False, True),
        ("int | tuple[int, str]", [1, "episode"], True),
        (None, "anything", True),
        ("int", None, False),
        ("int | None", None, True),
        ("int", [256], False),
        ("float | Schedule", {"start": 1}, False),
        ("float | Schedule", [], False),
        ("ActionNoise | None", {}, False),
        ("dict[str, Any] | None", {}, True),
        ("Optional[float]", 0.5, True),
        ("Union[int, str]", 3, True),
        ("Literal['a']", "a", True),
    ],
)
def test_scalars_are_held_against_annotations(annotation, value, fits):
    assert Parameter("x", annotation, required=False).accepts(value) is fits
