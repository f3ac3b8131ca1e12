"""Tests of composing: options, overrides in Hydra's grammar, and what is refused before any value
is checked.
"""

import re
from pathlib import Path

import hydra
import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from support.runs import GROUPS, config_refusal, options

from parking_exp.config.allowlist import check_trust
from parking_exp.config.compose import compose, compose_configs, compose_runs
from parking_exp.config.overrides import conf_dir, to_hydra_syntax
from parking_exp.config.validate import validate, validate_all
from parking_exp.errors import ConfigError


@pytest.mark.parametrize(
    ("group", "option"),
    [
        pytest.param(
            group,
            option,
            marks=pytest.mark.slow if option in ("her_ablation", "her_relabelling") else (),
        )
        for group in GROUPS
        for option in options(group)
    ],
)
def test_every_option_of_every_group_composes_validates_and_is_trusted(group, option):
    needed = ["env.id=FetchReach-v4"] if option == "gymnasium" else []
    for config in validate_all(
        compose_configs("config", [f"{group}={option}", "seeds=1", *needed])
    ):
        check_trust(config, Path("config.yaml"))  # raises for a class outside the allow-list
        if group in ("env", "algorithm", "buffer"):
            assert getattr(config, group).name == option
        if group == "experiment":
            assert config.experiment_name == option


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("sead=1", "'seed'"),
        ("learning_rate=1e-3", "'algorithm.learning_rate'"),
        ("experiment=tutorail", "'tutorial'"),
        ("algorithm.policy_kwargs.n_critics=3", "++algorithm.policy_kwargs.n_critics="),
        ("algorithm.learning_rate.ende=1e-4", "'end'"),
        (
            "algorithm.verbosity=1",
            "algorithm.verbosity: there is no such key in algorithm=sac; "
            "write ++algorithm.verbosity=",
        ),
        (
            "algorithm.margin_m=0.1",
            "algorithm.margin_m: there is no such key in algorithm=sac; use it only with options "
            "that have it, such as algorithm=planner",
        ),
        (
            "env.level=hard",
            "env.level: there is no such key in env=parking; use it only with options that have "
            "it, such as env=parking_parallel",
        ),
        ("tracking.mlfow=true", "'mlflow'"),
        ("algorithm.policy_kwargs=[1]", "algorithm.policy_kwargs"),
        ("hydra.launcher.n_job=2", "'n_jobs'"),
        ("seed.x=1", "seed.x"),
        ("~seed=7", "seed"),
        ("env=null", "env=null"),
        ("seed=[1", "seed=[1"),
        ("seed=choice()", "seed=choice()"),
        ("seed=interval(0,1)", "seed=interval(0,1)"),
        ("seed=range(1,5,0)", "step"),
        ("seed=range(1,1000000000)", "at most 100000 values"),
        ("seed=shuffle(range(1,1000000000))", "at most 100000 values"),
        ("seed=range(0,1,1e-12)", "at most 100000 values"),
        ("total_timesteps=" + "9" * 5000, "total_timesteps: Exceeds the limit (4300 digits)"),
        ("label=[a]", "a label is text"),
        ("label={a:1}", "a label is text"),
        ("hydra.run.dir=elsewhere", "output_dir=DIR"),
        ("hydra.job.chdir=true", "output_dir=DIR"),
        ("+hydra.job.env_set.X=1", "environment variables in the shell"),
        ("+hydra.sweeper.params.seed='1,2'", "cells: "),
        ("hydra.sweeper.params={seed: '1,2'}", "params.seed has no effect; list the values"),
        ("hydra.job.env_set={X: 1}", "env_set.X has no effect; set environment variables"),
        ("hydra.verbose=true", "only hydra/launcher"),
        ("experiment=nowhere.yaml", "nowhere.yaml"),
        ("experiment=~nobody_here/x.yaml", "there is no such file"),
    ],
)
def test_an_invalid_override_is_refused_in_one_sentence(override, named):
    with pytest.raises(ConfigError, match=r"^[^\n]+$") as refusal:
        compose_configs("config", [override])
    assert named in str(refusal.value)


@pytest.mark.parametrize("override", ["seed=???", "seed=${seed}", "output_dir=${oc.env:NOT_SET}"])
def test_missing_values_and_broken_interpolations_name_their_key(override):
    with pytest.raises(ConfigError, match=rf"^{override.partition('=')[0]}[^\n]+$"):
        compose(override)


