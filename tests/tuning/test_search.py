"""A search and the configs of its trials: as Hydra would compose them, and checked before anything starts."""

import json

import pytest
import yaml
from support.runs import make_config, options

from parking_exp.config.compose import compose
from parking_exp.config.credentials import with_password
from parking_exp.config.overrides import in_quotes, with_absolute_path
from parking_exp.errors import ConfigError, OutputDirectoryError
from parking_exp.tuning.search import Search, study_in

SMOKE = ("search=smoke",)


def refused(search):
    with pytest.raises(ConfigError) as error:
        search.check()
    return str(error.value)


def of_user(tmp_path, **changes):
    """A search in a directory of the user's own."""
    (tmp_path / "search").mkdir()
    defaults = ["shared/defaults@search", "_self_", {"override /experiment": "smoke"}]
    text = yaml.safe_dump({"defaults": defaults, "search": {"name": "mine", **changes}})
    (tmp_path / "search" / "mine.yaml").write_text(f"# @package _global_\n{text}")
    return Search(["search=mine"], str(tmp_path))


def test_a_trial_has_the_config_that_hydra_composes_from_the_same_keys(tmp_path):
    search = Search([*SMOKE, f"output_dir={tmp_path}"])
    changes = {"algorithm": "td3", "algorithm.learning_rate": 0.001, "algorithm.net_arch": [8, 8]}
    config = search.config(changes | {"algorithm.policy_delay": 3})
    words = ("algorithm=td3", "algorithm.learning_rate=0.001", "algorithm.net_arch=[8,8]", "algorithm.policy_delay=3")
    plain = make_config(
        "experiment=smoke", "total_timesteps=200", "evaluation.every_n_steps=50", "evaluation.video_episodes=0",
        f"output_dir={tmp_path}", *words,
    )  # fmt: skip
    assert config.run_key == plain.run_key
    assert config.algorithm.name == "td3"
    assert search.folder == tmp_path / "smoke"


def test_trial_0_is_the_config_with_what_is_typed():
    search = Search([*SMOKE, "updates_per_step=0.25"])
    assert search.base.updates_per_step == 0.25
    assert search.base.experiment_name == "smoke"
    assert search.values({}) == {
        "algorithm": "sac",
        "algorithm.learning_rate": 0.003,
        "algorithm.gamma": make_config("experiment=smoke").algorithm.arguments["gamma"],
        "algorithm.net_arch": [16, 16],
        "algorithm.policy_delay": None,
    }


def test_a_condition_on_a_condition_is_checked_with_both(tmp_path):
    space = {
        "algorithm": {"choices": ["sac", "td3"]},
        "algorithm.policy_delay": {"int": [1, 3], "when": {"algorithm": ["td3"]}},
        "algorithm.tau": {"uniform": [0.01, 0.1], "when": {"algorithm.policy_delay": [2]}},
    }
    search = of_user(tmp_path, space=space)
    search.check()
    changes = {"algorithm": "td3", "algorithm.policy_delay": 2, "algorithm.tau": 0.05}
    assert search.config(changes).algorithm.arguments["tau"] == 0.05


