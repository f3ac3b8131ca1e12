"""Tests of config validation: what is refused, and the sentence that says so."""

import contextlib
import copy
import re
import shutil

import hydra
import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from support.runs import GROUPS, make_config, options

from parking_exp.config import compose as composing
from parking_exp.config.compose import composed, config_dir
from parking_exp.config.validate import validate
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_run import validate_request
from parking_exp.resources import total_memory

TUTORIAL = {
    "total_timesteps": 10_000,
    "n_envs": 1,
    "updates_per_step": 1.0,
    "algorithm.target": "parking_exp.algorithms.SAC",
    "algorithm.features": "raw",
    "algorithm.net_arch": [256, 256, 256],
    "algorithm.learning_rate": 1e-3,
    "algorithm.gamma": 0.95,
    "algorithm.batch_size": 256,
    "algorithm.tau": 0.005,
    "algorithm.learning_starts": 500,
    "buffer.buffer_size": 1_000_000,
    "buffer.n_sampled_goal": 4,
    "buffer.goal_selection_strategy": "future",
    "env.training_duration": None,
    "env.training_success_goal_reward": None,
    "env.duration": 100,
}


@pytest.mark.parametrize(
    ("group", "option"),
    [
        pytest.param(group, option, marks=pytest.mark.slow if option in ("her_ablation", "her_relabelling") else ())
        for group in GROUPS
        for option in options(group)
    ],
)
def test_every_option_of_every_group_composes_and_validates(group, option):
    for composed_config in composed("config", [f"{group}={option}"]):
        config = validate(composed_config)
        if group in ("env", "algorithm", "buffer"):
            assert getattr(config, group).name == option
        if group == "experiment":
            assert config.experiment_name == option


def schedule(key, value):
    """A learning rate that falls, with one of its arguments changed."""
    node = {"_target_": "stable_baselines3.common.utils.LinearSchedule", "start": 0.1, "end": 0.0, "end_fraction": 1.0}
    return f"algorithm.learning_rate={{{','.join(f'{name}:{one}' for name, one in (node | {key: value}).items())}}}"


