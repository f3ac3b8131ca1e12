"""Names, keys and derived values of a run's config."""

import inspect
import re
from typing import get_args

import pytest
from highway_env.envs.parking_env import ParkingEnv
from support.runs import options

from parking_exp.buffers import HerBuffer
from parking_exp.config.argument_limits import HER_OPTIONS
from parking_exp.config.compose import compose
from parking_exp.config.rules import update_ratio_warning
from parking_exp.config.run_key import changes_results
from parking_exp.config_model import GoalStrategy
from parking_exp.errors import ConfigError


def test_parking_has_highway_envs_own_options_and_values():
    ours = compose("env=parking").env.highway_options()
    theirs = ParkingEnv.default_config()
    extra = {"longitudinal": True, "lateral": True, "dynamical": False, "clip": True}
    assert (theirs.pop("controlled_vehicles"), theirs.pop("manual_control")) == (
        1,
        False,
    )  # no choice here
    assert ours.pop("action") == {**theirs.pop("action"), **extra}
    assert ours == theirs


def test_training_keys_change_training_envs_only():
    env = compose("env.training_duration=2", "env.training_success_goal_reward=0.05").env
    own = env.highway_options()
    assert (own["duration"], own["success_goal_reward"]) == (100, 0.12)
    assert env.for_training().highway_options() == own | {
        "duration": 2,
        "success_goal_reward": 0.05,
    }
    same = ("env.training_duration=null", "env.training_success_goal_reward=null", "n_envs=8")
    assert compose(*same).env.for_training().highway_options() == own


@pytest.mark.parametrize(
    ("option", "steps"),
    [
        ("parking", 500),
        ("parking_sparse", 500),
        ("parking_action_repeat", 20),
        ("parking_2021", 100),
    ],
)
def test_longest_episode_counts_time_as_highway_env_does(option, steps):
    assert compose(f"env={option}").env.episode_steps == steps


@pytest.mark.parametrize(
    ("updates_per_step", "n_envs", "expected"),
    [(1.0, 8, (1, 8)), (0.125, 8, (1, 1)), (0.125, 1, (8, 1)), (0.3, 1, (10, 3))],
)
def test_update_round_keeps_updates_per_step_for_any_n_envs(updates_per_step, n_envs, expected):
    config = compose().model_copy(update={"updates_per_step": updates_per_step, "n_envs": n_envs})
    assert config.update_round() == expected


@pytest.mark.parametrize(
    ("overrides", "rounds"),
    [
        (("updates_per_step=0.0015",), (125, 48)),
        (("updates_per_step=0.3333333333333333", "n_envs=1"), (3, 1)),
        (("experiment=tutorial", "seeds=null"), (1, 1)),  # its file says so, too
        (("algorithm.train_freq=1", "algorithm.gradient_steps=8"), (1, 8)),
        (("algorithm.gradient_steps=1", "updates_per_step=0.125", "n_envs=4"), (2, 1)),
    ],
)
def test_train_freq_and_gradient_steps_follow_from_updates_per_step(overrides, rounds):
    assert compose(*overrides).update_round() == rounds


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (
            ("algorithm.train_freq=4",),
            "algorithm.train_freq=4: it follows from updates_per_step=0.03125 and n_envs=256, "
            "which make it 1; leave it null",
        ),
        (("algorithm.train_freq=1", "n_envs=8"), "updates_per_step=0.03125 and n_envs=8, "),
        (("algorithm.train_freq=1", "n_envs=1"), "which make it 32;"),
        (("algorithm.train_freq=[1,step]",), "updates_per_step=0.03125"),
        (("algorithm.train_freq=often",), "updates_per_step=0.03125"),
        (("algorithm.gradient_steps=2",), "which make it 8;"),
        (("algorithm.gradient_steps=-1",), "which make it 8;"),
        (("algorithm.train_freq=[1,episode]", "n_envs=1", "updates_per_step=1"), "make it 1;"),
        (
            ("experiment=tutorial", "seeds=null", "n_envs=8", "algorithm.learning_starts=5000"),
            "which make it 8;",
        ),
        (("updates_per_step=0.123456", "n_envs=8"), "try updates_per_step=0.1234567"),
        (("updates_per_step=0.0015", "n_envs=1"), "try updates_per_step=0.00149925"),
    ],
)
def test_rounds_of_another_ratio_than_the_one_asked_for_are_refused(overrides, sentence):
    with pytest.raises(ConfigError, match=rf"^[^\n]*{re.escape(sentence)}[^\n]*$"):
        compose(*overrides)


