"""Signatures read from source are those that Python sees."""

import inspect
import subprocess
import sys

import pytest
from hydra.utils import get_class

from parking_exp.signatures import Parameter, UnknownTarget, signature

TARGETS = [
    "stable_baselines3.SAC",
    "stable_baselines3.TD3",
    "stable_baselines3.DDPG",
    "sb3_contrib.TQC",
    "sb3_contrib.CrossQ",
    "parking_exp.crossq.CrossQ",
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
        "import sys; from parking_exp.signatures import signature; "
        "signature('stable_baselines3.SAC'); print(sorted({'torch', 'stable_baselines3'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


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
        ("float | Schedule", {"_target_": "x"}, True),
        ("Optional[float]", 0.5, True),
        ("Union[int, str]", 3, True),
        ("Literal['a']", "a", True),
    ],
)
def test_scalars_are_held_against_annotations(annotation, value, fits):
    assert Parameter("x", annotation, required=False).accepts(value) is fits