def test_the_expected_options_are_there():
    assert {group: options(group) for group in GROUPS} == {
        "env": [
            "parking", "parking_2021", "parking_action_repeat", "parking_crowded", "parking_sparse", "parking_stop",
            "parking_stop_crowded",
        ],
        "algorithm": ["crossq", "ddpg", "sac", "td3", "tqc"],
        "buffer": ["her_episode", "her_final", "her_future", "her_random", "replay"],
        "budget": ["full", "small", "tiny"],
        "evaluation": ["default"],
        "checkpoint": ["default"],
        "tracking": ["default"],
        "experiment": [
            "algorithms", "envs_and_updates", "features", "her_ablation", "her_relabelling", "parked", "smoke", "tutorial",
            "variants",
        ],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("override", "hint"),
    [
        ("sead=1", "seed"),
        ("learning_rate=1e-3", "algorithm.learning_rate"),
        ("n_sampled_goal=4", "buffer.n_sampled_goal"),
        ("env=parkin_sparse", "parking_sparse"),
        ("experiment=tutorail", "tutorial"),
        ("+env.duratoin=3", "duration"),
        ("algorithm.learning_rat=1", "learning_rate"),
        ("+algorithm.gama=1", "gamma"),
        ("evaluation.n_scene=3", "n_scenes"),
        ("algorithm.policy_kwargs.n_critics=3", "+algorithm.policy_kwargs.n_critics=3"),
        ("tracking.mlfow=true", "mlflow"),
        ("seed=-1", "0"),
        ("total_timesteps=0", "1"),
        ("device=gpu", "cuda:N"),
        ("algorithm.gamma=1.5", "1.0"),
        ("algorithm.tau=0", "greater than 0.0"),
        ("algorithm.learning_rate=-1", "greater than 0.0"),
        ("algorithm.batch_size=1.5", ""),
        ("algorithm=sac algorithm.use_sde=3", ""),
        ("algorithm.features=egoo", "ego"),
        ("buffer.relabel_collision=kep", "keep"),
        ("buffer.goal_velocity=1", ""),
        ("buffer.goal_selection_strategy=futur", "future"),
        ("+algorithm.seed=3", "seed"),
        ("+algorithm.buffer_size=3", "buffer.buffer_size"),
        ("algorithm._target_=nowhere.SAC", "not installed"),
        ("evaluation=often", ""),
        ("algorithm.gamma=null", ""),
        ("algorithm=sac algorithm.ent_coef=atuo", "auto"),
        ("~algorithm.learning_starts", "25856"),
        ("~buffer.n_sampled_goal algorithm.learning_starts=10", "25856"),
        ("total_timesteps=26000", "26001"),
        ("algorithm=td3 algorithm.action_noise.sigma=[0.1]", ""),
        ("env.other_vehicles_type=nowhere.Car", ""),
        ("env.action.speed_range=[5,-5]", ""),
        ("updates_per_step=0.0004", "0.001"),
        ("algorithm.train_freq=[1,episode]", "n_envs=1"),
        ("+env.controlled_vehicles=2", ""),
        ("+algorithm.n_steps=3", "set by the run"),
        ("+buffer.optimize_memory_usage=true", "set by the run"),
        ("algorithm.learning_starts=100", "25856"),
        ("buffer.buffer_size=800", "26112"),
        ("evaluation.first_scene=2147483600", "2147483148"),
        ("algorithm=td3 algorithm.action_noise.sigma=[-0.1,0.1]", "0.0"),
        ("+algorithm.policy_kwargs.n_critic=3", "n_critics"),
        ("+algorithm.policy_kwargs.n_critics=0", "1"),
        ("+algorithm.policy_kwargs.use_sde=true", "algorithm.use_sde"),
        ("+algorithm.policy_kwargs.optimizer_kwargs={weight_decy:0.1}", "weight_decay"),
        ("+algorithm.policy_kwargs.optimizer_kwargs={lr:0.1}", "algorithm.learning_rate"),
        (
            "+algorithm.policy_kwargs.features_extractor_class=parking_exp.algorithms.features.EgoFrameExtractor",
            "algorithm.features=raw",
        ),
        ("+algorithm.policy_kwargs.activation_fn=torch.nn.Tan", "Tanh"),
        ("+algorithm.policy_kwargs.activation_fn=tanh", ""),
        ("+algorithm.policy_kwargs.activation_fn=torch.optim.Adam", "torch.nn.Module"),
        ("+algorithm.policy_kwargs.activation_fn={_target_:hydra.utils.get_class,path:torch.nn.Tan}", "Tanh"),
        ("+algorithm.policy_kwargs.activation_fn={_target_:torch.nn.LeakyReLU,negative_slop:0.2}", "negative_slope"),
        ("algorithm.policy_kwargs=[1]", ""),
        ("env.duration=1e9", "100000.0"),
        ("env.success_goal_reward=1e300", ""),
        ("algorithm.net_arch=[64,1e300]", ""),
        (f"n_envs={'9' * 5000}", ""),
        (f"seeds={'9' * 5000}", ""),
        ("torch_threads=1000000", "1024"),
        ("experiment=tutorial algorithm.learning_rate={}", ""),
        ("algorithm=sac algorithm.action_noise={}", ""),
        ("algorithm.train_freq=[0,step]", ""),
        ("buffer.relabel_collision=null", ""),
        ("buffer.goal_selection_strategy=[future]", "future"),
        ("+algorithm.policy_kwargs.net_arch=[5]", "algorithm.net_arch"),
        ("+algorithm.policy_kwargs.n_critics=100000", "100"),
        ("+algorithm.policy_kwargs.optimizer_kwargs={betas:[0.9,1]}", "less than 1.0"),
        ("+algorithm.policy_kwargs.optimizer_kwargs={betas:0.9}", ""),
        ("evaluation.final_n_scenes=10000000000", "2147483648"),
        ("algorithm._target_=stable_baselines3.PPO", ""),
        ("algorithm._target_=json.dumps", "off-policy"),
        ("buffer._target_=stable_baselines3.SAC", "replay buffer"),
        ("algorithm._target_=__main__.X", ""),
        ("algorithm._target_=builtins.dict", ""),
        ("=3", "KEY=VALUE"),
        ("budget=null", ""),
        ("buffer=[replay,x]", ""),
        ("env@foo=parking", "env=OPTION"),
        ("seed=???", ""),
        ("algorithm.learning_rate=inf", "finite"),
        ("+algorithm.policy_kwargs.log_std_init=nan", "finite"),
        ("+algorithm.policy_kwargs.optimizer_kwargs.eps=inf", "finite"),
        ("updates_per_step=nan", "finite"),
        ("timeout_s=inf", "finite"),
        ("env.reward_weights=[inf,1,1,1,1,1]", "finite"),
        ("algorithm=td3 algorithm.action_noise.mean=[0,nan]", "finite"),
        ("tracking.uri=ftp://host/store", "sqlite:///PATH"),
        ("tracking.uri='sqlite://'", "sqlite:///PATH"),
        ("tracking.uri='sqlite:///a.db?timeout=9'", "sqlite:///PATH"),
    ],
)
def test_what_cannot_run_is_refused_in_a_sentence_with_its_key_and_a_valid_choice(override, hint):
    refused(override, override.split()[-1].lstrip("+~").partition("=")[0], hint)