@pytest.mark.parametrize(
    ("overrides", "warning"),
    [
        ((), None),
        (("envs=few",), None),
        (("n_envs=8",), "0.03125 is far from 1, which n_envs=8 suggests; envs=few sets 8 envs"),
        (("n_envs=64",), None),
        (("updates_per_step=0.5",), "0.5 is far from 0.03125, which n_envs=256 suggests$"),
        (("experiment=smoke",), None),
        (("env=fetch_push",), None),
    ],
)
def test_a_ratio_far_from_what_the_number_of_envs_suggests_is_warned_of(overrides, warning):
    text = update_ratio_warning(compose(*overrides))
    assert text is None if warning is None else re.search(warning, text)


def test_envs_few_has_the_values_of_the_measured_cell_and_composes_with_other_options():
    for other in (
        (),
        ("algorithm=td3",),
        ("budget=small",),
        ("experiment=features", "seeds=null", "algorithm.features=ego"),
    ):
        config = compose("envs=few", *other)
        values = (config.n_envs, config.updates_per_step, config.total_timesteps)
        assert values == (8, 1, 9200)
        assert config.algorithm.arguments["learning_starts"] == 1000


@pytest.mark.parametrize("algorithm", ["sac", "td3", "ddpg"])
def test_the_tiny_budget_has_a_recipe_for_parking_that_the_command_line_overrides(algorithm):
    config = compose("budget=tiny", f"algorithm={algorithm}")
    assert (config.total_timesteps, config.n_envs, config.algorithm.arguments["tau"]) == (
        43_000,
        128,
        0.14,
    )
    assert update_ratio_warning(config) is None
    changed = compose(
        "budget=tiny", f"algorithm={algorithm}", "algorithm.tau=0.01", "total_timesteps=50000"
    )
    assert (changed.total_timesteps, changed.n_envs, changed.algorithm.arguments["tau"]) == (
        50_000,
        128,
        0.01,
    )


@pytest.mark.parametrize(
    "other",
    [
        ["algorithm=tqc"],
        ["algorithm=crossq"],
        ["env=parking_stop"],
        ["env=point_maze"],
        ["env=point_maze", "algorithm=sac"],
        ["env=gymnasium", "env.id=FetchReach-v4"],
    ],
)
def test_the_tiny_budget_keeps_the_hyperparameters_of_other_tasks_and_algorithms(other):
    plain, tiny = compose(*other), compose("budget=tiny", *other)
    assert tiny.total_timesteps == 64_000
    assert (tiny.algorithm, tiny.n_envs) == (plain.algorithm, plain.n_envs)


@pytest.mark.parametrize("n_envs", [1, 2, 8, 256])
def test_the_rounds_of_every_ratio_that_is_accepted_are_exact(n_envs):
    default = compose()
    for ratio in (0.001, 0.0015, 0.03125, 0.1, 0.3, 1 / 3, 0.7, 1, 2.5, 20):
        config = default.model_copy(update={"updates_per_step": ratio, "n_envs": n_envs})
        train_freq, gradient_steps = config.update_round()
        assert gradient_steps / (train_freq * n_envs) == ratio


def test_the_cell_is_the_config_without_its_seed():
    first, second = (compose(f"seed={seed}", "env=parking_stop_crowded") for seed in (1, 2))
    assert (
        first.cell_name
        == second.cell_name
        == f"parking_stop_crowded-sac-her_future-{first.cell_key}"
    )
    assert first.run_key != second.run_key
    assert first.run_dir.parent == second.run_dir.parent
    assert (first.run_dir.name, first.run_dir.is_absolute()) == ("seed=1", True)


@pytest.mark.parametrize(
    ("override", "changes"),
    [
        ("output_dir=elsewhere", False),
        ("tracking.mlflow=false", False),
        ("checkpoint.keep_last=9", False),
        ("timeout_s=9", False),
        ("contrasts=[[td3,sac]]", False),
        ("label=best", False),
        ("evaluation.video_episodes=0", False),
        ("evaluation.n_scenes=9", True),
        ("evaluation.every_n_steps=9", True),
        ("evaluation.first_scene=9", True),
        ("+init_latest=true", False),
        ("init=pretrained/default", True),
        ("algorithm.gamma=0.9", True),
        ("total_timesteps=30000", True),
        ("env.duration=50", True),
        ("n_envs=4", True),
    ],
)
def test_the_run_key_changes_with_what_can_change_results(override, changes):
    assert (compose(override).run_key != compose().run_key) is changes
    assert changes_results(override.lstrip("+").partition("=")[0]) is changes


@pytest.mark.parametrize(
    "override", ["evaluation.final_n_scenes=600", "evaluation.n_certified_scenes=3"]
)
def test_the_final_evaluation_is_not_part_of_the_run_key(override):
    assert compose(override).run_key == compose().run_key


def test_strategies_and_their_options_have_one_name_everywhere():
    strategies = {f"her_{strategy}" for strategy in get_args(GoalStrategy)}
    assert strategies | {"replay"} == set(options("buffer"))
    assert set(HER_OPTIONS) <= set(inspect.signature(HerBuffer).parameters)
