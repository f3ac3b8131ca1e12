"""The space of a search: its dimensions, what Optuna is given, and what comes back."""

import json

import optuna
import pytest
from support.searches import settings

from parking_exp.config.validate import check
from parking_exp.errors import ConfigError
from parking_exp.tuning.search_config import Dimension, SearchConfig
from parking_exp.tuning.space import applies, in_order, parameter, suggest, to_parameter, to_value


def dimension(**form):
    return Dimension.model_validate(form)


@pytest.mark.parametrize(
    ("form", "value", "stored"),
    [
        ({"log": [1e-4, 1e-2]}, 2e-3, 2e-3),
        ({"uniform": [0.0, 1.0]}, 0.25, 0.25),
        ({"one_minus_log": [0.9, 0.99]}, 0.98, 0.02),
        ({"int": [1, 8]}, 4, 4),
        ({"choices": [256, 512]}, 512, "512"),
        ({"choices": [[8, 8], [16, 16]]}, [16, 16], "[16, 16]"),
        ({"choices": ["sac", None]}, None, "null"),
        ({"choices": [0.5, 1, 2]}, 1.0, "1"),
    ],
)
def test_a_config_s_value_and_optuna_s_parameter_are_the_same_thing(form, value, stored):
    one = dimension(**form)
    assert to_parameter(one, value) == stored
    assert to_value(one, stored) == value


@pytest.mark.parametrize(
    ("form", "value"),
    [
        ({"log": [1e-4, 1e-2]}, 0.1),
        ({"log": [1e-4, 1e-2]}, {"_target_": "a.Schedule"}),
        ({"int": [1, 8]}, 2.5),
        ({"int": [0, 1]}, True),
        ({"choices": [256, 512]}, 300),
        ({"choices": [0, 1]}, True),
    ],
)
def test_what_a_dimension_does_not_have_is_no_parameter(form, value):
    assert to_parameter(dimension(**form), value) is None


def test_sampled_values_lie_within_both_ends_and_have_six_digits():
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    forms = {
        "a": dimension(log=[1e-4, 1e-2]),
        "b": dimension(one_minus_log=[0.9, 0.999]),
        "c": dimension(**{"int": [1, 3]}),
        "d": dimension(choices=[[1], [2]]),
    }
    found = {name: [] for name in forms}
    for _ in range(200):
        trial = study.ask()
        for name, one in forms.items():
            found[name].append(to_value(one, suggest(trial, parameter(name, one), one)))
    assert all(1e-4 <= value <= 1e-2 and value == float(f"{value:.6g}") for value in found["a"])
    assert all(0.9 <= value <= 0.999 for value in found["b"])
    assert 60 < sum(value > 0.99 for value in found["b"]) < 140  # half of the log scale of 1 - x
    assert set(found["c"]) == {1, 2, 3}
    assert {json.dumps(value) for value in found["d"]} == {"[1]", "[2]"}
    assert set(study.trials[0].params) == {"a", "1 - b", "c", "d"}


def test_a_key_comes_after_its_conditions_and_groups_come_first():
    search = settings(
        space={
            "algorithm.policy_delay": {"int": [1, 3], "when": {"algorithm": ["td3"]}},
            "algorithm.gamma": {"uniform": [0.9, 0.99]},
            "algorithm": {"choices": ["sac", "td3"]},
        }
    )
    assert [key for key, _ in in_order(search)] == ["algorithm", "algorithm.gamma", "algorithm.policy_delay"]
    delay = search.space["algorithm.policy_delay"]
    assert applies(delay, {"algorithm": "td3"})
    assert not applies(delay, {"algorithm": "sac"})
    assert not applies(delay, {})


def test_conditions_in_a_circle_are_refused():
    search = settings(
        space={
            "algorithm.tau": {"uniform": [0.1, 0.2], "when": {"algorithm.gamma": [0.9]}},
            "algorithm.gamma": {"choices": [0.9, 0.95], "when": {"algorithm.tau": [0.1]}},
        }
    )
    with pytest.raises(ValueError, match="depends on itself"):
        in_order(search)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"space": {}}, "space is empty"),
        ({"space": {"algorithm.gamma": {"log": [0.9, 0.99], "choices": [1]}}}, "takes one of log, uniform"),
        ({"space": {"algorithm.gamma": {}}}, "takes one of log, uniform"),
        ({"space": {"algorithm.gamma": {"log": [0.99, 0.9]}}}, "no room between 0.99 and 0.9"),
        ({"space": {"algorithm.gamma": {"log": [0.0, 0.9]}}}, "0.0 is not above 0"),
        ({"space": {"algorithm.gamma": {"one_minus_log": [0.9, 1.0]}}}, "1.0 is not below 1"),
        ({"space": {"algorithm.gamma": {"logg": [0.9, 1.0]}}}, "did you mean 'log'"),
        ({"space": {"algorithm.tau": {"uniform": [0.1, 0.2], "when": {"algorithm": ["sac"]}}}}, "names algorithm, which"),
        ({"space": {"algorithm.tau": {"uniform": [0.1, 0.2], "when": {"algorithm": ["ppo"]}},
                    "algorithm": {"choices": ["sac", "td3"]}}}, "algorithm is never ppo"),
        ({"space": {"seed": {"int": [0, 5]}}}, "space has seeds"),
        ({"tuning_seeds": [1, 2], "test_seeds": [2, 3]}, "seed 2 is among tuning_seeds and test_seeds"),
        ({"tuning_seeds": [1, 1]}, "tuning_seeds has a seed twice"),
        ({"objective": ["final_success", "final_parked"], "pruner": "median"}, "takes one objective, and there are 2"),
        ({"objective": "final_succes"}, "final_success"),
        ({"sampler": "tbe"}, "did you mean 'tpe'"),
        ({"pruner": "wilcoxon"}, "wilcoxon"),
    ],
)  # fmt: skip
def test_a_search_that_can_not_be_gets_a_sentence(changes, words):
    plain = settings().model_dump(by_alias=True) | changes
    with pytest.raises(ConfigError) as error:
        check(SearchConfig, plain)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
