"""Tests of parametric lots: geometry, scenes, and that highway-env simulates the same."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import TD3, HerReplayBuffer
from support.runs import config_refusal
from support.simulator_equality import KINDS, find_mismatches

import parking_exp.envs
from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.evaluation.agents import load_model
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_report import cell_data, figure_data
from parking_exp.tasks.parking.reward import reward_of
from parking_exp.tasks.parking.scenes import NO_SLOT
from parking_exp.tasks.parking.vec_env import ParkingVecEnv

LOTS = ("parking_parallel", "parking_bays", "parking_angled", "parking_dead_end")
LEVELS = ("easy", "normal", "hard", "extreme")
SB3_HER = (
    "buffer=replay",
    "buffer._target_=stable_baselines3.HerReplayBuffer",
    "++buffer.goal_selection_strategy=future",
)
LOTS_AND_LEVELS = [(lot, level) for lot in (*LOTS, "parking_lots") for level in LEVELS]


def env_config(lot, *overrides):
    return compose(f"env={lot}", *[f"env.{override}" for override in overrides]).env


@pytest.mark.parametrize(("lot", "level"), LOTS_AND_LEVELS)
def test_a_lot_is_simulated_as_highway_env_does(lot, level):
    config = env_config(lot, f"level={level}", "duration=20")
    assert find_mismatches(config, "biased", 3) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("lot", "level"), LOTS_AND_LEVELS)
def test_a_lot_is_simulated_as_highway_env_does_in_many_scenes(lot, level, kind):
    # Of crowded parking-v0: it sees as many vehicles as on these lots.
    policy = GreedyPolicy(load_model("pretrained/crowded"))
    config = env_config(lot, f"level={level}", "duration=20")
    assert find_mismatches(config, kind, 60, policy) == []


@pytest.mark.parametrize(
    "overrides",
    [
        ["lot.rows=1", "vehicles_count=6"],
        ["lot.angle_deg=30", "lot.heading=out", "lot.pitch_m=12", "standing_reward=-0.3"],
        ["lot.neighbours=any", "vehicles_count=0", "add_walls=false"],
        ["lot.angle_deg=[30,90]", "level=normal", "observation.rays=8"],
        ["lot.angle_deg=[0,30]", "lot.pitch_m=[9,10]", "lot.end_m=[8,12]", "lot.dead_end=true"],
    ],
)
def test_other_lots_are_simulated_as_highway_env_does(overrides):
    config = env_config("parking_parallel", "duration=20", *overrides)
    assert find_mismatches(config, "biased", 3) == []


def test_parallel_slots_stand_in_two_rows_along_the_street():
    scenes = lot_of(env_config("parking_parallel")).from_seeds([0])
    slots = scenes.slots[0]
    above = [-28.0, -20.0, -12.0, -4.0, 4.0, 12.0, 20.0, 28.0]
    np.testing.assert_allclose(slots[:8, 0], above)
    np.testing.assert_allclose(slots[8:, 0], above[::-1])
    np.testing.assert_allclose(slots[:, 1], [8.5] * 8 + [-8.5] * 8)  # (14 + 3) / 2
    np.testing.assert_allclose(slots[:, 2], [0.0] * 8 + [np.pi] * 8)
    np.testing.assert_array_equal(scenes.slot_size, [[8.0, 3.0]])
    # 8 slots of 8 m, 8 m beyond them at both ends; 14 m, 3 m and 0.5 m on both sides; half a wall.
    np.testing.assert_allclose(scenes.box, [[64 + 16 + 1, 14 + 6 + 1 + 1]])


def test_bays_stand_across_the_aisle_and_their_cars_point_out_of_them():
    config = env_config("parking_bays", "lot.slot_width_m=3", "lot.aisle_width_m=6")
    slots = lot_of(config).from_seeds([0]).slots[0]
    np.testing.assert_allclose(np.diff(slots[:9, 0]), 3.0)
    np.testing.assert_allclose(slots[:9, 1], 6.0)  # (6 + 6) / 2
    np.testing.assert_allclose(np.sin(slots[:9, 2]), -1.0)  # towards the aisle
    inward = env_config("parking_bays", "lot.heading=in")
    np.testing.assert_allclose(np.sin(lot_of(inward).from_seeds([0]).slots[0, :9, 2]), 1.0)


def test_angled_slots_touch_and_do_not_overlap():
    config = env_config("parking_angled", "lot.angle_deg=60", "lot.slot_width_m=3")
    slots = lot_of(config).from_seeds([0]).slots[0]
    # Side by side, their width measured along the aisle is 3 / sin 60.
    np.testing.assert_allclose(np.diff(slots[:9, 0]), 3.0 / np.sin(np.pi / 3))
    np.testing.assert_allclose(slots[:9, 2], np.pi / 3)


def test_a_dead_end_has_the_wall_half_a_metre_behind_its_rows():
    config = env_config("parking_dead_end", "lot.slot_width_m=3")
    scenes = lot_of(config).from_seeds([0])
    wall = (scenes.box[0, 0] - 1) / 2
    assert wall - scenes.slots[0, :, 0].max() == pytest.approx(1.5 + 0.5)
    assert wall + scenes.slots[0, :, 0].min() == pytest.approx(1.5 + 16.0)


def test_one_row_has_the_wall_on_the_other_side_of_the_aisle():
    config = env_config("parking_parallel", "lot.rows=1", "vehicles_count=3")
    scenes = lot_of(config).from_seeds([0])
    assert scenes.slots.shape == (1, 8, 3)
    wall = (scenes.box[0, 1] - 1) / 2
    assert scenes.slots[0, 0, 1] + wall == pytest.approx(14 + 1.5)
    assert wall - scenes.slots[0, 0, 1] == pytest.approx(1.5 + 0.5)


@pytest.mark.parametrize("lot", LOTS)
def test_both_neighbours_of_every_goal_are_taken(lot):
    config = env_config(lot)
    scenes = lot_of(config).random(np.random.default_rng(0), 300)
    for goal, taken in zip(scenes.goal, scenes.vehicles, strict=True):
        assert {goal - 1, goal + 1} <= set(taken)
        assert goal not in taken
        assert 0 < goal % config.lot.slots_per_row < config.lot.slots_per_row - 1
    numbers = (scenes.vehicles != NO_SLOT).sum(axis=1)
    assert (numbers.min(), numbers.max()) == config.vehicles_range


def test_any_slot_is_a_goal_where_neighbours_are_any():
    config = env_config("parking_parallel", "lot.neighbours=any", "vehicles_count=0")
    scenes = lot_of(config).random(np.random.default_rng(0), 1000)
    assert set(scenes.goal) == set(range(16))


def test_scenes_draw_the_numbers_of_their_lot_from_the_ranges():
    config = env_config("parking_bays", "level=hard")
    scenes = lot_of(config).random(np.random.default_rng(0), 2000)
    width = scenes.slot_size[:, 1]
    assert 2.4 <= width.min() < 2.41
    assert 2.84 < width.max() <= 2.85
    aisle = scenes.box[:, 1] - 2 * (6.0 + 0.5) - 1
    assert 5.5 <= aisle.min() < 5.51
    assert 6.49 < aisle.max() <= 6.5


def test_angle_pitch_and_end_are_drawn_after_all_other_numbers():
    ranges = ["lot.angle_deg=[45,90]", "lot.pitch_m=[5,6]", "lot.end_m=[8,10]"]
    lot = lot_of(env_config("parking_bays", *ranges))
    alone = lot_of(env_config("parking_bays"))
    scenes = lot.from_seeds([7])
    of_alone = alone.from_seeds([7])
    rng, _ = gym.utils.seeding.np_random(7)
    draws = rng.random(alone.n_draws + 3)
    angle, pitch, end = [45, 5, 8] + draws[-3:] * [45, 1, 2]

    assert lot.n_draws == len(draws)
    slots = scenes.slots[0]
    heading = np.radians(angle)
    depth = 6 * np.sin(heading) + 3.5 * np.cos(heading)
    np.testing.assert_allclose(slots[:9, 2], heading + np.pi)  # nose out
    np.testing.assert_allclose(np.diff(slots[:9, 0]), pitch)
    np.testing.assert_allclose(slots[:9, 1], (8 + depth) / 2)
    row = 8 * pitch + 6 * np.cos(heading) + 3.5 * np.sin(heading)
    np.testing.assert_allclose(scenes.box, [[row + 2 * end + 1, 8 + 2 * (depth + 0.5) + 1]])
    for name in ("start", "goal", "vehicles", "slot_size"):
        np.testing.assert_array_equal(getattr(scenes, name), getattr(of_alone, name))


def test_ranges_of_the_angle_do_not_change_the_scenes_of_lots_without_them():
    lot = lot_of(env_config("parking_angled", "level=normal"))
    scenes = lot.from_seeds([7])
    start = [-6.595027440225795, -0.19983371508877457, 0.13039475108667245]
    taken = [0, 2, 16, 15, 13, 12, 4, 3, 5, 6, 17, 7, 14, 10, 9, NO_SLOT]
    assert lot.n_draws == 3 + 3 + 2 + 18
    assert (scenes.goal.tolist(), scenes.vehicles.tolist()) == ([1], [taken])
    np.testing.assert_allclose(scenes.start, [start], rtol=1e-15)
    np.testing.assert_allclose(scenes.slot_size, [[6.0, 3.1640248303393514]], rtol=1e-15)
    np.testing.assert_allclose(scenes.box, [[51.96813528158398, 22.332015365997812]], rtol=1e-15)


def test_the_size_of_a_lot_is_that_of_its_largest_scene():
    """The diagonal of the slots, 8 x 3 m, may be along the aisle or across it."""
    lot = lot_of(env_config("parking_parallel", "lot.angle_deg=[0,90]", "lot.end_m=[8,9]"))
    diagonal = np.sqrt(8**2 + 3**2)
    assert lot.size_m == pytest.approx((8 * diagonal + 2 * 9 + 1, 14 + 2 * diagonal + 1 + 1))
    assert lot.nearest_row_m == pytest.approx((14 + 3) / 2)
    scenes = lot.random(np.random.default_rng(0), 3000)
    assert (scenes.box <= lot.size_m).all()
    assert (np.abs(scenes.slots[..., 1]) >= lot.nearest_row_m).all()


def test_a_scene_is_made_from_the_first_numbers_of_its_seed():
    config = env_config("parking_angled", "level=normal")
    lot = lot_of(config)
    rng, _ = gym.utils.seeding.np_random(7)
    by_rule = lot.scenes(rng.random((1, lot.n_draws)))
    by_seed = lot.from_seeds([7])
    for name, array in vars(by_rule).items():
        np.testing.assert_array_equal(array, getattr(by_seed, name))
    env = make_parking_env(config)
    env.reset(seed=7)
    car = env.unwrapped.vehicle
    np.testing.assert_array_equal([*car.position, car.heading], by_seed.start[0])
    env.close()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["lot.slot_length_m=4.9"], "env.lot.slot_length_m=4.9: the car is 5 m long"),
        (["lot.slot_width_m=[2,3]"], "env.lot.slot_width_m=2: the car is 2 m wide"),
        (
            ["lot.slot_length_m=[9,8]"],
            "give a length of at most 1000 m, or the lowest and the highest",
        ),
        (
            ["lot.slot_length_m=[8]"],
            "give a length of at most 1000 m, or the lowest and the highest",
        ),
        (
            ["lot.slot_length_m=long"],
            "give a length of at most 1000 m, or the lowest and the highest",
        ),
        (["lot.starts.y_m=[1,0]"], "env.lot.starts.y_m: a range is [lowest, highest]"),
        (["lot.angle_deg=[60,45]"], "env.lot.angle_deg: give an angle from 0 to 90 degrees"),
        (["lot.angle_deg=[45,91]"], "give an angle from 0 to 90 degrees, or the lowest and the"),
        (["lot.angle_deg=-1"], "give an angle from 0 to 90 degrees, or the lowest and the highest"),
        (["lot.end_m=[8]"], "give a length from 0 to 1000 m, or the lowest and the highest"),
        (["lot.pitch_m=5"], "env.lot.pitch_m=5: slots overlap below 8 m"),
        # At both ends of the range they do not. In between, their diagonal is along the aisle.
        (["lot.angle_deg=[0,30]", "lot.pitch_m=[8.4,9]"], "pitch_m=8.4: slots overlap below 8.54"),
        # At 90 degrees, where rows are shortest.
        (
            ["lot.angle_deg=[0,90]", "lot.end_m=[6,9]"],
            "cars would start in the walls, which are at -18 and 18 m",
        ),
        (
            ["lot.aisle_width_m=5"],
            "env.lot.aisle_width_m=5: cars that start within env.lot.starts need 11.4 m",
        ),
        (["lot.starts.x_m=[-60,0]"], "cars would start in the walls, which are at -40 and 40 m"),
        (["vehicles_count=16"], "env.vehicles_count=16: env.lot has 16 slots, and one is the goal"),
        (["vehicles_count=[1,9]"], "env.lot.neighbours=taken needs two cars or more"),
        (
            ["lot.slots_per_row=2", "lot.starts.x_m=[-5,5]", "vehicles_count=2"],
            "needs three slots or more",
        ),
        (["obstacles=3"], "env.obstacles=3: only highway-env's own lot has obstacles; set it to 0"),
    ],
)
def test_a_lot_that_cannot_be_is_one_sentence(overrides, message):
    keys = [f"env.{override}" for override in overrides]
    assert message in config_refusal("env=parking_parallel", *keys)


def test_a_buffer_that_does_not_know_the_sizes_of_slots_is_refused():
    sentence = config_refusal("env=parking_parallel", *SB3_HER)
    assert "does not know the sizes of slots" in sentence


def test_a_buffer_that_keeps_infos_is_refused_since_checkpoints_do_not_have_them():
    sentence = config_refusal("env=parking", *SB3_HER, "++buffer.copy_info_dict=true")
    assert sentence.startswith("buffer.copy_info_dict=true: checkpoints do not have infos")


def test_a_level_that_there_is_not_is_the_only_key_that_is_named():
    sentence = "env.level=medium: choose from easy, normal, hard, extreme"
    assert config_refusal("env=parking_parallel", "env.level=medium") == sentence


@pytest.mark.parametrize(
    "overrides", [["lot.slot_length_m=7"], ["lot.slot_length_m=7", "levels=null"]]
)
@pytest.mark.parametrize("level", ["env.level=hard", "++env.level=hard"])
def test_a_level_that_sets_no_number_is_refused(overrides, level):
    keys = [f"env.{override}" for override in overrides]
    sentence = "env.level=hard has no effect: no key of env=parking_parallel depends on the level"
    assert config_refusal("env=parking_parallel", level, *keys) == sentence
    assert env_config("parking_parallel", *overrides).level == "easy"
    assert env_config("parking_parallel", "level=null", *overrides).level is None


def test_a_lot_without_walls_may_have_starts_anywhere_along_the_street():
    config = env_config("parking_parallel", "lot.starts.x_m=[-60,0]", "add_walls=false")
    assert config.lot.starts.x_m == [-60.0, 0.0]


def test_a_large_lot_may_have_many_cars():
    config = env_config("parking_bays", "lot.slots_per_row=100", "vehicles_count=[8,150]")
    assert lot_of(config).from_seeds([0]).vehicles.shape == (1, 150)


def test_a_level_sets_the_numbers_of_the_lot_and_each_can_be_overridden():
    assert env_config("parking_parallel", "level=hard").lot.slot_length_m == [5.9, 6.25]
    mixed = env_config("parking_bays", "level=hard", "lot.aisle_width_m=9").lot
    assert (mixed.slot_width_m, mixed.aisle_width_m) == ([2.4, 2.85], 9.0)


def goal(x, y, heading, speed=0.0):
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([x, y, speed * cos, speed * sin, cos, sin]) / [100, 100, 5, 5, 1, 1]


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2, np.pi, 5.0])
def test_the_dense_reward_is_the_same_for_slots_of_all_angles(angle):
    reward = reward_of(env_config("parking_parallel"))
    cos, sin = np.cos(angle), np.sin(angle)
    # 3 m ahead of the slot's centre, 2 m to its left, turned by 0.3 rad, at 1 m/s.
    achieved = goal(4 + 3 * cos - 2 * sin, 5 + 3 * sin + 2 * cos, angle + 0.3, 1.0)
    dense, parked = reward(achieved, goal(4, 5, angle), np.array([8.0, 3.0]))
    along = 0.34 * 0.03
    across = 0.5 * 0.02
    speeds = 0.051 * 0.2 * (np.cos(0.3) + np.sin(0.3))
    headings = 0.0275 * (1 - np.cos(0.3) + np.sin(0.3))
    assert dense == pytest.approx(-np.sqrt(along + across + speeds + headings), abs=1e-12)
    assert not parked


@pytest.mark.parametrize(
    ("ahead", "speed", "slot_length", "parked"),
    [
        (0.0, 0.0, 5.6, True),
        (0.29, 0.0, 5.6, True),  # 0.29 + 5 / 2 < 5.6 / 2
        (0.31, 0.0, 5.6, False),
        (0.31, 0.0, 8.0, True),
        (1.49, 0.49, 8.0, True),
        (0.0, 0.51, 8.0, False),
    ],
)
def test_success_is_parked_between_the_lines_of_this_slot(ahead, speed, slot_length, parked):
    config = env_config("parking_parallel", "reward=sparse")
    achieved = goal(4 + ahead, 5, 0.0, speed)
    sparse, success = reward_of(config)(achieved, goal(4, 5, 0.0), np.array([slot_length, 3.0]))
    assert success == parked
    assert sparse == (0.0 if parked else -1.0)


@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_standing_outside_the_slot_costs_more_the_slower_the_car_is(reward):
    plain = reward_of(env_config("parking_parallel", f"reward={reward}"))
    changed = reward_of(env_config("parking_parallel", f"reward={reward}", "standing_reward=-0.3"))
    size = np.array([8.0, 3.0])

    def added(ahead, speed):
        achieved = goal(4 + ahead, 5, 0.0, speed)
        before, _ = plain(achieved, goal(4, 5, 0.0), size)
        return changed(achieved, goal(4, 5, 0.0), size)[0] - before

    speeds = [0.0, 0.1, -0.1, 0.25, 0.5, 3.0]
    costs = [added(3.0, speed) for speed in speeds]
    assert costs == pytest.approx([-0.3, -0.24, -0.24, -0.15, 0.0, 0.0], abs=1e-12)
    assert added(0.5, 0.0) == 0  # parked


def test_a_moving_car_does_not_stand_where_its_virtual_goal_moves_as_fast():
    changed = reward_of(env_config("parking_parallel", "standing_reward=-0.3"))
    plain = reward_of(env_config("parking_parallel"))
    moving_goal = goal(4, 5, 0.0, 3.0)
    size = np.array([8.0, 3.0])
    for speed, cost in ((3.0, 0.0), (0.0, -0.3)):
        achieved = goal(9, 5, 0.0, speed)
        added = changed(achieved, moving_goal, size)[0] - plain(achieved, moving_goal, size)[0]
        assert added == pytest.approx(cost, abs=1e-12)


def test_standing_reward_is_refused_on_highway_envs_own_lot():
    with pytest.raises(ConfigError, match=r"such as env=parking_parallel$"):
        env_config("parking", "standing_reward=-0.3")
    with pytest.raises(ConfigError, match=r"env.standing_reward=-0.3: highway-env's own lot"):
        compose("env=parking", "++env.standing_reward=-0.3")


def test_training_tells_her_the_size_of_the_slot():
    envs = ParkingVecEnv(env_config("parking_bays", "level=hard"), 3)
    envs.seed(5)
    envs.reset()
    sizes = envs.batch.state.slot_size.copy()
    _, _, _, infos = envs.step(np.zeros((3, 2), np.float32))
    told = [[info["slot_length_m"], info["slot_width_m"]] for info in infos]
    np.testing.assert_array_equal(told, sizes)


@pytest.mark.parametrize("env_id", parking_exp.envs.LOTS)
def test_gymnasium_makes_every_lot(env_id):
    env = gym.make(env_id, level="hard")
    check_env(env.unwrapped, skip_render_check=True)
    assert env.observation_space["observation"].shape == (6 + 4 * 5,)
    env.close()


def test_gymnasium_makes_a_lot_with_overrides_and_draws_it():
    overrides = ["env.lot.slot_length_m=9", "env.observation.vehicles_count=0"]
    env = gym.make("parking_exp/Parallel-v0", render_mode="rgb_array", overrides=overrides)
    _, info = env.reset(seed=0)
    assert info["slot_length_m"] == 9.0
    assert env.render().shape == (300, 600, 3)
    env.close()


def test_gymnasium_refuses_an_env_without_a_lot():
    with pytest.raises(ConfigError, match="env=parking: it has no lot of its own"):
        gym.make("parking_exp/Parallel-v0", overrides=["env=parking"])


def test_an_env_is_made_again_from_its_spec():
    spec = gym.make("parking_exp/Bays-v0", level="hard").spec
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert again.unwrapped.lot.config.slot_width_m == [2.4, 2.85]


def test_rewards_of_a_batch_need_the_sizes_of_the_slots():
    env = gym.make("parking_exp/Bays-v0", level="hard").unwrapped
    observation, info = env.reset(seed=0)
    achieved = np.stack([observation["achieved_goal"]] * 2)
    desired = np.stack([observation["desired_goal"]] * 2)
    with pytest.raises(ValueError, match="copy_info_dict=True"):
        env.compute_reward(achieved, desired, [{}, {}])
    rewards = env.compute_reward(achieved, desired, [info, info])
    one = env.compute_reward(achieved[0], desired[0], {})
    np.testing.assert_array_equal(rewards, [one, one])
    np.testing.assert_array_equal(env.compute_reward(achieved, desired, {}), [one, one])
    env.close()


def test_stable_baselines3_trains_on_a_lot_with_its_own_her():
    env = gym.make("parking_exp/Parallel-v0", overrides=["env.duration=4"])
    model = TD3(
        "MultiInputPolicy",
        env,
        learning_starts=60,
        batch_size=16,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        policy_kwargs={"net_arch": [8]},
        seed=0,
    )
    model.learn(100)
    assert model.num_timesteps == 100
    assert model._n_updates > 0
    env.close()


def test_a_report_has_the_rates_by_slot_of_the_lot_that_was_stored():
    """Ranges of a stored config are text, and numbers may have become floats."""
    config = env_config("parking_bays", "level=hard")
    goals = lot_of(config).from_seeds(range(60)).goal
    outcomes = np.where(goals == goals[0], "success", "crash")
    episodes = pd.DataFrame({"scene": range(60), "outcome": outcomes})
    data = cell_data([episodes], {"env.vehicles_count": "[9, 16]", **STORED_LOT})
    by_slot = {row["slot"]: row["success"] for row in data["slots"]}
    assert by_slot == {slot: float(slot == goals[0]) for slot in set(goals)}
    assert sum(row["n"] for row in data["slots"]) == 60


@pytest.mark.parametrize("angle", [90.0, [60.0, 90.0]])
def test_paths_lead_to_the_slots_that_a_report_draws_of_the_lot_that_was_stored(angle):
    """Each scene has slots of its own size and angle, and therefore in other places."""
    stored = {**STORED_LOT, "env.lot.angle_deg": str(angle)}
    lot = lot_of(env_config("parking_bays", "level=hard", f"lot.angle_deg={angle}"))
    scenes = lot.from_seeds(range(20))
    x, y, heading = scenes.goal_pose.T
    ends = {"scene": range(20), "step": 9, "outcome": "success", "x_m": x, "y_m": y}
    shown = figure_data(pd.DataFrame({**ends, "heading_rad": heading}), stored)

    assert shown.scene.slots.shape == (1, 18, 3)
    assert shown.scene.slot_size[0] == pytest.approx([6.0, (2.4 + 2.85) / 2])
    middle = np.radians(np.mean(angle))
    assert shown.scene.slots[0, :9, 2] == pytest.approx(middle + np.pi)
    expected = shown.scene.slots[0, scenes.goal]
    assert np.abs(expected - scenes.goal_pose)[:, :2].max() > 0.5
    places = shown.paths[["x_m", "y_m"]].to_numpy()
    np.testing.assert_allclose(places, expected[:, :2], rtol=0, atol=1e-12)
    # Paths are not turned: cars would not drive along the aisle.
    np.testing.assert_array_equal(shown.paths["heading_rad"], heading)


def test_a_report_of_runs_without_paths_draws_the_lot_alone():
    nothing = pd.DataFrame({"run_id": [], "scene": [], "step": [], "outcome": []})
    shown = figure_data(nothing, {"env.vehicles_count": 0, "env.add_walls": False})
    assert not shown.walls
    assert shown.scene.slots.shape == (1, 28, 3)
    assert shown.paths.empty


STORED_LOT = {
    "env.lot.angle_deg": np.float64(90.0),
    "env.lot.slot_length_m": np.float64(6.0),
    "env.lot.slot_width_m": "[2.4, 2.85]",
    "env.lot.aisle_width_m": "[5.5, 6.5]",
    "env.lot.pitch_m": None,
    "env.lot.slots_per_row": np.float64(9.0),
    "env.lot.rows": np.int64(2),
    "env.lot.end_m": np.float64(8.0),
    "env.lot.dead_end": np.False_,
    "env.lot.heading": "out",
    "env.lot.neighbours": "taken",
    "env.lot.starts.x_m": "[-12.0, 12.0]",
    "env.lot.starts.y_m": "[-0.5, 0.5]",
    "env.lot.starts.heading_deg": "[-10.0, 10.0]",
}
