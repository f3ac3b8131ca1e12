"""The mirror image of a scene gets the mirror image of the action, and the same values."""

import numpy as np
import pytest
import torch
from support.models import make_model

from parking_exp.errors import ConfigError

# A mirror at the y axis: of x, y, vx, vy, cos_h, sin_h; and of acceleration and steering.
MIRROR = np.array([-1, 1, -1, 1, -1, 1])
STEERING = torch.tensor([1.0, -1.0])
# The same of presence, x, y, cos_h, sin_h of a vehicle, and the order of four rays.
MIRROR_OF_VEHICLE = np.array([1, -1, 1, -1, 1])
RAYS = [0, 3, 2, 1]
ONE = ("n_envs=1",)
SEEN = ("env.observation.vehicles_count=1", "env.observation.rays=4")


def tensors(car, goal, *seen):
    observation = np.concatenate([car, *seen], axis=1)
    entries = {"observation": observation, "achieved_goal": car, "desired_goal": goal}
    return {key: torch.tensor(value, dtype=torch.float32) for key, value in entries.items()}


def scenes(n=200):
    """Cars, slots, vehicles and rays anywhere, and their mirror images."""
    rng = np.random.default_rng(0)
    car, goal = rng.uniform(-0.3, 0.3, (2, n, 6))
    heading = rng.uniform(0, 2 * np.pi, (2, n))
    car[:, 4:], goal[:, 4:] = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    goal[:, 2:4] = 0
    vehicle = rng.uniform(-0.3, 0.3, (n, 5))
    rays = rng.uniform(0, 1, (n, 4))
    mirrored = [car * MIRROR, goal * MIRROR, vehicle * MIRROR_OF_VEHICLE, rays[:, RAYS]]
    return tensors(car, goal, vehicle, rays), tensors(*mirrored)


@pytest.mark.parametrize("algorithm", ["sac", "td3", "ddpg"])
def test_the_mirror_image_of_a_scene_gets_the_mirror_image_of_the_action(algorithm):
    model = make_model(f"algorithm={algorithm}", *ONE, *SEEN)
    scene, mirrored = scenes()
    with torch.no_grad():
        action = model.policy(scene, deterministic=True)
        assert action.std(0).min() > 0.01
        mirrored_action = model.policy(mirrored, deterministic=True)
        torch.testing.assert_close(mirrored_action, action * STEERING)
        given = torch.rand(len(action), 2) * 2 - 1
        values = model.critic(scene, given)
        torch.testing.assert_close(model.critic(mirrored, given * STEERING), values)
        assert torch.equal(model.critic.q1_forward(scene, given), values[0])
        assert not torch.allclose(model.critic.q1_forward(scene, given * STEERING), values[0])


def test_sampled_actions_are_mirrored_and_their_probabilities_are_not():
    model = make_model("algorithm=sac", *ONE, *SEEN)
    sampled = []
    for entries in scenes():
        torch.manual_seed(0)
        with torch.no_grad():
            sampled.append(model.actor.action_log_prob(entries))
    (action, log_prob), (other, same) = sampled
    torch.testing.assert_close(other, action * STEERING)
    torch.testing.assert_close(same, log_prob)


def test_the_scene_is_mirrored_where_the_goal_is_to_the_right_of_the_car():
    extractor = make_model("algorithm=td3", *ONE).actor.features_extractor
    goal = [[0.1, 0.14, 0, 0, 0, 1], [0.1, -0.14, 0, 0, 0, -1], [0.1, 0.14, 0, 0, 0, 1]]
    # Two look along +x, one along +y.
    car = [[0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]
    scene = tensors(car, goal)
    assert extractor.sign(scene).tolist() == [[1], [-1], [-1]]
    assert extractor(scene)[:, 1].tolist() == pytest.approx([1.4, 1.4, 1.0])  # to the left
    mirrored = extractor.mirror(torch.full((3, 2), 0.5), scene)
    assert mirrored.tolist() == [[0.5, 0.5], [0.5, -0.5], [0.5, -0.5]]


def test_a_policy_that_mirrors_no_steering_is_refused():
    message = "^algorithm.features=ego_mirrored: .*ego_fine$"
    with pytest.raises(ConfigError, match=message):
        make_model("algorithm=tqc", "algorithm.features=ego_mirrored", *ONE)
