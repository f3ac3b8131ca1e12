"""Trained agents are found by name, and pretrained ones park."""

import re
import shutil

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load, save
from support import models

from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.algorithms.policy_files import export_safetensors, load_policy
from parking_exp.config.compose import compose
from parking_exp.errors import ModelError, RunNotFoundError, UntrustedError
from parking_exp.evaluation import agents
from parking_exp.evaluation.agents import PRETRAINED_DIR, find_agent, load_model
from parking_exp.evaluation.evaluate_policy import evaluate_policy, summarise
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.parking.parking_metrics import METRICS
from parking_exp.tasks.registry import make_task

DECIDED_BY_ROUNDING = ("pretrained/lots", 14)  # see its card
TINY = (
    "algorithm.net_arch=[8]",
    "n_envs=1",
    "algorithm.learning_starts=1000",
    "updates_per_step=1",
)


def make_model(*overrides, seed=0):
    return models.make_model(*TINY, *overrides, seed=seed, for_training=False)


@pytest.mark.parametrize(
    "link", ["pretrained", "pretrained/default", "pretrained/default/evaluations"]
)
def test_results_of_a_pretrained_agent_follow_no_link_out_of_the_output_directory(tmp_path, link):
    path = tmp_path / "outputs" / link
    path.parent.mkdir(parents=True)
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(
        UntrustedError,
        match=rf"^{path} is a symbolic link that leads out of {tmp_path / 'outputs'}",
    ):
        find_agent("pretrained", tmp_path / "outputs")


@pytest.mark.parametrize(
    ("name", "env", "metric", "rate"),
    [
        ("pretrained", "parking", "success_rate", 1.0),
        ("pretrained/parked", "parking_stop", "parked_rate", 1.0),
        (
            "pretrained/crowded",
            "parking_stop_crowded",
            "parked_rate",
            0.98,
        ),  # of 500 scenes 99.8 %, see its card
        ("pretrained/parallel", "parking_parallel", "parked_rate", 1.0),
        ("pretrained/lots", "parking_lots", "parked_rate", 1.0),
    ],
)
def test_pretrained_agents_park(name, env, metric, rate, tmp_path):
    agent = find_agent(name, tmp_path)
    assert agent.directory is None
    assert agent.config.seed == 0
    assert agent.config.env.name == env
    task = make_task(agent.config.env)
    seeds = [seed for seed in range(50) if (name, seed) != DECIDED_BY_ROUNDING]
    episodes = evaluate_policy(GreedyPolicy(agent.load(task)), task, seeds)
    assert summarise(episodes, METRICS)[metric] == rate


def test_a_loaded_model_refuses_to_learn_in_a_sentence(tmp_path):
    model = load_model("pretrained", tmp_path)
    with pytest.raises(
        ModelError, match=r"^this model only predicts, since it has no replay buffer; .*$"
    ):
        model.learn(100)


def test_their_configs_are_those_of_the_recipes():
    crowded = (
        "env=parking_stop_crowded",
        "env.observation.vehicles_count=4",
        "env.vehicles_count=[0,20]",
        "seeds=1",
    )
    rates = ("algorithm.learning_rate.start=3e-3", "algorithm.learning_rate.end=3e-4")
    parallel = ("env=parking_parallel", "env.level=extreme", "algorithm=td3", "seeds=1", *rates)
    lots = (
        "total_timesteps=3840000",
        "env.collision_reward=-20",
        "env.lots.dead_end_again.starts.x_m=[-14.0,-10.0]",
        "~env.lots.dead_end_again.starts.y_m",
        "~env.lots.dead_end_again.starts.heading_deg",
        "algorithm.batch_size=512",
        "algorithm.gamma=0.98",
        "buffer.buffer_size=4000000",
    )
    recipes = {
        "default": (),
        "parked": ("experiment=parked",),
        "crowded": ("experiment=crowded", *crowded),
        "parallel": ("experiment=tight_lots", *parallel),
        "lots": ("experiment=all_lots", "seeds=1", *lots),
    }
    for name, overrides in recipes.items():
        config, recipe = (
            find_agent(f"pretrained/{name}", PRETRAINED_DIR).config,
            compose(*overrides),
        )
        for part in (
            "env",
            "algorithm",
            "buffer",
            "total_timesteps",
            "n_envs",
            "updates_per_step",
            "precision",
        ):
            expected = recipe.model_dump(include={part})
            assert config.model_dump(include={part}) == expected, part