@pytest.mark.parametrize(
    "lines",
    [
        ["experiment=smoke", "seed=1", "output_dir='/a b'"],
        [
            "algorithm=td3",
            "+algorithm.policy_kwargs.n_critics=3",
            "~buffer.n_sampled_goal",
            "++algorithm.new=[1,2]",
        ],
        [
            "algorithm.learning_rate={_target_: a.b, end: 1}",
            "tracking={csv: false, log_interval: 3}",
        ],
        ["algorithm.gamma=1", "algorithm.gamma=0.5", "experiment_name=${algorithm.name}"],
    ],
)
def test_a_config_equals_what_hydra_composes(lines):
    (ours,) = compose_configs("config", lines)
    with initialize_config_dir(version_base="1.3", config_dir=str(conf_dir())):
        assert OmegaConf.to_yaml(ours) == OmegaConf.to_yaml(hydra.compose("config", lines))


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("seed=1", "seed=1"),
        ("run=outputs/a/seed=0", "run='outputs/a/seed=0'"),
        ("output_dir=/my runs/it's", r"output_dir='/my runs/it\'s'"),
        ("output_dir='/my runs'", "output_dir='/my runs'"),
        ("output_dir=/plain", "output_dir=/plain"),
    ],
)
def test_paths_that_hydras_grammar_cannot_parse_are_quoted(argument, expected):
    assert to_hydra_syntax(argument) == expected


def test_compose_takes_a_directory_of_the_users_own_options_for_that_call_only(tmp_path):
    words = ("evaluation=long", "evaluation.first_scene=7")
    (tmp_path / "evaluation").mkdir()
    for value, folder in ((50, tmp_path), (51, str(tmp_path))):
        path = tmp_path / "evaluation" / "long.yaml"
        path.write_text(f"defaults: [default]\nn_scenes: {value}\n")
        evaluation = compose(*words, config_dir=folder).evaluation
        assert (evaluation.n_scenes, evaluation.first_scene) == (value, 7)
    assert config_refusal("evaluation=long").startswith("evaluation=long")
    with pytest.raises(ConfigError, match=r"^--config-dir=nowhere .* is not a directory$"):
        compose("evaluation=long", config_dir="nowhere")


def test_an_experiment_file_may_be_anywhere(tmp_path):
    path = tmp_path / 'it\'s "a b"' / "own=1.yaml"
    path.parent.mkdir()
    path.write_text(
        "# @package _global_\n"
        "defaults:\n"
        "  - override /algorithm: sac\n"
        "experiment_name: own\n"
        "n_envs: 2\n"
    )
    line = f"experiment={path}"
    config = compose(line, "n_envs=4")
    assert (config.experiment_name, config.algorithm.name, config.n_envs) == ("own", "sac", 4)
    path.write_text("n_envs: [")
    with pytest.raises(ConfigError, match=r"own=1.yaml"):
        compose(line)


def test_a_cell_that_two_blocks_write_in_different_ways_is_one_cell(tmp_path):
    path = tmp_path / "overlapping.yaml"
    path.write_text(
        "# @package _global_\nexperiment_name: own\nseeds: 2\ncells:\n"
        "  - algorithm.gamma: [0.9, 0.95]\n"
        "  - {algorithm: sac, algorithm.gamma: [0.95, 0.99]}\n"
    )
    runs = compose_runs("config", [f"experiment={path}"])
    expected = [(gamma, seed) for seed in (0, 1) for gamma in (0.9, 0.95, 0.99)]
    assert [(run.cell.config.algorithm.gamma, run.seed) for run in runs] == expected
    config = compose(f"experiment={path}", "algorithm.gamma=0.95", "seed=3")
    assert (config.algorithm.arguments["gamma"], config.seed) == (0.95, 3)


@pytest.mark.parametrize(
    ("override", "labels"),
    [
        ("label=0.10", ["0.10"]),
        ("label=1e-3,0.20,'a, b',x", ["1e-3", "0.20", "a, b", "x"]),
        ("label=choice(0.10,true)", ["0.10", "true"]),
        ("++label=1_000", ["1_000"]),
        ("label='1e5'", ["1e5"]),
        ("label=null", [None]),
    ],
)
def test_labels_are_text_as_they_were_typed(override, labels):
    assert [validate(config).label for config in compose_configs("config", [override])] == labels


def test_contrasts_are_text_as_they_were_typed():
    (config,) = compose_configs("config", ["contrasts=[[0.10,1e-3],[a,'b, c']]"])
    assert validate(config).contrasts == [["0.10", "1e-3"], ["a", "b, c"]]


def test_labels_of_an_experiment_file_are_text_and_one_that_yaml_reads_as_a_number_is_refused(
    tmp_path,
):
    path = tmp_path / "mine.yaml"
    cells = "cells:\n  - {label: '0.10', algorithm.gamma: 0.9}\n  - {label: '1e-3'}\n"
    path.write_text(f"# @package _global_\n{cells}contrasts: [['0.10', '1e-3']]\n")
    (config,) = compose_configs("config", [f"experiment={path}", "label=0.10"])
    assert (config.label, config.contrasts) == ("0.10", [["0.10", "1e-3"]])
    with pytest.raises(ConfigError, match=r"did you mean '0\.10'\?$"):
        compose_configs("config", [f"experiment={path}", "label=0.1"])
    path.write_text("# @package _global_\ncells:\n  - {label: 0.10}\n")
    with pytest.raises(ConfigError, match=r"^cells: the label 0\.1 is not text; put it in quotes"):
        compose_configs("config", [f"experiment={path}"])


