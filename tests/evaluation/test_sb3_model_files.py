"""Models of plain Stable-Baselines3, evaluated by their files."""

import base64
import json
import os
import pickle
import shutil
import zipfile
from pathlib import Path

import gymnasium as gym
import highway_env  # noqa: F401  (registers parking-v0)
import numpy as np
import pandas as pd
import pytest
import torch
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.save_util import load_from_zip_file
from support.model_zips import rewritten
from support.runs import call_script, refusal
from support.user_features import DoubledExtractor

from parking_exp.config.compose import compose_configs
from parking_exp.evaluation.evaluation_request import validate_evaluation
from parking_exp.evaluation.sb3_model_files import find_agent_in_file
from parking_exp.runs.foreign_files import read_json
from parking_exp.tasks.registry import make_task

SCENES = range(6)
EASY = 0.3  # success_goal_reward with which cars that hardly learned anything reach some goals
MODELS = {
    "sac": (SAC, {"policy_kwargs": {"net_arch": [16, 8], "activation_fn": torch.nn.Tanh}}),
    "td3": (TD3, {"policy_kwargs": {"net_arch": [16, 8]}}),
    "ddpg": (DDPG, {"policy_kwargs": {"net_arch": {"pi": [12], "qf": [16]}}}),
    "gsde": (SAC, {"use_sde": True}),
    "extractor": (SAC, {"policy_kwargs": {"features_extractor_class": DoubledExtractor}}),
}
EXTRACTOR = (
    "algorithm.policy_kwargs.features_extractor_class=support.user_features.DoubledExtractor"
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A model that was trained for a few hundred steps by Stable-Baselines3 alone, and its file."""
    env = gym.make("parking-v0")
    model = SAC(
        "MultiInputPolicy",
        env,
        seed=0,
        learning_starts=100,
        buffer_size=1000,
        policy_kwargs={"net_arch": [16, 8], "activation_fn": torch.nn.Tanh},
    )
    model.learn(300)
    path = tmp_path_factory.mktemp("elsewhere") / "model.zip"
    model.save(path)
    return model, path


def save(folder, name):
    """Make and save an untrained model: the model, and its file."""
    algorithm, arguments = MODELS[name]
    env = gym.make("parking-v0")
    model = algorithm("MultiInputPolicy", env, seed=1, buffer_size=10, **arguments)
    path = folder / f"{name}.zip"
    model.save(path)
    return model, path


def evaluate(path, output_dir, *arguments):
    return call_script("evaluate", f"run={path}", f"output_dir={output_dir}", *arguments, code=0)


def refused(path, output_dir, *arguments):
    return refusal("evaluate", f"run={path}", f"output_dir={output_dir}", *arguments)


def restored(path, output_dir, *arguments):
    """Return the model that evaluate.py loads."""
    words = [f"run='{path}'", f"output_dir='{output_dir}'", "env=parking", *arguments]
    request = validate_evaluation(compose_configs("evaluate", words)[0])
    agent = find_agent_in_file(
        request.run, request.output_path, request.env, request.algorithm or {}
    )
    return agent.load(make_task(agent.config.env))


class Executes:
    """Is pickled as a call that makes a directory."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.makedirs, (self.path, 0o777, True)


@pytest.mark.parametrize("name", MODELS)
def test_its_actions_are_those_of_predict(name, tmp_path):
    model, path = save(tmp_path, name)
    options = [f"++{EXTRACTOR}"] if name == "extractor" else []
    loaded = restored(path, tmp_path, *options)
    rng = np.random.default_rng(0)
    observation = {key: rng.normal(size=(50, 6)) for key in model.observation_space}
    expected, _ = model.predict(observation, deterministic=True)
    actions, _ = loaded.predict(observation, deterministic=True)
    np.testing.assert_array_equal(actions, expected)
    assert np.ptp(actions, axis=0).min() > 0.01  # they depend on the observation


def test_episodes_are_those_of_a_loop_in_gymnasium(trained, tmp_path):
    model, path = trained
    env = gym.make("parking-v0", config={"success_goal_reward": EASY})
    expected = []
    for scene in SCENES:
        observation, info = env.reset(seed=scene)
        steps = 0
        total = 0.0
        done = False
        while not done:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(action)
            steps += 1
            total += reward
            done = terminated or truncated
        expected.append((steps, total, info["is_success"]))
    arguments = ("env=parking", f"env.success_goal_reward={EASY}", f"episodes={len(SCENES)}")
    done = evaluate(path, tmp_path, *arguments, "algorithm=sac", "video=1")
    (folder,) = tmp_path.glob("models/model-*/evaluations/*")
    table = pd.read_csv(folder / "episodes.csv")
    steps, total, success = zip(*expected, strict=True)
    assert table["steps"].tolist() == list(steps)
    np.testing.assert_allclose(table["return"], total, rtol=1e-4)
    rate = np.mean(success)
    assert 0 < rate < 1
    assert read_json(folder / "summary.json")["success_rate"] == rate
    assert f"{path} on 6 episodes of parking, from seed 0, simulated by highway_env" in done.stdout
    assert (folder / "video.mp4").stat().st_size > 1000


def test_nothing_pickled_in_a_file_is_executed(trained, tmp_path):
    path = Path(shutil.copy(trained[1], tmp_path))
    trace = tmp_path / "executed"
    with zipfile.ZipFile(path) as archive:
        data = json.loads(archive.read("data"))
    pickled = base64.b64encode(pickle.dumps(Executes(trace))).decode()
    for key in ("policy_class", "observation_space", "policy_kwargs", "lr_schedule"):
        data[key][":serialized:"] = pickled
    path.write_bytes(rewritten(path.read_bytes(), data=json.dumps(data)))
    load_from_zip_file(path)  # as Stable-Baselines3 does
    assert trace.exists()
    trace.rmdir()
    arguments = ("env=parking", "episodes=1", "simulator=vectorized")
    evaluate(path, tmp_path, *arguments)
    assert not trace.exists()

    path.write_bytes(rewritten(path.read_bytes(), policy_pth=pickle.dumps(Executes(trace))))
    sentence = f"{path} is damaged (Weights only load failed"
    assert refused(path, tmp_path, *arguments).startswith(sentence)
    assert not trace.exists()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "name the env that the model is evaluated on, such as env=parking"),
        (("env=parking", "model=best"), "a file has no model=best; leave it out"),
        (
            ("env=parking", "algorithm=td3"),
            "its layer actor.mu.0.weight is missing, and the model's has 18 inputs and 16 units; "
            "name the env",
        ),
        (
            ("env=parking", "env.observation.vehicles_count=2"),
            "its layer actor.latent_pi.0.weight has 18 inputs and 16 units, and the model's has 28 "
            "inputs and 16 units;",
        ),
        (
            ("env=parking", "algorithm.policy_kwargs.activation=torch.nn.ReLU"),
            "there is no such key; did you mean 'activation_fn'?",
        ),
        (("env=parking", "total_timesteps=3"), "total_timesteps=3 is a training key"),
    ],
)
def test_what_does_not_fit_is_said_in_a_sentence(words, reason, trained, tmp_path):
    assert reason in refused(trained[1], tmp_path, *words)
    assert list(tmp_path.iterdir()) == []