@pytest.mark.parametrize(
    ("override", "key", "hint"),
    [
        ("buffer.goal_selection_strategy=null", "buffer.n_sampled_goal", "buffer=her_future"),
        (
            "env.observation.features=[x,y,cos_h,sin_h] env.observation.scales=[1,1,1,1] algorithm.features=raw",
            "env.observation",
            "",
        ),
        ("env.policy_frequency=20 n_envs=1", "env.policy_frequency", "15"),
        (
            "env.observation.features=[y,x,vx,vy,cos_h,sin_h] buffer=replay",
            "algorithm.features",
            "algorithm.features=raw",
        ),
        (schedule("start", "-7"), "algorithm.learning_rate.start", "greater than 0.0"),
        (schedule("end", "-1"), "algorithm.learning_rate.end", "0.0"),
        (schedule("end_fraction", "-1"), "algorithm.learning_rate.end_fraction", "greater than 0.0"),
        (schedule("end_fraction", "2"), "algorithm.learning_rate.end_fraction", "1.0"),
        (schedule("start", "nan"), "algorithm.learning_rate.start", ""),
        (schedule("_target_", "3"), "algorithm.learning_rate._target_", ""),
        ("algorithm=sac algorithm._target_=sb3_contrib.TQC", "algorithm.features", "algorithm.features=ego_fine"),
        ("env.success_goal_reward=0.08", "env.training_success_goal_reward", "0.08"),
    ],
)
def test_what_contradicts_another_key_is_refused_with_the_key_to_change(override, key, hint):
    refused(override, key, hint)


def refused(override, key, hint):
    with pytest.raises(ConfigError) as refusal:
        make_config(*override.split())
    message = str(refusal.value)
    assert message.startswith(key)
    assert hint in message
    assert "\n" not in message


@pytest.mark.parametrize("uri", ["http://localhost:5000", "sqlite:///runs.db", "postgresql+psycopg2://me@host/mlflow"])
def test_stores_that_mlflow_knows_are_taken(uri):
    assert make_config(f"tracking.uri={uri}").tracking.uri == uri


def keys(node, path=()):
    """Paths of all keys and list entries of a plain config."""
    for name, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield (*path, name)
        yield from keys(value, (*path, name))


@pytest.mark.parametrize("value", [1e300, -1e300, 1e12, 10**5000, -(10**5000), 0, [], {}, None, [None]], ids=range(10))
def test_a_value_is_refused_in_a_sentence_or_taken_whatever_it_is_and_wherever_it_stands(value):
    default = make_config().plain()
    for path in keys(default):
        plain = copy.deepcopy(default)
        node = plain
        for name in path[:-1]:
            node = node[name]
        node[path[-1]] = value
        with contextlib.suppress(ConfigError):
            config = validate(plain)
            assert config.run_key
            assert config.update_rounds()[0]


