"""A search and the configs of its trials, validated before anything starts."""

import json

import pytest
from optuna.distributions import CategoricalDistribution
from optuna.trial import create_trial
from support.marks import slow_but
from support.runs import options
from support.searches import user_search

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError, StoreError
from parking_exp.tuning.search import Search, _compose_groups, read_search

SMOKE = ("search=smoke",)


def refused(search):
    with pytest.raises(ConfigError) as error:
        search.check()
    return str(error.value)


def test_a_trial_has_the_config_that_train_composes_from_the_same_keys(tmp_path):
    schedule = {
        "_target_": "stable_baselines3.common.utils.LinearSchedule",
        "start": 0.002,
        "end": 1e-5,
    }
    changes = {
        "algorithm": "td3",
        "algorithm.learning_rate": schedule | {"end_fraction": 1.0},
        "algorithm.net_arch": [8, 8],
        "algorithm.policy_ema_half_life": None,
        "buffer.goal_selection_strategy": "final",
    }
    space = {key: {"choices": [value]} for key, value in changes.items()}
    search = user_search(tmp_path, [f"output_dir={tmp_path}"], space=space)
    lines = ["end_fraction:1.0", *(f"{key}:{value}" for key, value in schedule.items())]
    keys = (
        "algorithm=td3", "algorithm.net_arch=[8,8]", "algorithm.policy_ema_half_life=null",
        "buffer.goal_selection_strategy=final", f"algorithm.learning_rate={{{','.join(lines)}}}",
    )  # fmt: skip
    assert search.config(changes).run_key == compose("experiment=smoke", *keys).run_key
    assert search.config(changes).algorithm.name == "td3"
    assert search.folder == tmp_path / "mine"


def test_trial_0_has_the_values_of_the_unchanged_config(tmp_path):
    search = Search([*SMOKE, f"output_dir={tmp_path}", "n_trials=3"])
    search.open()
    search.save()
    stored = read_search(search.folder)
    assert stored.n_trials == 3
    (trial,) = stored.trials
    assert (trial.state, trial.changes) == ("pending", {})
    assert trial.parameters == {
        "algorithm": "sac",
        "algorithm.learning_rate": 0.003,
        "algorithm.gamma": search.base.algorithm.arguments["gamma"],
        "algorithm.net_arch": "[16, 16]",
        "buffer.n_sampled_goal": 2,
    }


@pytest.mark.parametrize("name", slow_but(["smoke"], options("search")))
def test_every_search_of_the_package_is_valid(name):
    search = Search([f"search={name}"])
    search.check()
    assert search.folder.name == name


def test_a_stored_trial_with_a_choice_that_its_search_lacks_is_refused(tmp_path):
    """A foreign study can't name a class."""
    space = {"algorithm.action_noise": {"choices": ["mine"]}}
    search = user_search(tmp_path / "options", [f"output_dir={tmp_path}"], space=space)
    study = search.open().study
    search.save()
    key = "algorithm.action_noise"
    foreign = CategoricalDistribution([json.dumps({"_target_": "subprocess.Popen"})])
    study.add_trial(
        create_trial(value=0.5, params={key: foreign.choices[0]}, distributions={key: foreign})
    )
    with pytest.raises(StoreError, match=r"^the study mine can't be used: "):
        read_search(search.folder)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([*SMOKE, "search.samplr=tpe"], "did you mean 'sampler'"),
        ([*SMOKE, "seeds=3"], "search.tuning_seeds"),
        ([*SMOKE, "buffer=her_future,her_final"], "one value for each key"),
        (
            [*SMOKE, "+search.space.output_dir={choices: [a]}"],
            "space has output_dir, which is not a hyperparameter",
        ),
        ([*SMOKE, "n_trials=1000000000"], "n_trials=1000000000: "),
    ],
)
def test_a_wrong_override_is_named(overrides, words):
    assert words in refused(Search(overrides))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"space": {"algorithm.gama": {"uniform": [0.9, 0.99]}}}, "search.space.algorithm.gama: "),
        (
            {"space": {"algorithm.gamma": {"uniform": [0.9, 1.5]}}},
            "search.space.algorithm.gamma: algorithm.gamma=1.5",
        ),
        (
            {
                "space": {
                    "algorithm": {"choices": ["sac", "td3"]},
                    "algorithm.ent_coef": {"uniform": [0.1, 0.2]},
                }
            },
            "search.space.algorithm.ent_coef: ",
        ),
    ],
)
def test_a_space_that_cannot_run_is_refused_before_anything_starts(tmp_path, changes, words):
    assert words in refused(user_search(tmp_path, **changes))


def test_a_search_is_refused_once_an_option_that_it_chooses_from_has_other_contents(tmp_path):
    option = tmp_path / "algorithm" / "mine.yaml"
    option.parent.mkdir()
    option.write_text("defaults: [sac, _self_]\nname: mine\n")
    space = {"algorithm": {"choices": ["sac", "mine"]}}
    search = user_search(tmp_path, [f"output_dir={tmp_path / 'outputs'}"], space=space)
    search.open()
    Search(search.overrides, search.extra_config_dir).open()
    _compose_groups.cache_clear()  # as in another process
    option.write_text("defaults: [sac, _self_]\nname: mine\ntau: 0.01\n")
    with pytest.raises(
        ConfigError, match=r"^the study mine was made with another algorithm=mine; restore that"
    ):
        Search(search.overrides, search.extra_config_dir).open()
