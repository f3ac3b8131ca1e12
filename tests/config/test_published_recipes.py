"""The recipes of experiment=published are those of their sources, and the same on our simulator."""

import pytest

from parking_exp.config.compose import compose_configs

EXAMPLE = "Stable-Baselines3 example"
NOTEBOOK = "highway-env notebook"
ZOO = "rl-baselines3-zoo"


def hyperparameters(experiment, label):
    """Return what a source can set: the env's options, and arguments of model and buffer."""
    (config,) = compose_configs(
        "config", [f"experiment={experiment}", f"label='{label}'", "seeds=1"]
    )
    names = ("learning_rate", "learning_starts", "batch_size", "tau", "gamma", "net_arch")
    values = {name: config["algorithm"][name] for name in names}
    for name in ("n_sampled_goal", "goal_selection_strategy", "buffer_size"):
        values[name] = config["buffer"][name]
    values["updates_per_step"] = config["updates_per_step"]
    values["env_steps"] = config["total_timesteps"]
    for name in ("add_walls", "duration", "training_duration"):
        values[name] = config["env"][name]
    return values


COMMON = {
    "learning_starts": 500,
    "n_sampled_goal": 4,
    "buffer_size": 1_000_000,
    "updates_per_step": 1,
    "add_walls": True,
    "duration": 100,
    "training_duration": None,
}
PUBLISHED = {
    EXAMPLE: {
        "env_steps": 200_000,
        "learning_rate": 1e-3,
        "batch_size": 256,
        "tau": 0.005,
        "gamma": 0.95,
        "net_arch": [256, 256, 256],
        "goal_selection_strategy": "future",
    },
    NOTEBOOK: {
        "env_steps": 50_000,
        "learning_rate": 1e-3,
        "batch_size": 1024,
        "tau": 0.05,
        "gamma": 0.95,
        "net_arch": [512, 512, 512],
        "goal_selection_strategy": "future",
    },
    ZOO: {
        "env_steps": 100_000,
        "learning_rate": 1.5e-3,
        "batch_size": 512,
        "tau": 0.005,
        "gamma": 0.98,
        "net_arch": [512, 512, 512],
        "goal_selection_strategy": "episode",
    },
}


@pytest.mark.parametrize("label", PUBLISHED)
def test_published_recipes_have_the_values_of_their_sources(label):
    assert hyperparameters("published", label) == {**COMMON, **PUBLISHED[label]}


@pytest.mark.parametrize(
    ("experiment", "label", "published", "env_steps"),
    [
        ("time_to_95", "example, our simulator", EXAMPLE, 100_000),
        ("time_to_95", "example as published", EXAMPLE, 100_000),
        ("published_vectorized", "Stable-Baselines3 example, our simulator", EXAMPLE, 200_000),
        ("published_vectorized", "highway-env notebook, our simulator", NOTEBOOK, 50_000),
    ],
)
def test_repetitions_of_a_published_recipe_differ_in_their_env_steps_at_most(
    experiment, label, published, env_steps
):
    expected = {**hyperparameters("published", published), "env_steps": env_steps}
    assert hyperparameters(experiment, label) == expected