@pytest.mark.parametrize(
    ("override", "size"),
    [
        ("buffer.buffer_size=99999999999", "11,300.0 GB"),
        ("algorithm.batch_size=99999999999", "11,300.0 GB"),
        ("algorithm.net_arch=[9999999,9999999]", "400,000.0 GB"),
        ("evaluation.final_n_scenes=2000000000", "2,000.0 GB"),
    ],
)
def test_what_never_fits_into_memory_is_refused_with_what_it_takes_and_what_there_is(override, size):
    refused(override, override.partition("=")[0], size)
    refused(override, override.partition("=")[0], f"this machine has {total_memory() / 1e9:,.1f} GB")


@pytest.mark.parametrize(
    "override",
    ["seed=[1", "run name=3", "seed", "experiment_name=a b(", "experiment_name='a", "algorithm=sac,", "seed=choice()"],
)
def test_what_hydras_grammar_cannot_read_is_refused_with_how_to_write_it(override):
    with pytest.raises(ConfigError, match=f"^{re.escape(override)}: .*KEY=VALUE"):
        make_config(override)


@pytest.mark.parametrize("algorithm", options("algorithm"))
def test_policy_kwargs_are_those_of_the_algorithms_own_policy(algorithm):
    make_config(f"algorithm={algorithm}", "+algorithm.policy_kwargs={n_critics:3,net_arch:{pi:[8],qf:[9]}}")
    refused(
        f"algorithm={algorithm} +algorithm.policy_kwargs.n_critic=3", "algorithm.policy_kwargs.n_critic", "n_critics"
    )


def test_an_evaluation_has_no_more_episodes_than_there_are_scenes():
    (config,) = composed("evaluate", ["episodes=10000000000"])
    with pytest.raises(ConfigError, match=r"^episodes=10000000000 .* 2147483648$"):
        validate_request(config)


def test_the_suggested_choices_are_valid():
    assert make_config("algorithm.learning_starts=25856").algorithm.arguments["learning_starts"] == 25856
    assert make_config("buffer.buffer_size=26112").buffer.buffer_size == 26112
    assert make_config("total_timesteps=26001").total_timesteps == 26001


def test_plain_replay_may_start_learning_within_an_episode():
    config = make_config("buffer=replay", "algorithm.learning_starts=10")
    assert config.algorithm.arguments["learning_starts"] == 10


def test_nested_targets_are_checked_too():
    refused("algorithm=td3 +algorithm.action_noise.sigm=1", "algorithm.action_noise.sigm", "did you mean 'sigma'")
    noise = "{_target_:stable_baselines3.common.noise.NormalActionNoise,mean:[0,0]}"
    refused(f"algorithm=sac algorithm.action_noise={noise}", "algorithm.action_noise.sigma", "missing")


def test_several_keys_of_a_group_can_be_set_at_once():
    config = make_config("tracking={csv: false, log_interval: 3}", "checkpoint={every_n_steps: null}")
    assert (config.tracking.csv, config.tracking.log_interval, config.tracking.tensorboard) == (False, 3, True)
    assert (config.checkpoint.every_n_steps, config.checkpoint.keep_last) == (None, 2)


def test_a_users_own_options_of_every_group_are_taken(tmp_path):
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "long.yaml").write_text("defaults: [default]\nn_scenes: 50\n")
    (config,) = composed("config", ["evaluation=long", "evaluation.first_scene=7"], str(tmp_path))
    assert (config.evaluation.n_scenes, config.evaluation.first_scene, config.evaluation.final_n_scenes) == (50, 7, 500)


def test_configs_that_are_composed_together_are_apart():
    one, other = composed("config", ["evaluation.n_scenes=5,10", "total_timesteps=7"])
    assert (one.evaluation.n_scenes, other.evaluation.n_scenes) == (5, 10)
    tutorial, smoke = composed("config", ["experiment=tutorial,smoke"])
    assert (tutorial.checkpoint.every_n_steps, smoke.checkpoint.every_n_steps) == (2500, 100)


