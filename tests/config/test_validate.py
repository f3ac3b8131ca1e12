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

ARTICLE = {
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
    "evaluation.every_n_steps": 1000,
    "evaluation.n_scenes": 5,
    "checkpoint.keep_last": 1,
    "env.training_duration": None,
    "env.training_success_goal_reward": None,
    "env.duration": 100,
}


@pytest.mark.parametrize(
    ("group", "option"),
    [
        pytest.param(group, option, marks=pytest.mark.slow if option in ("her_ablation", "her_traps") else ())
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
            "parking", "parking_2021", "parking_action_repeat", "parking_parked", "parking_sparse", "parking_stop",
            "parking_stop_parked",
        ],
        "algorithm": ["crossq", "ddpg", "sac", "td3", "tqc"],
        "buffer": ["her_episode", "her_final", "her_future", "her_random", "replay"],
        "budget": ["full", "small", "tiny"],
        "evaluation": ["default"],
        "checkpoint": ["default"],
        "tracking": ["default"],
        "experiment": [
            "algorithms", "article", "envs_and_updates", "features", "her_ablation", "her_traps", "parked", "smoke", "tutorial",
            "variants",
        ],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("sead=1", "sead: there is no such key; did you mean 'seed'?"),
        ("algoritm=sac", "algoritm: there is no such key; did you mean 'algorithm'?"),
        ("env=parkin_sparse", "env=parkin_sparse: there is no such option; did you mean 'parking_sparse'?"),
        ("algorithm=sca", "algorithm=sca: there is no such option; did you mean 'sac'?"),
        ("experiment=artcle", "experiment=artcle: there is no such option; did you mean 'article'?"),
        ("env.duratoin=3", "env.duratoin: there is no such key; did you mean 'duration'?"),
        ("+env.duratoin=3", "env.duratoin: there is no such key; did you mean 'duration'?"),
        ("env.observation.scale=3", "env.observation.scale: there is no such key; did you mean 'scales'?"),
        ("algorithm.learning_rat=1", "algorithm.learning_rat: there is no such key; did you mean 'learning_rate'?"),
        (
            "+algorithm.gama=1",
            "algorithm.gama: parking_exp.algorithms.TD3 has no such argument; did you mean 'gamma'?",
        ),
        ("buffer.n_sampled_goals=3", "buffer.n_sampled_goals: there is no such key; did you mean 'n_sampled_goal'?"),
        (
            "+buffer.n_sampled_goals=3",
            "buffer.n_sampled_goals: parking_exp.buffers.HerBuffer has no such argument; "
            "did you mean 'n_sampled_goal'?",
        ),
        ("evaluation.n_scene=3", "evaluation.n_scene: there is no such key; did you mean 'n_scenes'?"),
        ("checkpoint.keep=3", "checkpoint.keep: there is no such key; did you mean 'keep_last'?"),
        (
            "algorithm.policy_kwargs.n_critics=3",
            "algorithm.policy_kwargs.n_critics: algorithm.policy_kwargs is empty so far; "
            "write +algorithm.policy_kwargs.n_critics=3",
        ),
        ("tracking.mlfow=true", "tracking.mlfow: there is no such key; did you mean 'mlflow'?"),
    ],
)
def test_a_misspelt_name_is_refused_by_name_with_the_closest_valid_one(override, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_config(override)


@pytest.mark.parametrize("uri", ["ftp://host/store", "./mlruns", "file:///tmp/mlruns"])
def test_a_store_that_can_never_work_is_refused(uri):
    message = f"tracking.uri={uri} is no MLflow store; use sqlite:///PATH, or http://HOST:PORT of a tracking server"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_config(f"tracking.uri={uri}")
    make_config(f"tracking.uri={uri}", "tracking.mlflow=false")


@pytest.mark.parametrize("uri", ["sqlite://", "sqlite:///a.db?timeout=9"])
def test_a_sqlite_store_is_a_path(uri):
    message = f"tracking.uri={uri} is not sqlite:///PATH, with nothing after the path"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_config(f"tracking.uri='{uri}'")


@pytest.mark.parametrize("uri", ["http://localhost:5000", "sqlite:///runs.db", "postgresql+psycopg2://me@host/mlflow"])
def test_stores_that_mlflow_knows_are_taken(uri):
    assert make_config(f"tracking.uri={uri}").tracking.uri == uri


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("seed=abc", "seed='abc': input should be a valid integer"),
        ("seed=-1", "seed=-1 is out of range; the closest valid choice is 0"),
        ("seed=true", "seed=True: input should be a valid integer"),
        ("total_timesteps=0", "total_timesteps=0 is out of range; the closest valid choice is 1"),
        ("n_envs=0", "n_envs=0 is out of range; the closest valid choice is 1"),
        ("device=gpu", "device='gpu' is not a valid choice; choose from cpu, auto, cuda, cuda:N"),
        ("algorithm.gamma=1.5", "algorithm.gamma=1.5 is out of range; the closest valid choice is 1.0"),
        ("algorithm.tau=0", "algorithm.tau=0 is out of range; it must be greater than 0.0"),
        ("algorithm.learning_rate=-1", "algorithm.learning_rate=-1 is out of range; it must be greater than 0.0"),
        ("algorithm.batch_size=0", "algorithm.batch_size=0 is out of range; the closest valid choice is 1"),
        (
            "algorithm.batch_size=1.5",
            "algorithm.batch_size=1.5 has the wrong type; parking_exp.algorithms.TD3 takes int",
        ),
        ("algorithm=sac algorithm.use_sde=3", "algorithm.use_sde=3 has the wrong type; parking_exp.algorithms.SAC takes bool"),
        ("algorithm.features=egoo", "algorithm.features=egoo is not a valid choice; did you mean 'ego'?"),
        ("buffer.relabel_collision=kep", "buffer.relabel_collision=kep is not a valid choice; did you mean 'keep'?"),
        ("buffer.relabel_terminated=gaol", "buffer.relabel_terminated=gaol is not a valid choice; did you mean 'goal'?"),
        ("buffer.goal_velocity=1", "buffer.goal_velocity=1 is not a valid choice; choose from achieved, zero"),
        (
            "buffer.goal_selection_strategy=null",
            "buffer.n_sampled_goal has no effect without virtual goals; leave it out, or use buffer=her_future",
        ),
        ("buffer.goal_selection_strategy=futur", "buffer.goal_selection_strategy=futur is not a valid choice; did you mean 'future'?"),
        ("+algorithm.seed=3", "algorithm.seed is set by the run itself; use seed"),
        ("+algorithm.buffer_size=3", "algorithm.buffer_size is set by the run itself; use buffer.buffer_size"),
        (
            "algorithm._target_=stable_baselines3.SACC",
            "algorithm._target_=stable_baselines3.SACC: there is no 'SACC' in stable_baselines3; did you mean 'SAC'?",
        ),
        ("algorithm._target_=nowhere.SAC", "algorithm._target_=nowhere.SAC: the package 'nowhere' is not installed"),
        ("evaluation=often", "evaluation=often: there is no such option; choose from default"),
        ("algorithm.gamma=null", "algorithm.gamma=None has the wrong type; parking_exp.algorithms.TD3 takes float"),
        ("algorithm.batch_size=[9]", "algorithm.batch_size=[9] has the wrong type; parking_exp.algorithms.TD3 takes int"),
        ("algorithm=sac algorithm.ent_coef=atuo", "algorithm.ent_coef=atuo is not a valid choice; choose from auto and a number"),
        (
            "~algorithm.learning_starts",
            "algorithm.learning_starts is missing; give at least 25856, the longest training episode (101 steps) x n_envs (256)",
        ),
        (
            "~buffer.n_sampled_goal algorithm.learning_starts=10",
            "algorithm.learning_starts=10 is shorter than the longest training episode (101 steps) x n_envs (256), "
            "and HER samples finished episodes only; the closest valid choice is 25856",
        ),
        (
            "total_timesteps=26000",
            "total_timesteps=26000 is not above algorithm.learning_starts=26000, the env steps before the first update; "
            "the closest valid choice is 26001",
        ),
        (
            "buffer=replay total_timesteps=10",
            "total_timesteps=10 is not above algorithm.learning_starts=26000, the env steps before the first update; "
            "the closest valid choice is 26001",
        ),
        (
            "algorithm=td3 algorithm.action_noise.sigma=[0.1]",
            "algorithm.action_noise.sigma has 1 entries and the action 2; give one entry for each action",
        ),
        (
            "env.observation.features=[x,y,cos_h,sin_h] env.observation.scales=[1,1,1,1] algorithm.features=raw",
            "env.observation: HER computes rewards of goals in highway-env's own features and scales, "
            "['x', 'y', 'vx', 'vy', 'cos_h', 'sin_h'] and [100, 100, 5, 5, 1, 1]; use these, or buffer=replay",
        ),
        (
            "env.other_vehicles_type=nowhere.Car",
            "env.other_vehicles_type=nowhere.Car: the package 'nowhere' is not installed",
        ),
        (
            "env.action.speed_range=[5,-5]",
            "env.action.speed_range=[5.0, -5.0] is empty; the closest valid choice is [-5.0, 5.0]",
        ),
        ("updates_per_step=0.0004", "updates_per_step=0.0004 is out of range; the closest valid choice is 0.001"),
        (
            "algorithm.train_freq=[1,episode]",
            "algorithm.train_freq counts episodes, which works with one env only; set n_envs=1",
        ),
        ("checkpoint.keep_last=0", "checkpoint.keep_last=0 is out of range; the closest valid choice is 1"),
        ("env.controlled_vehicles=2", "env.controlled_vehicles=2 is not a valid choice; it can only be 1"),
        (
            "env.policy_frequency=20 n_envs=1",
            "env.policy_frequency=20 is above env.simulation_frequency=15; the closest valid choice is 15",
        ),
        (
            "algorithm.learning_starts=100",
            "algorithm.learning_starts=100 is shorter than the longest training episode (101 steps) x n_envs (256), "
            "and HER samples finished episodes only; the closest valid choice is 25856",
        ),
        (
            "buffer.buffer_size=800",
            "buffer.buffer_size=800 cannot hold one whole episode of each env, the longest training episode "
            "(101 steps) x n_envs (256); the closest valid choice is 26112",
        ),
        (
            "evaluation.first_scene=2147483600",
            "evaluation.first_scene=2147483600 reaches into the training scenes; the closest valid choice is 2147483148",
        ),
        (
            "env.observation.features=[y,x,vx,vy,cos_h,sin_h] buffer=replay",
            "algorithm.features=ego_mirrored reads the observation features x, y, vx, vy, cos_h, sin_h in this order; "
            "the closest valid choice is algorithm.features=raw",
        ),
        # Nested arguments.
        (schedule("start", "-7"), "algorithm.learning_rate.start=-7 is out of range; it must be greater than 0.0"),
        (schedule("end", "-1"), "algorithm.learning_rate.end=-1 is out of range; the closest valid choice is 0.0"),
        (schedule("end_fraction", "-1"), "algorithm.learning_rate.end_fraction=-1 is out of range; it must be greater than 0.0"),
        (schedule("end_fraction", "2"), "algorithm.learning_rate.end_fraction=2 is out of range; the closest valid choice is 1.0"),
        (
            "algorithm=td3 algorithm.action_noise.sigma=[-0.1,0.1]",
            "algorithm.action_noise.sigma.0=-0.1 is out of range; the closest valid choice is 0.0",
        ),
        (schedule("start", "nan"), "algorithm.learning_rate.start=nan: input should be a finite number"),
        (schedule("_target_", "3"), "algorithm.learning_rate._target_=3 is not a dotted path, PACKAGE.MODULE.CLASS"),
        (
            "+algorithm.policy_kwargs.n_critic=3",
            "algorithm.policy_kwargs.n_critic: MultiInputPolicy has no such argument; did you mean 'n_critics'?",
        ),
        ("+algorithm.policy_kwargs.n_critics=0", "algorithm.policy_kwargs.n_critics=0 is out of range; the closest valid choice is 1"),
        ("+algorithm.policy_kwargs.use_sde=true", "algorithm.policy_kwargs.use_sde is set by the run itself; use algorithm.use_sde"),
        (
            "+algorithm.policy_kwargs.optimizer_kwargs={weight_decy:0.1}",
            "algorithm.policy_kwargs.optimizer_kwargs.weight_decy: torch.optim.Adam has no such argument; did you mean 'weight_decay'?",
        ),
        (
            "+algorithm.policy_kwargs.optimizer_kwargs={lr:0.1}",
            "algorithm.policy_kwargs.optimizer_kwargs.lr is set by the run itself; use algorithm.learning_rate",
        ),
        (
            "+algorithm.policy_kwargs.features_extractor_class=parking_exp.algorithms.features.EgoFrameExtractor",
            "algorithm.policy_kwargs.features_extractor_class takes the place of algorithm.features=ego_mirrored; set algorithm.features=raw",
        ),
        (
            "+algorithm.policy_kwargs.activation_fn=torch.nn.Tan",
            "algorithm.policy_kwargs.activation_fn=torch.nn.Tan: there is no 'Tan' in torch.nn; did you mean 'Tanh'?",
        ),
        ("+algorithm.policy_kwargs.activation_fn=tanh", "algorithm.policy_kwargs.activation_fn=tanh: is not a dotted path, PACKAGE.MODULE.CLASS"),
        ("+algorithm.policy_kwargs.activation_fn=torch.optim.Adam", "algorithm.policy_kwargs.activation_fn=torch.optim.Adam is no Module"),
        (
            "+algorithm.policy_kwargs.activation_fn={_target_:hydra.utils.get_class,path:torch.nn.Tan}",
            "algorithm.policy_kwargs.activation_fn=torch.nn.Tan: there is no 'Tan' in torch.nn; did you mean 'Tanh'?",
        ),
        (
            "+algorithm.policy_kwargs.activation_fn={_target_:torch.nn.LeakyReLU,negative_slop:0.2}",
            "algorithm.policy_kwargs.activation_fn.negative_slop: torch.nn.LeakyReLU has no such argument; did you mean 'negative_slope'?",
        ),
        ("algorithm.policy_kwargs=[1]", "algorithm.policy_kwargs=[1]: a value of another kind stands there; see it with --cfg job"),
        ("env.duration=1e9", "env.duration=1000000000.0 is out of range; the closest valid choice is 100000.0"),
        ("env.policy_frequency=100000000", "env.policy_frequency=100000000 is out of range; the closest valid choice is 100"),
        ("env.success_goal_reward=1e300", "env.success_goal_reward is out of range; numbers lie between -1e+15 and 1e+15"),
        ("algorithm.net_arch=[64,1e300]", "algorithm.net_arch.1 is out of range; numbers lie between -1e+15 and 1e+15"),
        (f"n_envs={'9' * 5000}", "n_envs: a number has too many digits; numbers lie between -1e+15 and 1e+15"),
        (f"seeds={'9' * 5000}", "seeds: a number has too many digits; numbers lie between -1e+15 and 1e+15"),
        ("device=mps", "device='mps' is not a valid choice; choose from cpu, auto, cuda, cuda:N"),
        ("torch_threads=1000000", "torch_threads=1000000 is out of range; the closest valid choice is 1024"),
        (
            "experiment=article algorithm.learning_rate=[]",
            "algorithm.learning_rate=[] has the wrong type; parking_exp.algorithms.SAC takes float | Schedule",
        ),
        (
            "experiment=article algorithm.learning_rate={}",
            "algorithm.learning_rate={} has the wrong type; parking_exp.algorithms.SAC takes float | Schedule",
        ),
        (
            "experiment=article algorithm.learning_rate={start:-1}",
            "algorithm.learning_rate={'start': -1} has the wrong type; parking_exp.algorithms.SAC takes float | Schedule",
        ),
        (
            "algorithm=sac algorithm.action_noise={}",
            "algorithm.action_noise={} has the wrong type; parking_exp.algorithms.SAC takes ActionNoise | None",
        ),
        (
            "algorithm.train_freq=[0,step]",
            "algorithm.train_freq=[0, 'step'] is neither a number nor [NUMBER, step] nor [NUMBER, episode], with a NUMBER of 1 or more",
        ),
        ("buffer.relabel_collision=null", "buffer.relabel_collision=None is not a valid choice; choose from exclude, keep, sb3"),
        (
            "buffer.goal_selection_strategy=[future]",
            "buffer.goal_selection_strategy=['future'] is not a valid choice; did you mean 'future'?",
        ),
        (
            "algorithm=sac algorithm._target_=sb3_contrib.TQC",
            "algorithm.features=ego_mirrored: the policy of sb3_contrib.TQC does not mirror its steering; set algorithm.features=ego_fine",
        ),
        ("env.success_goal_reward=0.08", "env.training_success_goal_reward=0.1 is above env.success_goal_reward=0.08, so that agents would learn to stop short of it; the closest valid choice is 0.08"),
        ("env.training_duration=1e12", "env.training_duration=1000000000000.0 is out of range; the closest valid choice is 100000.0"),
        (
            "+algorithm.policy_kwargs.net_arch=[5]",
            "algorithm.policy_kwargs.net_arch takes the place of algorithm.net_arch; use algorithm.net_arch",
        ),
        ("+algorithm.policy_kwargs.n_critics=100000", "algorithm.policy_kwargs.n_critics=100000 is out of range; the closest valid choice is 100"),
        (
            "algorithm=tqc +algorithm.policy_kwargs.n_quantiles=100000",
            "algorithm.policy_kwargs.n_quantiles=100000 is out of range; the closest valid choice is 10000",
        ),
        (
            "+algorithm.policy_kwargs.optimizer_kwargs={betas:[0.9,1]}",
            "algorithm.policy_kwargs.optimizer_kwargs.betas.1=1 is out of range; it must be less than 1.0",
        ),
        (
            "+algorithm.policy_kwargs.optimizer_kwargs={betas:[-0.1,0.9]}",
            "algorithm.policy_kwargs.optimizer_kwargs.betas.0=-0.1 is out of range; the closest valid choice is 0.0",
        ),
        (
            "+algorithm.policy_kwargs.optimizer_kwargs={betas:0.9}",
            "algorithm.policy_kwargs.optimizer_kwargs.betas=0.9: input should be a valid list",
        ),
        (
            "+algorithm.policy_kwargs.optimizer_kwargs={betas:[0.9]}",
            "algorithm.policy_kwargs.optimizer_kwargs.betas=[0.9]: list should have at least 2 items after validation, not 1",
        ),
        ("evaluation.final_n_scenes=10000000000", "evaluation.final_n_scenes=10000000000 is out of range; the closest valid choice is 2147483648"),
        ("evaluation.n_scenes=10000000000", "evaluation.n_scenes=10000000000 is out of range; the closest valid choice is 2147483648"),
        # Odd targets.
        ("algorithm._target_=json.JSONEncoder", "algorithm._target_=json.JSONEncoder is no off-policy algorithm of Stable-Baselines3"),
        ("algorithm._target_=stable_baselines3.PPO", "algorithm._target_=stable_baselines3.PPO is no off-policy algorithm of Stable-Baselines3"),
        ("algorithm._target_=json.dumps", "algorithm._target_=json.dumps: is not a class"),
        ("buffer._target_=stable_baselines3.SAC", "buffer._target_=stable_baselines3.SAC is no replay buffer of Stable-Baselines3"),
        (
            "algorithm._target_=__main__.X",
            "algorithm._target_=__main__.X: __main__ is a script, not a module; put the class into a module of its own",
        ),
        (
            "algorithm._target_=builtins.dict",
            "algorithm._target_=builtins.dict: builtins has no Python source to read its signature from",
        ),
        (
            "algorithm._target_=stable_baselines3.sacc.SAC",
            "algorithm._target_=stable_baselines3.sacc.SAC: there is no module 'sacc' in stable_baselines3; "
            "choose from a2c, common, ddpg, dqn, her, ppo, sac, td3",
        ),
        # What Hydra has no sentence for.
        ("=3", "=3: there is no key before the equals sign; write KEY=VALUE"),
        ("budget=null", "budget=null: leave it out, or choose from full, small, tiny"),
        ("buffer=[replay,x]", "buffer=x: there is no such option; choose from her_episode, her_final, her_future, her_random, replay"),
        ("algorithm=3", "algorithm=3: there is no such option; did you mean 'td3'?"),
        ("env@foo=parking", "env@foo=parking: options have their place; write env=OPTION"),
        ("seed=???", "seed is missing"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_is_refused_with_the_closest_valid_choice(override, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_config(*override.split())


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
    "override",
    [
        "algorithm.learning_rate=inf", "algorithm.gamma=nan", "algorithm.target_policy_noise=nan",
        "+algorithm.policy_kwargs.log_std_init=nan", "+algorithm.policy_kwargs.optimizer_kwargs.eps=inf", "env.collision_reward=nan",
        "env.scaling=inf", "updates_per_step=nan", "timeout_s=inf",
    ],
)  # fmt: skip
def test_a_number_is_finite_wherever_it_stands(override):
    key, _, value = override.lstrip("+").partition("=")
    with pytest.raises(ConfigError, match=f"^{re.escape(key)}={value}: input should be a finite number$"):
        make_config(override)


def test_numbers_in_lists_are_finite_too():
    with pytest.raises(ConfigError, match=r"^env.reward_weights.0=inf: input should be a finite number$"):
        make_config("env.reward_weights=[inf,1,1,1,1,1]")
    with pytest.raises(ConfigError, match=r"^algorithm.action_noise.mean.1=nan: input should be a finite number$"):
        make_config("algorithm=td3", "algorithm.action_noise.mean=[0,nan]")


@pytest.mark.parametrize(
    ("override", "sizes"),
    [
        ("buffer.buffer_size=99999999999", r"11,300.0 GB of memory or more \(99999999999 x 113 bytes\)"),
        ("algorithm.batch_size=99999999999", r"11,300.0 GB of memory or more \(99999999999 x 113 bytes\)"),
        ("algorithm.net_arch=[9999999,9999999]", r"400,000.0 GB of memory or more \(\d+ x 4 bytes\)"),
        ("evaluation.final_n_scenes=2000000000", r"2,000.0 GB of memory or more \(2000000000 x 1000 bytes\)"),
    ],
)
def test_what_never_fits_into_memory_is_refused_with_what_it_takes_and_what_there_is(override, sizes):
    key, there = override.partition("=")[0], f"{total_memory() / 1e9:,.1f} GB"
    with pytest.raises(
        ConfigError, match=rf"^{key} takes {sizes}, and this machine has {there}; choose a smaller one$"
    ):
        make_config(override)


@pytest.mark.parametrize(
    "override",
    [
        "seed=[1",
        "run name=3",
        "seed",
        "experiment_name=a b(",
        "experiment_name='a",
        "algorithm=sac,",
        "algorithm.gamma=choice()",
    ],
)
def test_what_hydras_grammar_cannot_read_is_said_without_its_words(override):
    message = f"{override}: can't be read; write KEY=VALUE, where a list is [1,2], and text with spaces, quotes or brackets stands in quotes: \"KEY='a (b)'\""
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_config(override)


@pytest.mark.parametrize("algorithm", options("algorithm"))
def test_policy_kwargs_are_those_of_the_algorithms_own_policy(algorithm):
    make_config(f"algorithm={algorithm}", "+algorithm.policy_kwargs={n_critics:3,net_arch:{pi:[8],qf:[9]}}")
    message = "algorithm.policy_kwargs.n_critic: MultiInputPolicy has no such argument; did you mean 'n_critics'?"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_config(f"algorithm={algorithm}", "+algorithm.policy_kwargs.n_critic=3")


def test_an_evaluation_has_no_more_episodes_than_there_are_scenes():
    (config,) = composed("evaluate", ["episodes=10000000000"])
    message = "episodes=10000000000 is out of range; the closest valid choice is 2147483648"
    with pytest.raises(ConfigError, match=f"^{message}$"):
        validate_request(config)


def test_the_suggested_choices_are_valid():
    assert make_config("algorithm.learning_starts=25856").algorithm.arguments["learning_starts"] == 25856
    assert make_config("buffer.buffer_size=26112").buffer.buffer_size == 26112
    assert make_config("total_timesteps=26001").total_timesteps == 26001


def test_plain_replay_may_start_learning_within_an_episode():
    config = make_config("buffer=replay", "algorithm.learning_starts=10")
    assert config.algorithm.arguments["learning_starts"] == 10


def test_nested_targets_are_checked_too():
    with pytest.raises(ConfigError, match=r"NormalActionNoise has no such argument; did you mean 'sigma'"):
        make_config("algorithm=td3", "+algorithm.action_noise.sigm=1")
    noise = "{_target_: stable_baselines3.common.noise.NormalActionNoise, mean: [0, 0]}"
    with pytest.raises(ConfigError, match=r"algorithm.action_noise.sigma is missing"):
        make_config("algorithm=sac", f"algorithm.action_noise={noise}")


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
    article, smoke = composed("config", ["experiment=article,smoke"])
    assert (article.checkpoint.every_n_steps, smoke.checkpoint.every_n_steps) == (1000, 100)


@pytest.fixture
def nothing_kept():
    """As in a new process."""
    for kept in (composing._kept_files, composing._set_up):
        kept.cache_clear()
    yield
    for kept in (composing._kept_files, composing._set_up):
        kept.cache_clear()


@pytest.mark.usefixtures("nothing_kept")
def test_options_are_composed_once_in_a_process_and_keys_are_set_without_hydra(monkeypatch):
    lines = []
    compose = hydra.compose
    monkeypatch.setattr(hydra, "compose", lambda name, line, **more: lines.append(line) or compose(name, line, **more))
    composed("config", ["algorithm=td3", "seed=1"])
    assert lines == [[], ["algorithm=td3"]]
    (other,) = composed("config", ["algorithm=td3", "seed=2"])
    assert (other.algorithm.name, other.seed) == ("td3", 2)
    assert lines == [[], ["algorithm=td3"]]


@pytest.mark.parametrize(
    "lines",
    [
        ["experiment=smoke", "seed=1", "output_dir='/a b'"],
        ["algorithm=td3", "+algorithm.policy_kwargs.n_critics=3", "~buffer.n_sampled_goal", "++algorithm.new=[1,2]"],
        ["env=parking_sparse", "env={duration: 7}", "algorithm.learning_rate={_target_: a.b, c: 1}"],
        ["buffer=replay", "algorithm.gamma=0.9,0.95", "seeds=2"],
        ["algorithm.gamma=1", "algorithm.gamma=0.5", "experiment_name=${algorithm.name}"],
        ["seed.x=1"],
        ["+seed=1"],
        ["~seed=7"],
        ["env@x=parking"],
    ],
)
def test_keys_that_are_set_without_hydra_are_set_as_hydra_sets_them(lines, monkeypatch):
    def found():
        try:
            return [OmegaConf.to_yaml(config) for config in composed("config", lines)]
        except ConfigError as error:
            return str(error)

    ours = found()
    monkeypatch.setattr(composing, "_is_value", lambda *_: False)
    assert found() == ours


@pytest.mark.usefixtures("nothing_kept")
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
    assert make_config("experiment=article").total_timesteps == 10_000
    assert make_config("experiment=article", "total_timesteps=1234").total_timesteps == 1234


def test_article_is_the_tutorials_recipe():
    config = make_config("experiment=article")
    found = {}
    for key in ARTICLE:
        section, _, name = key.rpartition(".")
        node = getattr(config, section) if section else config
        found[key] = getattr(node, name) if name in type(node).model_fields else node.arguments[name]
    assert found == ARTICLE


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