def test_an_argument_that_is_pickled_has_to_be_passed(tmp_path):
    _, path = save(tmp_path, "extractor")
    assert refused(path, tmp_path, "env=parking") == (
        f"{path} was trained with policy_kwargs features_extractor_class=<class "
        "'support.user_features.DoubledExtractor'>, which is pickled there; pass "
        "algorithm.policy_kwargs.features_extractor_class=VALUE"
    )
    evaluate(path, tmp_path, "env=parking", EXTRACTOR, "episodes=1", "simulator=vectorized")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("data", b"{", "is damaged (Expecting property name"),
        ("data", b"[]", "is damaged (data is not a JSON object)"),
        ("data", b"[" * 100_000, "is damaged (maximum recursion depth exceeded"),
        ("policy_pth", b"", "is damaged ("),
        (None, b"no zip", "is damaged ("),
    ],
)
def test_damaged_files_are_named(name, content, reason, trained, tmp_path):
    path = Path(shutil.copy(trained[1], tmp_path))
    if name is None:
        path.write_bytes(content)
    else:
        path.write_bytes(rewritten(path.read_bytes(), **{name: content}))
    assert refused(path, tmp_path, "env=parking").startswith(f"{path} {reason}")
    path.unlink()
    assert refused(path, tmp_path, "env=parking") == f"run={path}: there is no such file"
    os.mkfifo(path)
    assert refused(path, tmp_path, "env=parking") == f"run={path}: there is no such file"


def test_a_quoted_name_is_a_model_file_as_well(tmp_path):
    problem = refused("'my model.zip'", tmp_path, "env=parking", "algorithm.gamma=0.5")
    assert problem == "run=my model.zip: there is no such file"


def test_a_run_has_its_algorithm(tmp_path):
    for run in ("latest", f"{tmp_path}/runs.zip/smoke"):
        assert "algorithm=sac is a training key" in refused(run, tmp_path, "algorithm=sac")
