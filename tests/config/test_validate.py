"""Tests of config validation: what is refused, and which key the message names."""

import contextlib
import copy
import inspect
import sys

import pytest
from omegaconf import OmegaConf

from parking_exp.config.argument_limits import CLASS_LIMITS, KNOWN_ARGUMENTS, LIMITS
from parking_exp.config.compose import compose, compose_configs
from parking_exp.config.constructor_arguments import SET_BY_RUN
from parking_exp.config.validate import validate, validate_all
from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError
from parking_exp.tasks.parking.parking_task import ParkingTask

DELETED = object()
DEFAULT_OPTIONS = {}
NOISE = {
    "_target_": "stable_baselines3.common.noise.NormalActionNoise",
    "mean": [0, 0],
    "sigma": [1, 1],
}
POLICY = "algorithm.policy_kwargs"


def changed(values, *options):
    """The plain config of some options, with the values of keys changed."""
    if options not in DEFAULT_OPTIONS:
        DEFAULT_OPTIONS[options] = compose(*options).plain()
    plain = copy.deepcopy(DEFAULT_OPTIONS[options])
    for key, value in values.items():
        *path, name = key.split(".")
        node = plain
        for part in path:
            node = node.setdefault(part, {})
        if value is DELETED:
            del node[name]
        else:
            node[name] = value
    return plain


def refusal(plain):
    """The first sentence with which a plain config is refused."""
    with pytest.raises(ConfigError) as refused:
        validate(plain)
    return str(refused.value).splitlines()[0]


@pytest.mark.parametrize(
    ("key", "value", "hint"),
    [
        ("env.duratoin", 3, "'duration'"),
        ("seed", DELETED, "missing"),
        ("device", "gpu", "cuda"),
        ("updates_per_step", float("nan"), "finite"),
        ("evaluation", "often", "dictionary"),
        ("evaluation.final_n_scenes", 10000000000, "10000000"),
        ("evaluation.first_scene", 2147483600, "2147483148"),
        ("evaluation.final_n_scenes", 1, "evaluation.n_scenes"),
        ("experiment_name", "a/b", ""),
        ("experiment_name", "Default", "reserved by MLflow"),
        ("tracking.uri", "ftp://host/store", "sqlite:///PATH"),
        ("env.other_vehicles_type", "nowhere.Car", "IDMVehicle"),
        ("env.action.speed_range", [5, -5], ""),
        ("env.action.dynamical", True, "False"),
        *(
            ("env.vehicles_count", value, "give a number of cars, or the lowest and the highest")
            for value in (-1, [3], [5, 2], True, "many")
        ),
        *(
            ("env.vehicles_count", value, "highway-env's own lot has room for 26")
            for value in (27, [0, 27])
        ),
        ("env.observation.scales", [1], "[100, 100, 5, 5, 1, 1]"),
        ("algorithm.gamma", 1.5, "1"),
        ("algorithm.learning_rate.start", -1, ""),
        ("algorithm.action_noise", {**NOISE, "sigma": [0.1, 0.1, 0.1]}, "2 dimensions"),
        ("algorithm.gama", 1, "'gamma'"),
        ("algorithm.net_arch", [9999999, 9999999], ""),
        ("algorithm.train_freq", [1, "episode"], "updates_per_step=0.03125"),
        ("algorithm.action_noise", {k: v for k, v in NOISE.items() if k != "sigma"}, "missing"),
        ("algorithm.buffer_size", 3, "set by the run"),
        ("algorithm.learning_starts", 100, "25856"),
        ("total_timesteps", 26000, "26001"),
        ("algorithm._target_", "stable_baselines3.PPO", "OffPolicyAlgorithm"),
        ("algorithm.ent_coef", "auto_0", "above 0"),
        ("algorithm.ent_coef", "auto_1e-999", "above 0"),
        ("algorithm.stats_window_size", 10**30, "1000000000000"),
        ("algorithm.action_noise", {**NOISE, "dtype": "os.system"}, "'float32' or 'float64'"),
        ("total_timesteps", 10**30, "1000000000000"),
        ("experiment_name", 0.1, "in quotes"),
        ("contrasts", [[0.1, "a"]], "in quotes"),
        ("buffer._target_", "stable_baselines3.SAC", "ReplayBuffer"),
        (
            "buffer._target_",
            "stable_baselines3.common.buffers.NStepReplayBuffer",
            "DictReplayBuffer",
        ),
        ("buffer._target_", "stable_baselines3.common.buffers.ReplayBuffer", "DictReplayBuffer"),
        ("buffer.buffer_size", 800, "26112"),
        ("buffer.goal_selection_strategy", ["future"], "future"),
        (f"{POLICY}.n_critic", 3, "'n_critics'"),
        (f"{POLICY}.n_critics", 0, "1"),
        (f"{POLICY}.use_sde", True, "set by the run"),
        (f"{POLICY}.net_arch", [5], "algorithm.net_arch"),
        (f"{POLICY}.optimizer_kwargs.weight_decy", 0.1, "'weight_decay'"),
        (
            f"{POLICY}.features_extractor_class",
            "parking_exp.tasks.parking.features.EgoFrameExtractor",
            "features=raw",
        ),
        (f"{POLICY}.activation_fn", "torch.nn.Tan", "no attribute 'Tan'"),
        (f"{POLICY}.activation_fn", "relu", "MODULE.NAME"),
        (f"{POLICY}.activation_fn", 3, "MODULE.NAME"),
        (f"{POLICY}.activation_fn", "torch.optim.Adam", "torch.nn.Module"),
        (
            f"{POLICY}.activation_fn",
            {"_target_": "torch.nn.LeakyReLU", "negative_slop": 0.2},
            "'negative_slope'",
        ),
    ],
)
def test_a_wrong_value_is_refused_in_a_sentence_that_names_its_key(key, value, hint):
    sentence = refusal(changed({key: value}))
    assert sentence.startswith(key)
    assert hint in sentence