def test_an_unknown_name_is_refused_with_the_known_ones(tmp_path):
    for name in ("pretrained/parkd", "pretrained/../default"):
        with pytest.raises(
            RunNotFoundError, match=rf"^run={re.escape(name)}.* default, lots, parallel, parked"
        ):
            find_agent(name, tmp_path)
    with pytest.raises(RunNotFoundError, match=r"^run=pretrained.* model=best"):
        find_agent("pretrained", tmp_path, "best")


@pytest.mark.parametrize("algorithm", ["sac", "td3", "tqc", "crossq"])
def test_a_saved_policy_is_restored_bit_for_bit_with_critics_and_targets(algorithm, tmp_path):
    model, other = (make_model(f"algorithm={algorithm}", seed=seed) for seed in (1, 2))
    path = tmp_path / "policy.safetensors"
    path.write_bytes(export_safetensors(model))
    load_policy(path, other)
    networks = model.policy.state_dict()
    for name, weight in other.policy.state_dict().items():
        source = name.replace("_target.", ".")
        assert torch.equal(weight, networks[source]), name


@pytest.mark.parametrize(
    ("saved", "loaded", "difference"),
    [
        (
            "algorithm.features=ego_fine",
            "algorithm.features=ego_mirrored",
            "MultiInputPolicy.* not .*MirroredTD3Policy",
        ),
        (
            "algorithm.features=ego_fine",
            "algorithm.features=ego",
            "FineEgoFrameExtractor.* not .*'EgoFrameExtractor",
        ),
        (
            "algorithm.net_arch=[9]",
            "algorithm.net_arch=[8]",
            r"its layer actor\.mu\.0\.weight has (\d+) inputs and 9 units, and the model's has \1 "
            "inputs and 8 units; observations, actions and networks have to be as large as in its "
            "training$",
        ),
    ],
)
def test_the_policy_of_another_model_is_refused(saved, loaded, difference, tmp_path):
    path = tmp_path / "policy.safetensors"
    path.write_bytes(export_safetensors(make_model("algorithm=td3", saved)))
    with pytest.raises(ModelError, match=rf"policy\.safetensors .*{difference}"):
        load_policy(path, make_model("algorithm=td3", loaded))


def test_a_policy_file_with_another_network_is_refused(tmp_path):
    model = make_model("algorithm=td3")
    content = export_safetensors(model)
    path = tmp_path / "policy.safetensors"
    path.write_bytes(content)
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    weights = load(content) | {"critic_target.0.weight": torch.zeros(1)}
    path.write_bytes(save(weights, metadata=metadata))
    with pytest.raises(ModelError, match=r"it has a network 'critic_target'$"):
        load_policy(path, model)


@pytest.mark.parametrize(
    "damage", [lambda content: content[:-9], lambda content: b"", lambda content: b"\xff" * 99]
)
def test_a_damaged_policy_is_refused(damage, tmp_path, monkeypatch):
    shutil.copytree(PRETRAINED_DIR / "default", tmp_path / "default")
    file = tmp_path / "default" / "policy.safetensors"
    file.write_bytes(damage(file.read_bytes()))
    monkeypatch.setattr(agents, "PRETRAINED_DIR", tmp_path)
    agent = find_agent("pretrained", tmp_path)
    with pytest.raises(ModelError, match=r"policy.safetensors is damaged"):
        agent.load(make_task(agent.config.env))


@pytest.mark.slow
def test_the_default_recipe_parks(tmp_path):
    rates = []
    for seed in (0, 1, 2):
        config = compose(f"seed={seed}", f"output_dir={tmp_path}", "evaluation.video_episodes=0")
        rates.append(train(config).metrics["final/success_rate"])
    assert min(rates) >= 0.95, rates
