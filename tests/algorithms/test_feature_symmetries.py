"""Features and policies of mirrored and of turned scenes, with goals of any heading, vehicles and
rays.
"""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from support.models import make_model

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.tasks.parking.features import (
    EgoFrameExtractor,
    FineEgoFrameExtractor,
    MirroredEgoFrameExtractor,
)
from parking_exp.tasks.parking.geometry import cars_at
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.nearby_vehicles import nearest_vehicles
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.parking.rays import ray_distances

WEIGHTS = [1, 0.3, 0.1, 0.1, 0.02, 0.02]
N = 200
VEHICLES = 4
SEEN = 3
RAYS = 7
SIZE = 6 + 5 * SEEN + RAYS

MIRRORS = {
    "x to -x": ([-1, 1, -1], [0, 0, np.pi]),
    "y to -y": ([1, -1, -1], [0, 0, 0]),
}
TURN = ([-1, -1, 1], [0, 0, np.pi])
STEERING = torch.tensor([1.0, -1.0])
ONE = ("n_envs=1",)
SEES = (f"env.observation.vehicles_count={SEEN}", f"env.observation.rays={RAYS}")


def poses():
    """x, y and heading of car, goal and vehicles, shape (N, 2 + VEHICLES, 3)."""
    rng = np.random.default_rng(0)
    return rng.uniform([-30, -15, -np.pi], [30, 15, np.pi], (N, 2 + VEHICLES, 3))


def scenes(change=([1, 1, 1], [0, 0, 0])):
    """Observations of the random poses after a change: a factor, then a summand of each entry."""
    factor, summand = change
    x, y, heading = np.moveaxis(poses() * factor + summand, -1, 0)
    direction = np.array([np.cos(heading), np.sin(heading)])
    speed = np.array([1.5, 0.5])  # of car and goal, which may move where HER relabels it
    velocity = speed * direction[..., :2] / 5
    states = np.array([x[:, :2] / 100, y[:, :2] / 100, *velocity, *direction[..., :2]])
    car, goal = states.transpose(2, 1, 0)
    others = np.stack([x, y], axis=-1)
    vehicles = nearest_vehicles(others[:, 0], others[:, 2:], heading[:, 2:], SEEN)
    rectangles = cars_at(others[:, 2:], heading[:, 2:])
    rays = ray_distances(others[:, 0].T, direction[..., 0], rectangles, RAYS, 30.0) / 30
    observation = np.concatenate([car, vehicles, rays], axis=1)
    assert observation.shape == (N, SIZE)
    return {"observation": torch.tensor(observation), "desired_goal": torch.tensor(goal)}


def extractor(kind, **lot):
    space = spaces.Dict({"observation": spaces.Box(-np.inf, np.inf, (SIZE,))})
    weights = [] if kind is EgoFrameExtractor else [WEIGHTS]
    return kind(space, *weights, rays=RAYS, **lot)


def seen_by_policies():
    """Return the random scenes and their mirror images."""
    mirrored = scenes(MIRRORS["x to -x"])
    return single_precision(scenes()), single_precision(mirrored)


def single_precision(observations):
    return {name: entry.float() for name, entry in observations.items()}


def assert_same(first, second):
    torch.testing.assert_close(first, second, rtol=0, atol=1e-9)


@pytest.mark.parametrize("mirror", MIRRORS)
def test_a_mirrored_scene_has_the_same_features_and_the_steering_turned_around(mirror):
    features = extractor(MirroredEgoFrameExtractor)
    scene = scenes()
    mirrored = scenes(MIRRORS[mirror])
    assert_same(features(mirrored), features(scene))
    assert not torch.allclose(scene["observation"][:, -RAYS:], mirrored["observation"][:, -RAYS:])
    actions = torch.rand(N, 2)
    steering = torch.tensor([1, -1])
    assert_same(features.mirror(actions, mirrored), features.mirror(actions, scene) * steering)


@pytest.mark.parametrize("kind", [FineEgoFrameExtractor, MirroredEgoFrameExtractor])
def test_a_scene_turned_by_180_degrees_has_the_same_features(kind):
    assert_same(extractor(kind)(scenes(TURN)), extractor(kind)(scenes()))


@pytest.mark.parametrize("kind", [FineEgoFrameExtractor, MirroredEgoFrameExtractor])
def test_in_a_lot_that_may_not_be_turned_the_pose_in_the_lot_tells_both_apart(kind):
    features = extractor(kind, turned=False)
    signs = torch.ones(features.features_dim)
    signs[6:10] = -1  # x, y, cos and sin
    assert_same(features(scenes(TURN)), features(scenes()) * signs)


def test_in_a_lot_that_may_not_be_turned_a_scene_mirrored_from_x_to_minus_x_is_the_same():
    features = extractor(MirroredEgoFrameExtractor, turned=False)
    assert_same(features(scenes(MIRRORS["x to -x"])), features(scenes()))
    signs = torch.ones(features.features_dim)
    signs[6:10] = -1
    assert_same(features(scenes(MIRRORS["y to -y"])), features(scenes()) * signs)


