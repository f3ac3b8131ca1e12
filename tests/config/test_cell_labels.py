"""Tests of factors, levels and cell labels, read from the configs of cells."""

from itertools import product

import pandas as pd
import pytest
from support.runs import stored_params

from parking_exp.config.cell_labels import find_factors, label_cells, labels_from_factors
from parking_exp.config.compose import compose_runs
from parking_exp.config.schema import PLANNER
from parking_exp.config.settings import differing_keys
from parking_exp.errors import ConfigError
from parking_exp.reports.cell_selection import choose_cells, find_contrasts, group_runs
from parking_exp.results.frame_export import config_column
from parking_exp.sweeps.sweep import plan


def cell(env="parking", algorithm="sac", buffer="her_future", **others):
    """A config as flat keys; keys of `others` have `__` for dots."""
    base = {
        "env.name": env,
        "algorithm.name": algorithm,
        "algorithm._target_": f"module.{algorithm.upper()}",
        "algorithm.gamma": 0.95,
        "buffer.name": buffer,
        "total_timesteps": 20000,
        "seed": 0,
        "tracking.uri": None,
    }
    if buffer != "replay":
        base |= {
            "buffer.goal_selection_strategy": buffer.removeprefix("her_"),
            "buffer.n_sampled_goal": 4,
        }
    return base | {key.replace("__", "."): value for key, value in others.items()}


def described(configs, experiments=None):
    factors, settings = find_factors(configs, experiments or ["one"] * len(configs))
    names = [f"{number}-{number}" for number in range(len(configs))]
    return [factor.key for factor in factors], labels_from_factors(factors, settings, names)


def test_keys_that_follow_from_a_groups_option_are_no_factors():
    keys, labels = described([cell(algorithm="sac"), cell(algorithm="td3"), cell(algorithm="ddpg")])
    assert keys == ["algorithm"]
    assert labels == ["sac", "td3", "ddpg"]


@pytest.mark.parametrize("n_runs", [1, 2])
def test_each_key_that_a_search_varies_is_a_factor_whatever_the_number_of_runs(n_runs):
    goals = [1, 2, 4, 8, 1, 2]
    trials = [cell(algorithm__gamma=n / 100, buffer__n_sampled_goal=goals[n]) for n in range(6)]
    keys, _ = described(trials * n_runs)
    assert keys == ["algorithm.gamma", "buffer.n_sampled_goal"]


def test_the_control_of_a_her_ablation_has_no_n_sampled_goal():
    crossed = [
        cell(buffer=f"her_{strategy}", buffer__n_sampled_goal=n)
        for strategy, n in product(["future", "final", "random"], [1, 4, 8])
    ]
    factors, settings = find_factors([*crossed, cell(buffer="replay")], ["her"] * 10)
    assert [(factor.key, factor.numeric) for factor in factors] == [
        ("buffer", False),
        ("buffer.n_sampled_goal", True),
    ]
    assert factors[1].levels == [1, 4, 8]
    assert settings[-1] == {"buffer": "replay", "buffer.n_sampled_goal": None}
    labels = labels_from_factors(factors, settings, ["name-key"] * 10)
    assert labels[-1] == "replay"
    assert labels[2] == "her_future, n_sampled_goal=8"


def test_keys_that_always_change_together_count_once():
    small, full = (
        {"evaluation__n_scenes": 20},
        {"total_timesteps": 60000, "evaluation__n_scenes": 50},
    )
    keys, labels = described(
        [cell(env, **budget) for env in ("parking", "parking_sparse") for budget in (small, full)]
    )
    assert keys == ["env", "total_timesteps"]
    assert labels[3] == "parking_sparse, total_timesteps=60000"


def test_seed_store_and_checkpoints_do_not_distinguish_cells():
    changes = {
        "seed": 3,
        "tracking.uri": "http://x",
        "checkpoint.keep_last": 1,
        "evaluation.video_episodes": 3,
    }
    assert differing_keys([cell(), cell() | changes]) == []


def test_a_label_of_the_config_replaces_the_keys_that_it_determines():
    tutorial, default = (
        cell(label="tutorial", algorithm__gamma=0.9, n_envs=1),
        cell(label="default", algorithm="td3"),
    )
    assert described([tutorial, default]) == (["label"], ["tutorial", "default"])
    assert label_cells([tutorial], ["name-key"]) == ["tutorial"]
    shared = [tutorial, cell(label="tutorial", algorithm__gamma=0.8, n_envs=1), cell()]
    assert described(shared)[1] == ["tutorial, gamma=0.9", "tutorial, gamma=0.8", "gamma=0.95"]


def test_null_is_a_level_where_the_same_option_has_a_value_elsewhere():
    keys, labels = described([cell(env__training_duration=20.0), cell()])
    assert keys == ["env.training_duration"]
    assert labels == ["training_duration=20", "training_duration=null"]


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["buffer.demonstrations=0,5"], {"demonstrations=0", "demonstrations=5"}),
        (["env.standing_reward=0,-0.3"], {"standing_reward=0", "standing_reward=-0.3"}),
        (["env.observation.rays=0,4"], {"rays=0", "rays=4"}),
    ],
)
def test_defaults_that_stored_configs_leave_out_are_levels(overrides, expected):
    runs = compose_runs("config", ["env=parking_parallel", "algorithm=td3", *overrides])
    assert {run.label for run in plan(runs)} == expected


