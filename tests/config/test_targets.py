"""Classes are found by their dotted paths, and their arguments are checked against their signatures."""

import re
import sys

import pytest
from support.runs import make_config

from parking_exp.config.targets import UnknownTarget, find
from parking_exp.errors import ConfigError

NOT_FOUND = {
    "__main__.X": "__main__ is a script",
    "math.no": "there is no 'no' in math",
    "math.floor.x": "there is no module 'floor' in math",
    "nowhere.X": "the package 'nowhere' is not installed",
    "stable_baselines3.SACC": "did you mean 'SAC'?",
    "stable_baselines3.sacc.SAC": "did you mean 'sac'?",
    "torch.nn.Tan": "did you mean 'Tanh'?",
    "broken.X": "broken cannot be imported: SyntaxError: ",
    "raises.X": "raises cannot be imported: RuntimeError: on import",
    "needs_more.X": "needs_more cannot be imported: ModuleNotFoundError: No module named 'nowhere'",
    "..SAC": "is not a dotted path",
    "a/b.SAC": "is not a dotted path",
    "stable_baselines3.": "is not a dotted path",
    "SAC": "is not a dotted path",
    3: "is not a dotted path",
    None: "is not a dotted path",
}


@pytest.mark.parametrize("target", NOT_FOUND)
def test_why_a_class_is_not_found_is_a_phrase(target, tmp_path, monkeypatch):
    (tmp_path / "broken.py").write_text("class X(:\n")
    (tmp_path / "raises.py").write_text("raise RuntimeError('on import')\n")
    (tmp_path / "needs_more.py").write_text("import nowhere\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UnknownTarget, match=re.escape(NOT_FOUND[target])):
        find(target)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A module with an algorithm of the user's own."""
    (tmp_path / "own_algorithm.py").write_text(
        "from stable_baselines3 import SAC\n"
        "class Mine(SAC):\n"
        "    def __init__(self, policy, env, beta: float, layers: int = 1, tag: str | None = None, **rest):\n"
        "        super().__init__(policy, env, **rest)\n"
        "class Closed(SAC):\n"
        "    def __init__(self, env, beta: float):\n"
        "        super().__init__('MultiInputPolicy', env)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield "algorithm=sac algorithm.features=raw algorithm._target_=own_algorithm.Mine"
    sys.modules.pop("own_algorithm", None)


@pytest.mark.parametrize("more", ["+algorithm.beta=1", "+algorithm.beta=0.5 +algorithm.tag=null +algorithm.layers=2"])
def test_a_class_of_ones_own_takes_what_its_signature_says(mine, more):
    make_config(*mine.split(), *more.split())


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("", "algorithm.beta is missing; own_algorithm.Mine needs it"),
        ("+algorithm.beta=fast", "algorithm.beta='fast' has the wrong type; own_algorithm.Mine takes float"),
        ("+algorithm.beta=true", "algorithm.beta=True has the wrong type; own_algorithm.Mine takes float"),
        ("+algorithm.beta=1 +algorithm.layers=null", "algorithm.layers=null: own_algorithm.Mine needs a value"),
        ("+algorithm.beta=1 +algorithm.layers=1.5", "algorithm.layers=1.5 has the wrong type"),
        ("+algorithm.beta=1 algorithm._target_=own_algorithm.Closed", "own_algorithm.Closed has no such argument"),
    ],
)
def test_what_a_class_of_ones_own_does_not_take_is_refused(mine, more, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        make_config(*mine.split(), *more.split())


def test_our_own_keys_of_all_cells_are_checked_before_any_class_is_imported(tmp_path, monkeypatch):
    from parking_exp.config.compose import composed
    from parking_exp.config.validate import validate_all

    (tmp_path / "never_imported.py").write_text("raise SystemExit\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"^n_envs=0 "):
        validate_all(composed("config", ["algorithm._target_=never_imported.X", "n_envs=256,0"]))