@pytest.mark.parametrize(
    ("values", "key"),
    [
        (
            {"buffer.n_sampled_goal": DELETED, "algorithm.learning_starts": 10},
            "algorithm.learning_starts=10",
        ),
        ({"buffer.goal_selection_strategy": None}, "buffer.n_sampled_goal"),
        ({"env.success_goal_reward": 0.08}, "env.training_success_goal_reward"),
        (
            {f"{POLICY}.optimizer_class": "torch.optim.Adamm", f"{POLICY}.optimizer_kwargs.eps": 1},
            f"{POLICY}.optimizer_class",
        ),
    ],
)
def test_contradictory_keys_are_refused(values, key):
    assert refusal(changed(values)).startswith(key)


def test_features_that_a_policy_would_ignore_are_refused():
    sentence = refusal(changed({"algorithm._target_": "sb3_contrib.TQC"}, "algorithm=sac"))
    assert sentence.startswith("algorithm.features=")
    assert "ego_fine" in sentence


def test_a_features_extractor_of_ones_own_needs_inputs_that_are_not_normalised():
    extractor = "stable_baselines3.common.torch_layers.CombinedExtractor"
    values = {
        "algorithm.features": "raw",
        "algorithm.normalize": True,
        f"{POLICY}.features_extractor_class": extractor,
    }
    assert refusal(changed(values)) == (
        f"{POLICY}.features_extractor_class overrides algorithm.normalize; "
        "set algorithm.normalize=false"
    )
    validate(changed({**values, "algorithm.normalize": False}))


@pytest.mark.parametrize(
    "values",
    [
        {"tracking.uri": "http://localhost:5000"},
        {"tracking.uri": "postgresql+psycopg2://me@host/mlflow"},
        {"algorithm.learning_starts": 25856, "buffer.buffer_size": 26112, "total_timesteps": 25857},
        {
            f"{POLICY}.optimizer_class": "torch.optim.SGD",
            f"{POLICY}.optimizer_kwargs.weight_decay": 0.1,
        },
        {f"{POLICY}.activation_fn": {"_target_": "torch.nn.LeakyReLU", "negative_slope": 0.2}},
        {f"{POLICY}.n_critics": 3, f"{POLICY}.net_arch": {"pi": [8], "qf": [9]}},
    ],
)
def test_suggested_values_and_nested_arguments_are_accepted(values):
    assert validate(changed(values)).plain() == changed(values)