def test_a_worker_finds_the_search_from_another_directory(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    search = Search([*SMOKE, "output_dir=out", "storage=sqlite:///study.db", "n_trials=7"])
    search.open()
    search.save()
    monkeypatch.chdir(tmp_path)
    found = Search.load(tmp_path / "here" / "out" / "smoke", search.request.storage)
    assert found.folder == tmp_path / "here" / "out" / "smoke"
    assert found.request.storage == f"sqlite:///{tmp_path / 'here' / 'study.db'}"
    assert found.request.n_trials == 7


def test_passwords_are_not_stored_and_a_worker_takes_its_storage_from_its_caller_alone(tmp_path, monkeypatch):
    monkeypatch.delenv("PARKING_EXP_PASSWORDS", raising=False)
    uris = [f"{key}=postgresql://me:sec'ret@host/{key}?password=secret" for key in ("storage", "tracking.uri")]
    search = Search([*SMOKE, *(f'{key}="{uri}"' for key, _, uri in (uri.partition("=") for uri in uris)),
                     f"output_dir={tmp_path}"])  # fmt: skip
    search.folder.mkdir()
    search.save()
    text = (search.folder / "search.json").read_text()
    assert "secret" not in text
    assert "sec'ret" not in text
    assert json.loads(text)["storage"] == search.request.storage == "postgresql://me@host/storage"
    assert with_password(search.request.storage) == uris[0].removeprefix("storage=")
    assert Search.load(search.folder, "sqlite:////other.db").request.storage == "sqlite:////other.db"
    assert Search.load(search.folder, None).request.storage is None


def test_the_number_of_trials_is_the_last_that_was_typed(tmp_path):
    for n_trials in (7, 3):
        search = Search([*SMOKE, f"output_dir={tmp_path}", f"n_trials={n_trials}"])
        search.open()
        search.save()
    assert study_in(search.folder).n_trials == 3
    assert Search.load(search.folder, None).request.n_trials == 3


def test_a_folder_that_can_not_be_made_gets_a_sentence(tmp_path):
    (tmp_path / "smoke").write_text("a file")
    with pytest.raises(OutputDirectoryError) as error:
        Search([*SMOKE, f"output_dir={tmp_path}"]).open()
    assert str(error.value) == f"output_dir: {tmp_path / 'smoke'} cannot be made: File exists"


def test_an_experiment_file_may_have_quotes_in_its_path(tmp_path):
    path = tmp_path / 'it\'s "mine"' / "own.yaml"
    path.parent.mkdir()
    path.write_text("# @package _global_\ntotal_timesteps: 30000\n")
    line = f"experiment={in_quotes(str(path))}"
    assert with_absolute_path(line) == line
    assert make_config(line).total_timesteps == 30_000


def test_a_yaml_file_that_can_not_be_read_gets_a_sentence(tmp_path):
    (tmp_path / "broken.yaml").write_text("a: [1,")
    with pytest.raises(ConfigError, match="a YAML file can't be read"):
        compose(f"experiment={tmp_path / 'broken.yaml'}")


def test_every_search_that_comes_with_the_package_can_be():
    names = options("search")
    for name in names:
        search = Search([f"search={name}"])
        search.check()
        assert search.folder.name == name
    assert names == ["recipe", "smoke"]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([], "search is missing; write search=NAME"),
        (["search=smok"], "did you mean 'smoke'"),
        ([*SMOKE, "search.samplr=tpe"], "did you mean 'sampler'"),
        ([*SMOKE, "seeds=3"], "search.tuning_seeds are those of its trials"),
        ([*SMOKE, "buffer=her_future,her_final"], "a search takes one value for each key"),
        ([*SMOKE, "algorithm.gamma=0.9"], "algorithm.gamma is both"),
        ([*SMOKE, "n_trials=0"], "n_trials=0: "),
    ],
)
def test_what_is_typed_wrong_gets_a_sentence(overrides, words):
    assert words in refused(Search(overrides))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"space": {"algorithm.gama": {"uniform": [0.9, 0.99]}}}, "search.space.algorithm.gama: algorithm.gama: there is"),
        ({"space": {"search.sampler": {"choices": ["tpe"]}}}, "search.space.search.sampler: search.sampler: there is no"),
        ({"space": {"n_trials": {"int": [1, 5]}}}, "search.space.n_trials: n_trials: there is no such key"),
        ({"space": {"algorithm.gamma": {"uniform": [0.9, 1.5]}}}, "search.space.algorithm.gamma: algorithm.gamma=1.5"),
        ({"space": {"algorithm.batch_size": {"int": [0, 64]}}}, "search.space.algorithm.batch_size: algorithm.batch_size=0"),
        ({"space": {"algorithm": {"choices": ["sac", "ppo"]}}}, "search.space.algorithm: algorithm=ppo"),
        ({"space": {"algorithm.gamma": {"uniform": [0.9, 0.99]}}, "enqueue": [{"algorithm.gamma": 2.0}]},
         "search.enqueue.0: algorithm.gamma=2.0"),
        ({"space": {"algorithm": {"choices": ["sac", "td3"]}, "algorithm.ent_coef": {"uniform": [0.1, 0.2]}}},
         "search.space.algorithm.ent_coef: algorithm.ent_coef: there is no such key"),
    ],
)  # fmt: skip
def test_a_space_that_can_not_be_is_refused_before_anything_starts(tmp_path, changes, words):
    assert words in refused(of_user(tmp_path, **changes))
