"""Mirrored policies: the mirror image of a scene gets the mirror image of the action, and the same
values.
"""

import numpy as np
import pytest
import torch
from support.models import make_model

from parking_exp.errors import ConfigError

# A mirror at the y axis: of x, y, vx, vy, cos_h, sin_h.
MIRROR = np.array([-1, 1, -1, 1, -1, 1])
ONE = ("n_envs=1",)


def scenes(n=200):
    """Cars anywhere in the lot, and slots of both rows."""
    rng = np.random.default_rng(0)
    heading, speed = rng.uniform(0, 2 * np.pi, n), rng.uniform(-2, 2, n)
    cos, sin = np.cos(heading), np.sin(heading)
    car = np.stack(
        [
            rng.uniform(-0.3, 0.3, n),
            rng.uniform(-0.15, 0.15, n),
            speed * cos,
            speed * sin,
            cos,
            sin,
        ],
        1,
    )
    row = rng.choice([-1, 1], n)
    zero = np.zeros(n)
    goal = np.stack([rng.uniform(-0.3, 0.3, n), 0.14 * row, zero, zero, zero, row], 1)
    return car, goal


def tensors(car, goal):
    entries = {"observation": car, "achieved_goal": car, "desired_goal": goal}
    return {key: torch.tensor(value, dtype=torch.float32) for key, value in entries.items()}


@pytest.mark.parametrize("algorithm", ["sac", "td3", "ddpg"])
def test_the_mirror_image_of_a_scene_gets_the_mirror_image_of_the_action(algorithm):
    model = make_model(f"algorithm={algorithm}", *ONE)
    car, goal = scenes()
    scene, mirrored = tensors(car, goal), tensors(car * MIRROR, goal * MIRROR)
    with torch.no_grad():
        action, other = model.actor(scene), model.actor(mirrored)
        if algorithm == "sac":
            action, other = (
                model.actor(scene, deterministic=True),
                model.actor(mirrored, deterministic=True),
            )
        torch.testing.assert_close(other, action * torch.tensor([1.0, -1.0]))
        assert action.std(0).min() > 0.01
        given = torch.rand(len(car), 2) * 2 - 1
        values = (
            model.critic(scene, given),
            model.critic(mirrored, given * torch.tensor([1.0, -1.0])),
        )
        for value, mirrored_value in zip(*values, strict=True):
            torch.testing.assert_close(value, mirrored_value)
        assert torch.equal(model.critic.q1_forward(scene, given), values[0][0])
        assert not torch.allclose(
            model.critic.q1_forward(scene, given * torch.tensor([1.0, -1.0])), values[0][0]
        )


def test_sampled_actions_are_mirrored_and_their_probabilities_are_not():
    model = make_model("algorithm=sac", *ONE)
    car, goal = scenes()
    sampled = []
    for entries in (tensors(car, goal), tensors(car * MIRROR, goal * MIRROR)):
        torch.manual_seed(0)
        with torch.no_grad():
            sampled.append(model.actor.action_log_prob(entries))
    (action, log_prob), (other, same) = sampled
    torch.testing.assert_close(other, action * torch.tensor([1.0, -1.0]))
    torch.testing.assert_close(same, log_prob)


def test_the_scene_is_mirrored_where_the_goal_is_to_the_right_of_the_car():
    extractor = make_model("algorithm=td3", *ONE).actor.features_extractor
    goal = np.array([[0.1, 0.14, 0, 0, 0, 1], [0.1, -0.14, 0, 0, 0, -1], [0.1, 0.14, 0, 0, 0, 1]])
    car = np.array(
        [[0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]
    )  # two look along +x, one along +y
    assert extractor.sign(tensors(car, goal)).tolist() == [[1], [-1], [-1]]
    features = extractor(tensors(car, goal))
    assert features[:, 1].tolist() == pytest.approx([1.4, 1.4, 1.0])  # to the left
    mirrored = extractor.mirror(torch.full((3, 2), 0.5), tensors(car, goal))
    assert mirrored.tolist() == [[0.5, 0.5], [0.5, -0.5], [0.5, -0.5]]


def test_a_policy_that_mirrors_no_steering_is_refused():
    message = "^algorithm.features=ego_mirrored: .*ego_fine$"
    with pytest.raises(ConfigError, match=message):
        make_model("algorithm=tqc", "algorithm.features=ego_mirrored", *ONE)