@pytest.mark.parametrize("mirror", MIRRORS)
def test_in_a_handed_lot_the_last_feature_tells_mirror_images_apart(mirror):
    features = extractor(MirroredEgoFrameExtractor, handed=True)
    scene = features(scenes())
    mirrored = features(scenes(MIRRORS[mirror]))
    plain = extractor(MirroredEgoFrameExtractor)
    assert features.features_dim == scene.shape[1] == plain.features_dim + 1
    assert_same(scene[:, :-1], plain(scenes()))
    assert_same(mirrored[:, :-1], scene[:, :-1])
    assert_same(mirrored[:, -1], -scene[:, -1])
    assert_same(scene[:, -1:], features.sign(scenes()).double())


def test_rays_come_last_as_nearness_and_change_sides_in_the_mirror():
    scene = scenes()
    nearness = 1 - scene["observation"][:, -RAYS:]
    assert_same(extractor(EgoFrameExtractor)(scene)[:, -RAYS:], nearness)
    assert_same(extractor(FineEgoFrameExtractor)(scene)[:, -RAYS:], nearness)
    features = extractor(MirroredEgoFrameExtractor)
    is_mirrored = features.sign(scene)[:, 0] < 0
    assert 60 < is_mirrored.sum() < 140
    seen = features(scene)[:, -RAYS:]
    assert_same(seen[~is_mirrored], nearness[~is_mirrored])
    assert_same(seen[is_mirrored], nearness[is_mirrored][:, [0, 6, 5, 4, 3, 2, 1]])


def test_x_and_y_are_in_units_of_half_the_lots_size():
    scene = scenes()
    features = extractor(EgoFrameExtractor, lot_size_m=(50.0, 20.0))(scene)
    assert_same(features[:, 6], scene["observation"][:, 0] * 4)
    assert_same(features[:, 7], scene["observation"][:, 1] * 10)


def outlines(slots, turns):
    """Places of slots, shape (slots, 3), and their headings, which count the same in `turns`
    directions; sorted.
    """
    x, y, heading = slots.T
    entries = [x, y, np.cos(turns * heading), np.sin(turns * heading)]
    return sorted(map(tuple, np.round(np.stack(entries, axis=-1), 6) + 0.0))


@pytest.mark.parametrize(
    ("overrides", "turned", "handed"),
    [
        (["env=parking"], True, False),
        (["env=parking_parallel"], True, False),
        (["env=parking_bays"], True, False),
        (["env=parking_dead_end"], False, True),
        (["env=parking_bays", "env.lot.angle_deg=60"], True, True),
        (["env=parking_bays", "env.lot.angle_deg=[60,90]"], True, True),
        (["env=parking_bays", "env.lot.rows=1", "env.vehicles_count=5"], False, False),
    ],
)
def test_features_know_the_size_and_the_symmetries_of_the_lot(overrides, turned, handed):
    config = compose(*overrides).env
    lot = lot_of(config)
    (slots,) = lot.from_seeds([0]).slots
    factor, summand = TURN
    assert (outlines(slots * factor + summand, 1) == outlines(slots, 1)) == turned
    factor, summand = MIRRORS["x to -x"]
    assert (outlines(slots * factor + summand, 2) == outlines(slots, 2)) != handed
    task = ParkingTask(config)
    ego = {"lot_size_m": lot.size_m, "rays": 0}
    assert task.features("ego")[1] == ego
    fine = {**ego, "reward_weights": config.reward_weights, "turned": turned}
    assert task.features("ego_fine")[1] == fine
    assert task.features("ego_mirrored")[1] == {**fine, "handed": handed}


@pytest.mark.parametrize("algorithm", ["sac", "td3", "ddpg"])
def test_the_mirror_image_of_a_scene_gets_the_mirror_image_of_the_action(algorithm):
    model = make_model(f"algorithm={algorithm}", *ONE, *SEES)
    scene, mirrored = seen_by_policies()
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
    model = make_model("algorithm=sac", *ONE, *SEES)
    sampled = []
    for entries in seen_by_policies():
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
    scene = {"observation": torch.tensor(car).float(), "desired_goal": torch.tensor(goal)}
    assert extractor.sign(scene).tolist() == [[1], [-1], [-1]]
    assert extractor(scene)[:, 1].tolist() == pytest.approx([1.4, 1.4, 1.0])  # to the left
    mirrored = extractor.mirror(torch.full((3, 2), 0.5), scene)
    assert mirrored.tolist() == [[0.5, 0.5], [0.5, -0.5], [0.5, -0.5]]


def test_a_policy_that_mirrors_no_steering_is_refused():
    message = "^algorithm.features=ego_mirrored: .*ego_fine$"
    with pytest.raises(ConfigError, match=message):
        make_model("algorithm=tqc", "algorithm.features=ego_mirrored", *ONE)