@pytest.mark.parametrize(
    "lines",
    [
        ["experiment=smoke", "seed=1", "output_dir='/a b'"],
        ["algorithm=td3", "+algorithm.policy_kwargs.n_critics=3", "~buffer.n_sampled_goal", "++algorithm.new=[1,2]"],
        ["env=parking_sparse", "algorithm.learning_rate={_target_: a.b, end: 1}"],
        ["algorithm.gamma=1", "algorithm.gamma=0.5", "experiment_name=${algorithm.name}"],
    ],
)
def test_a_config_is_what_hydra_composes(lines):
    (ours,) = composed("config", lines)
    with initialize_config_dir(version_base="1.3", config_dir=str(config_dir())):
        assert OmegaConf.to_yaml(ours) == OmegaConf.to_yaml(hydra.compose("config", lines))


@pytest.mark.parametrize("line", ["seed.x=1", "+seed=1", "~seed=7", "env@x=parking"])
def test_what_hydra_cannot_compose_is_a_sentence(line):
    with pytest.raises(ConfigError, match=r"^[^\n]+$"):
        composed("config", [line])


def test_files_that_have_changed_are_composed_anew_in_the_same_process(tmp_path, monkeypatch):
    tree = tmp_path / "conf"
    shutil.copytree(config_dir(), tree)
    monkeypatch.setattr(composing, "config_dir", lambda: tree)
    (before,) = composed("config", ["env=parking"])
    before.env.duration = -1  # what a caller does to one is done to no other
    assert composed("config", ["env=parking"])[0].env.duration == 100
    (tree / "env" / "parking.yaml").write_text(
        (tree / "env" / "parking.yaml").read_text().replace("duration: 100", "duration: 101")
    )
    (tree / "env" / "mine.yaml").write_text("defaults: [parking]\nname: mine\n")
    for option in ("parking", "mine"):
        assert composed("config", [f"env={option}"])[0].env.duration == 101


def test_directories_that_one_call_searches_are_not_searched_by_the_next(tmp_path):
    (tmp_path / "env").mkdir()
    (tmp_path / "env" / "mine.yaml").write_text("defaults: [parking]\nname: mine\n")
    composed("config", [f"hydra.searchpath=[{tmp_path}]"])
    with pytest.raises(ConfigError, match=r"^env=mine: there is no such option"):
        composed("config", ["env=mine"])


def test_options_can_be_swept_by_pattern():
    assert [config.buffer.name for config in composed("config", ["buffer=glob(her_*)"])] == [
        "her_episode", "her_final", "her_future", "her_random",
    ]  # fmt: skip


def test_composing_leaves_an_outer_hydra_as_it_was():
    with initialize_config_dir(version_base="1.3", config_dir=str(config_dir())):
        before = GlobalHydra.instance().hydra
        composed("config", [])
        assert GlobalHydra.instance().hydra is before
    assert not GlobalHydra.instance().is_initialized()


def test_every_point_of_a_sweep_is_checked():
    assert len(composed("config", ["seed=0,1", "buffer=her_future,replay"])) == 4
    with pytest.raises(ConfigError, match=r"algorithm.gamma=2 is out of range"):
        for config in composed("config", ["algorithm.gamma=0.9,2"]):
            validate(config)


def test_the_experiment_overrides_the_root_and_the_command_line_overrides_both():
    assert make_config("experiment=tutorial").total_timesteps == 10_000
    assert make_config("experiment=tutorial", "total_timesteps=1234").total_timesteps == 1234


def test_tutorial_is_the_usual_recipe():
    config = make_config("experiment=tutorial")
    found = {}
    for key in TUTORIAL:
        section, _, name = key.rpartition(".")
        node = getattr(config, section) if section else config
        found[key] = getattr(node, name) if name in type(node).model_fields else node.arguments[name]
    assert found == TUTORIAL


def test_validating_does_not_change_the_config():
    (config,) = composed("config", [])
    before = OmegaConf.to_yaml(config)
    validate(config)
    assert OmegaConf.to_yaml(config) == before


def test_a_checked_config_survives_a_round_trip():
    config = make_config("experiment=smoke")
    assert validate(config.plain()) == config


def test_a_sweep_over_several_keys_of_a_group_is_a_sweep():
    found = composed("config", ["tracking={csv: false},{csv: true}"])
    assert [config.tracking.csv for config in found] == [False, True]