@pytest.mark.parametrize("as_path", [True, False])
def test_the_launcher_of_an_experiment_file_is_used_unless_the_command_line_names_one(
    tmp_path, as_path
):
    path = tmp_path / "experiment" / "on_a_cluster.yaml"
    path.parent.mkdir()
    path.write_text(
        "# @package _global_\ndefaults:\n  - smoke\n  - override /hydra/launcher: slurm\n"
        "hydra: {launcher: {n_jobs: 1, parameters: {mem_gb: 7}}}\n"
    )
    experiment = f"experiment={path}" if as_path else "experiment=on_a_cluster"
    own_options = None if as_path else str(tmp_path)

    def composed(*overrides):
        (run,) = compose_runs("config", [experiment, *overrides], own_options)
        return run.cell.launcher, run.cell.launcher_settings["n_jobs"]

    assert composed() == ("slurm", 1)
    assert composed("hydra.launcher.n_jobs=5") == ("slurm", 5)
    assert composed("hydra/launcher=local") == ("local", 1)


@pytest.mark.parametrize(
    ("overrides", "key", "values"),
    [
        (["evaluation.n_scenes=5,10", "total_timesteps=7"], "evaluation.n_scenes", [5, 10]),
        (["tracking={csv: false},{csv: true}"], "tracking.csv", [False, True]),
        (
            ["buffer=glob(her_*)"],
            "buffer.name",
            ["her_episode", "her_final", "her_future", "her_random"],
        ),
        (["seed=0,1", "buffer=her_future,replay"], "seed", [0, 0, 1, 1]),
    ],
)
def test_a_sweep_is_the_product_of_values_in_hydras_grammar(overrides, key, values):
    assert [
        OmegaConf.select(config, key) for config in compose_configs("config", overrides)
    ] == values


def test_composing_leaves_an_outer_hydra_as_it_was():
    with initialize_config_dir(version_base="1.3", config_dir=str(conf_dir())):
        before = GlobalHydra.instance().hydra
        compose_configs("config", [])
        assert GlobalHydra.instance().hydra is before
    assert not GlobalHydra.instance().is_initialized()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            "sweeper: {params: {seed: '1,2'}}",
            "hydra.sweeper.params.seed=1,2 has no effect; list the values",
        ),
        (
            "job: {chdir: true}",
            "hydra.job.chdir=True has no effect; start the command in that directory",
        ),
        (
            "job: {env_set: {X: 1}}",
            "hydra.job.env_set.X=1 has no effect; set environment variables",
        ),
        ("run: {dir: elsewhere}", "hydra.run.dir=elsewhere has no effect; set output_dir=DIR"),
    ],
)
def test_other_settings_of_hydra_in_a_file_are_refused(tmp_path, settings, words):
    path = tmp_path / "mine.yaml"
    path.write_text(f"# @package _global_\nhydra: {{{settings}}}\n")
    with pytest.raises(ConfigError, match=rf"^{re.escape(words)}[^\n]*$"):
        compose_configs("config", [f"experiment={path}"])


@pytest.mark.parametrize("name", ["evaluate", "export", "report", "status"])
def test_a_launcher_is_refused_by_commands_that_launch_nothing(name):
    words = "has no effect; this command launches no runs; leave it out"
    with pytest.raises(ConfigError, match=rf"^hydra\.launcher\.\S+ {words}$"):
        compose_configs(name, ["hydra/launcher=slurm"])
    with pytest.raises(ConfigError, match=rf"^hydra\.launcher\.n_jobs=2 {words}$"):
        compose_configs(name, ["hydra.launcher.n_jobs=2"])


def test_arguments_that_a_class_of_the_users_own_takes_are_suggested(tmp_path, monkeypatch):
    (tmp_path / "floor_sac.py").write_text(
        "from stable_baselines3 import SAC\n"
        "class FloorSAC(SAC):\n"
        "    def __init__(self, *args, entropy_floor: float = 0.0, **rest):\n"
        "        super().__init__(*args, **rest)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "conf" / "algorithm").mkdir(parents=True)
    option = "defaults: [sac, _self_]\nname: floor_sac\n_target_: floor_sac.FloorSAC\n"
    (tmp_path / "conf" / "algorithm" / "floor_sac.yaml").write_text(option)
    for override, hint in (
        ("algorithm.entropy_flor=2", "did you mean '++algorithm.entropy_floor'?"),
        ("algorithm.entropy_floor=2", "write ++algorithm.entropy_floor=VALUE to add it"),
        ("algorithm.learning_start=2", "did you mean 'learning_starts'?"),
    ):
        with pytest.raises(ConfigError, match=rf"{re.escape(hint)}$"):
            compose_configs("config", ["algorithm=floor_sac", override], str(tmp_path / "conf"))