def test_only_the_tasks_that_have_a_key_have_its_default():
    parking = cell(env__task="parking")
    reach = cell(env="fetch_reach", env__task="gymnasium")
    _, labels = described([parking | {"env.standing_reward": -0.3}, parking, reach])
    assert labels == ["parking, standing_reward=-0.3", "parking, standing_reward=0", "fetch_reach"]


def test_a_demonstrator_that_is_stored_for_its_arguments_is_no_level():
    careful = {
        "buffer.demonstrator._target_": PLANNER["_target_"],
        "buffer.demonstrator.margin_m": 0.2,
    }
    _, labels = described([cell(), cell() | careful])
    assert labels == ["margin_m=null", "margin_m=0.2"]


def test_experiments_come_first_and_take_what_follows_from_them():
    keys, labels = described(
        [cell(), cell(algorithm__gamma=0.8), cell(n_envs=8)], ["one", "one", "two"]
    )
    assert keys == ["experiment", "algorithm.gamma"]
    assert labels == ["one, gamma=0.95", "one, gamma=0.8", "two, gamma=0.95"]


def test_factors_with_the_same_last_part_have_longer_names():
    durations = [(1, 1), (2, 1), (1, 2)]
    factors, _ = find_factors(
        [cell(env__duration=a, algorithm__duration=b) for a, b in durations], ["one"] * 3
    )
    assert {factor.name for factor in factors} == {"env.duration", "algorithm.duration"}


def test_labels_that_are_the_same_get_the_key_of_their_cell():
    factors, _ = find_factors([cell(), cell(algorithm="td3")], ["one"] * 2)
    settings = [{"algorithm": name} for name in ("sac", "td3", "sac")]
    names = ["parking-sac-her-aa", "b-bb", "parking-sac-her-cc"]
    assert labels_from_factors(factors, settings, names) == ["sac (aa)", "td3", "sac (cc)"]


def stored(runs):
    """Planned runs as rows of `Results.runs`."""
    configs = [stored_params(run.config) for run in runs]
    columns = {
        f"config.{key}": config_column(c.get(key) for c in configs) for key in set().union(*configs)
    }
    columns |= {
        "cell": [run.config.cell_name for run in runs],
        "seed": [run.config.seed for run in runs],
    }
    return pd.DataFrame(
        {"experiment": "parking", "status": "done", "started": range(len(runs)), **columns}
    )


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["precision=highest,medium", "seeds=2"], {"precision=highest", "precision=medium"}),
        (["n_envs=16", "env.training_duration=20,null", "algorithm.net_arch=[64,64],[8]"], None),
        (["++algorithm.policy_kwargs={},{n_critics:3}", "updates_per_step=1e-2,1e-1"], None),
    ],
)
def test_plans_and_reports_label_the_same_cells_alike(overrides, expected, tmp_path):
    runs = plan(compose_runs("config", [*overrides, f"output_dir={tmp_path}"]))
    planned = {run.config.cell_name: run.label for run in runs}
    assert planned == {cell.name: cell.label for cell in group_runs(stored(runs))}
    assert expected is None or set(planned.values()) == expected


@pytest.mark.parametrize(
    "experiment",
    [
        "envs_and_updates",
        "goal_tasks",
        "her_lots",
        "her_tuned",
        "ladder",
        "td3_or_sac",
        "tight_lots",
        "time_to_95",
    ],
)
def test_declared_contrasts_name_cells_of_their_experiment(experiment, tmp_path):
    runs = plan(
        compose_runs("config", [f"experiment={experiment}", "seeds=1", f"output_dir={tmp_path}"])
    )
    cells = group_runs(stored(runs))
    contrasts, *problems = find_contrasts(cells)
    assert (len(contrasts), problems) == (len(runs[0].config.contrasts), [[], []])
    if experiment == "ladder":
        assert [cell.label for cell in choose_cells(cells, ["label='no EMA',default"])] == [
            "default",
            "no EMA",
        ]


def test_a_label_on_the_command_line_selects_a_cell_and_renames_none():
    (run,) = plan(compose_runs("config", ["experiment=ladder", "seeds=1", "label='no EMA'"]))
    assert (run.config.label, run.config.algorithm.policy_ema_half_life) == ("no EMA", None)
    two = compose_runs("config", ["experiment=ladder", "seeds=1", "label='no EMA',default"])
    assert [run.config.label for run in plan(two)] == ["default", "no EMA"]
    any_text = compose_runs(
        "config", [r"""cells=[{label:"a, 'b\c'",seed:1},{label:null,seed:2}]"""]
    )
    assert [run.config.label for run in plan(any_text)] == [r"a, 'b\c'", None]
    (cell,) = choose_cells(group_runs(stored(plan(any_text))), [r"""label="a, 'b\c'" """.strip()])
    assert cell.label == r"a, 'b\c'"
    for overrides, hint in {
        (
            "experiment=ladder",
            "label=default,no EMAs",
        ): "label=no EMAs: experiment=ladder .*; did you mean 'no EMA'",
        (
            "experiment=goal_tasks",
            "label='fetch_reach, replay'",
        ): "goal_tasks has no such label; select cells by their",
    }.items():
        with pytest.raises(ConfigError, match=hint):
            compose_runs("config", [*overrides])
