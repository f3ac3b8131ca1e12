"""The space of a search: its dimensions, what Optuna is given, and what comes back."""

import optuna
import pytest
from support.searches import SETTINGS

from parking_exp.config.validate import parse_plain
from parking_exp.errors import ConfigError
from parking_exp.tuning.search_config import Dimension, SearchConfig


@pytest.mark.parametrize(
    ("form", "value", "stored"),
    [
        ({"uniform": [0.0, 1.0]}, 0.25, 0.25),
        ({"int": [1, 8]}, 4, 4),
        ({"choices": [[8, 8], [16, 16]]}, [16, 16], "[16, 16]"),
        ({"choices": ["sac", None]}, None, "null"),
        ({"choices": [0.5, 1, 2]}, 1, 1),
        ({"choices": ["sac", True]}, "sac", "sac"),
    ],
)
def test_a_value_of_the_config_has_a_parameter_and_comes_back(form, value, stored):
    dimension = Dimension.model_validate(form)
    assert dimension.to_parameter(value) == stored
    assert dimension.to_value(stored) == value


@pytest.mark.parametrize(
    ("form", "value"),
    [
        ({"log": [1e-4, 1e-2]}, {"_target_": "a.Schedule"}),
        ({"uniform": [0.9, 0.99]}, 5.0),
        ({"choices": [0, 1]}, 2),
    ],
)
def test_a_value_outside_of_a_dimension_has_no_parameter(form, value):
    assert Dimension.model_validate(form).to_parameter(value) is None


def test_sampled_values_lie_within_both_ends_and_have_six_digits():
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))

    def sample(**form):
        dimension = Dimension.model_validate(form)
        trials = [study.ask({str(form): dimension.distribution()}) for _ in range(200)]
        return [dimension.to_value(trial.params[str(form)]) for trial in trials]

    values = sample(log=[1e-4, 1e-2])
    assert all(1e-4 <= value <= 1e-2 and value == float(f"{value:.6g}") for value in values)
    assert 60 < sum(value < 1e-3 for value in values) < 140  # half of the log scale
    assert all(0.9 <= value <= 1 for value in sample(uniform=[0.9, 1]))
    assert set(sample(int=[1, 3])) == {1, 2, 3}
    assert {tuple(value) for value in sample(choices=[[1], [2]])} == {(1,), (2,)}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"space": {}}, "space"),
        ({"space": {"algorithm.gamma": {"log": [0.99, 0.9]}}}, "space.algorithm.gamma"),
        ({"space": {"seed": {"int": [0, 5]}}}, "tuning_seeds"),
        (
            {"space": {"+label": {"choices": [1]}}},
            "space has +label, which is not a hyperparameter",
        ),
        ({"tuning_seeds": [1, 2], "test_seeds": [2, 3]}, "seed 2"),
    ],
)
def test_a_wrong_search_is_refused_in_one_sentence_that_names_the_key(changes, words):
    with pytest.raises(ConfigError) as error:
        parse_plain(SearchConfig, SETTINGS | changes)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