def keys(node, path=()):
    """Paths of all keys and list entries of a plain config."""
    for name, value in (
        node.items()
        if isinstance(node, dict)
        else enumerate(node)
        if isinstance(node, list)
        else ()
    ):
        yield (*path, name)
        yield from keys(value, (*path, name))


@pytest.mark.parametrize("value", [1e300, [], None], ids=range(3))
def test_any_value_of_any_key_is_accepted_or_refused_with_a_config_error(value):
    for path in keys(changed({})):
        plain = changed({})
        node = plain
        for name in path[:-1]:
            node = node[name]
        node[path[-1]] = value
        with contextlib.suppress(ConfigError):
            config = validate(plain)
            assert config.run_key
            assert config.update_round()[0]


def test_validation_does_not_change_the_config_and_can_be_repeated():
    (config,) = compose_configs("config", ["experiment=smoke"])
    before = OmegaConf.to_yaml(config)
    run = validate(config)
    assert OmegaConf.to_yaml(config) == before
    assert validate(run.plain()) == run


@pytest.fixture
def own_algorithm(tmp_path, monkeypatch):
    """The config of an algorithm of the user's own."""
    (tmp_path / "own_algorithm.py").write_text(
        "from stable_baselines3 import SAC\n"
        "class OwnAlgorithm(SAC):\n"
        "    def __init__(\n"
        "        self, policy, env, beta: float, layers: int = 1, tag: str | None = None, **rest\n"
        "    ):\n"
        "        super().__init__(policy, env, **rest)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield lambda **arguments: changed(
        {"algorithm.features": "raw", "algorithm._target_": "own_algorithm.OwnAlgorithm"}
        | {f"algorithm.{name}": value for name, value in arguments.items()},
        "algorithm=sac",
    )
    sys.modules.pop("own_algorithm", None)


def test_a_users_own_class_is_checked_against_its_signature(own_algorithm):
    assert validate(own_algorithm(beta=1)).algorithm.arguments["beta"] == 1
    assert validate(own_algorithm(beta=0.5, tag=None, layers=2)).algorithm.arguments["layers"] == 2
    assert refusal(own_algorithm()).startswith("algorithm.beta is missing")
    for values, key in (
        ({"beta": "fast"}, "beta"),
        ({"beta": True}, "beta"),
        ({"beta": 1, "layers": None}, "layers"),
        ({"beta": 1, "layers": 1.5}, "layers"),
        ({"beta": 1, "tag": 3}, "tag"),
        ({"beta": 1, "tau": 3}, "tau"),
        ({"beta": 1, "train_freq": "often"}, "train_freq"),
    ):
        assert refusal(own_algorithm(**values)).startswith(f"algorithm.{key}")


@pytest.mark.parametrize(("target", "known"), KNOWN_ARGUMENTS.items())
def test_arguments_that_are_known_without_importing_their_class_fit_its_signature(target, known):
    signature = inspect.signature(import_object(target))
    set_by_run = {*SET_BY_RUN["algorithm"], *SET_BY_RUN["buffer"]} & set(signature.parameters)
    for names in known:
        signature.bind(**dict.fromkeys(names | set_by_run))
        limits = CLASS_LIMITS.get(target.rpartition(".")[2], LIMITS)
        assert names - {"action_noise"} <= set(limits)


def test_our_own_keys_of_all_cells_are_checked_before_any_class_is_imported(tmp_path, monkeypatch):
    (tmp_path / "never_imported.py").write_text("raise SystemExit\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"^n_envs=0"):
        validate_all(
            compose_configs("config", ["algorithm._target_=never_imported.X", "n_envs=256,0"])
        )


def test_the_runs_of_an_env_share_a_task_that_is_closed_after_the_last(monkeypatch):
    events = []

    def record(name):
        method = getattr(ParkingTask, name)

        def recorded(task):
            events.append(name)
            return method(task)

        monkeypatch.setattr(ParkingTask, name, recorded)

    for name in ("problems", "_make_prediction_env", "close"):
        record(name)
    noise = ("algorithm.action_noise.mean=[0,0]", "algorithm.action_noise.sigma=[0.1,0.1]")
    overrides = ["algorithm=td3", "env=parking,parking_stop", "algorithm.gamma=0.9,0.95", *noise]
    validate_all(compose_configs("config", overrides))
    assert events == ["problems", "_make_prediction_env", "close"] * 2
