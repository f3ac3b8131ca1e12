"""The HER buffer: Stable-Baselines3's batches, drawn from the same distributions, and what our options change."""

import copy
import io
import pickle

import numpy as np
import pytest
import torch
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.envs import BitFlippingEnv
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.save_util import load_from_pkl, save_to_pkl
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from stable_baselines3.her import GoalSelectionStrategy
from support.marks import slow_but
from support.runs import USER_CONF, make_config
from support.user_buffers import NextSecondHer

from parking_exp.algorithms.build_model import build_model
from parking_exp.buffers import HerBuffer
from parking_exp.buffers.her import NO_GOALS
from parking_exp.buffers.strategies import STRATEGIES
from parking_exp.config.compose import composed
from parking_exp.config.validate import validate
from parking_exp.envs.reward import GoalReward
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.envs.vec_env import ParkingVecEnv

ENV = make_config().env
REWARD, SPARSE = GoalReward.of(ENV), GoalReward.of(make_config("env=parking_sparse").env)
GOALS = spaces.Box(-np.inf, np.inf, (6,), np.float64)
SPACES = (
    spaces.Dict(dict.fromkeys(("observation", "achieved_goal", "desired_goal"), GOALS)),
    spaces.Box(-1, 1, (2,), np.float32),
)
AS_SB3 = {"relabel_collision": "sb3", "relabel_terminated": "sb3", "goal_velocity": "achieved"}
STRATEGY_NAMES = ["future", "final", "episode"]


class Transitions:
    """Transitions whose fields say where they come from: env, episode, and index in it.

    Observation t of an episode is (env, episode, t, 0, 0, 0), the goal (env, episode, -1, 0, 0, 0).
    """

    def __init__(self, n_envs, seed=0, longest=7):
        self.n_envs, self.longest = n_envs, longest
        self.rng = np.random.default_rng(seed)
        self.episode, self.index = np.zeros(n_envs, int), np.zeros(n_envs, int)
        self.ends = {}  # (env, episode) -> index of the last transition, and how it ended

    def observation(self, index):
        observed = np.zeros((self.n_envs, 6))
        observed[:, 0], observed[:, 1], observed[:, 2] = np.arange(self.n_envs), self.episode, index
        goal = observed.copy()
        goal[:, 2] = -1
        return {"observation": observed, "achieved_goal": observed.copy(), "desired_goal": goal}

    def __next__(self):
        end = (self.rng.random(self.n_envs) < 1 / self.longest) | (self.index >= self.longest)
        how = self.rng.integers(3, size=self.n_envs)  # success, crash or timeout
        for env in np.flatnonzero(end):
            self.ends[env, self.episode[env]] = self.index[env], ("success", "crash", "timeout")[how[env]]
        infos = [
            {"crashed": bool(e and h == 1), "TimeLimit.truncated": bool(e and h == 2)}
            for e, h in zip(end, how, strict=True)
        ]
        action = np.stack([self.episode, self.index], axis=1).astype(np.float32)
        transition = (
            self.observation(self.index), self.observation(self.index + 1), action,
            -(100.0 * self.episode + self.index), end, infos,
        )  # fmt: skip
        self.index += 1
        self.episode[end] += 1
        self.index[end] = 0
        return transition


def make(cls=HerBuffer, size=100, n_envs=1, observation_space=SPACES[0], **keywords):
    env = ParkingVecEnv(ENV, n_envs)
    return cls(size, observation_space, SPACES[1], env=env, device="cpu", n_envs=n_envs, **keywords)


def pair(size, n_envs, steps, seed=0, **keywords):
    """Our buffer and Stable-Baselines3's, with the same transitions."""
    ours, theirs = make(size=size, n_envs=n_envs, **keywords), make(HerReplayBuffer, size, n_envs)
    transitions = Transitions(n_envs, seed)
    for _ in range(steps):
        transition = next(transitions)
        ours.add(*transition)
        theirs.add(*transition)
    return ours, theirs


def drawable(ours):
    """Indices of the transitions that may be drawn."""
    episodes = ours.episodes
    return {
        int(episodes.index(np.array(step), env))
        for env in range(ours.n_envs)
        for step in range(episodes.tail[env], episodes.head[env])
    }


def records_of(ours, index):
    return ours.episodes.table[ours.storage.take(index).record_ids]


def assert_equal(ours, theirs):
    for mine, other in zip(ours[:5], theirs[:5], strict=True):
        for key in mine if isinstance(mine, dict) else [None]:
            a, b = (mine, other) if key is None else (mine[key], other[key])
            assert a.dtype == b.dtype
            assert torch.equal(a, b), key


@pytest.mark.parametrize("n_envs", [1, 8])
@pytest.mark.parametrize("steps", [30, 95, 613])
def test_given_the_same_indices_batches_are_stable_baselines3s(n_envs, steps):
    """Before the buffer is full, and after it was overwritten several times (12 rows for 8 envs, 100 for one)."""
    ours, theirs = pair(100, n_envs, steps, **AS_SB3)
    rng = np.random.default_rng(1)
    index = rng.choice(sorted(drawable(ours)), 64)
    real, virtual = index[:13], index[13:]
    goal_index = STRATEGIES["future"](rng, ours.episodes, virtual, records_of(ours, virtual))
    mine = ours._collect(ours.storage.take(index), goal_index)
    goals = theirs.next_observations["achieved_goal"].reshape(-1, 6)[goal_index]
    theirs._sample_goals = lambda *_: goals
    real_data = theirs._get_real_samples(*np.divmod(real, n_envs))
    virtual_data = theirs._get_virtual_samples(*np.divmod(virtual, n_envs))
    joined = [
        {key: torch.cat([a[key], b[key]]) for key in a} if isinstance(a, dict) else torch.cat([a, b])
        for a, b in zip(real_data[:5], virtual_data[:5], strict=True)
    ]
    assert_equal(mine, joined)


@pytest.mark.parametrize("simulator", slow_but(["vectorized"], ["vectorized", "highway_env"]))
@pytest.mark.parametrize("option", slow_but(["parking"], ["parking", "parking_sparse"]))
def test_with_real_episodes_too(option, simulator):
    """200 steps of 3 envs; with highway-env, its own compute_reward is what Stable-Baselines3 asks."""
    config = make_config(f"env={option}", f"env.simulator={simulator}", "env.training_duration=3")
    envs = make_training_envs(config.env, 3)
    keywords = {"env": envs, "device": "cpu", "n_envs": 3}
    theirs = HerReplayBuffer(1000, envs.observation_space, envs.action_space, **keywords)
    reward = GoalReward.of(config.env.for_training())
    ours = HerBuffer(1000, envs.observation_space, envs.action_space, reward=reward, **keywords)
    rng = np.random.default_rng(0)
    envs.seed(0)
    obs = envs.reset()
    for _ in range(200):
        action = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        next_obs, reward, done, infos = envs.step(action)
        stored = {key: value.copy() for key, value in next_obs.items()}
        for row in np.flatnonzero(done):
            for key, value in stored.items():
                value[row] = infos[row]["terminal_observation"][key]
        for buffer in (ours, theirs):
            buffer.add(obs, stored, action, reward, done, infos)
        obs = {key: value.copy() for key, value in next_obs.items()}
    assert ours.storage.compact
    index = np.array(sorted(drawable(ours)))
    goal_index = STRATEGIES["episode"](rng, ours.episodes, index, records_of(ours, index))
    goals = theirs.next_observations["achieved_goal"].reshape(-1, 6)[goal_index]
    theirs._sample_goals = lambda *_: goals
    assert_equal(ours._collect(ours.storage.take(index), goal_index), theirs._get_virtual_samples(*np.divmod(index, 3)))
    assert_equal(ours._collect(ours.storage.take(index), NO_GOALS), theirs._get_real_samples(*np.divmod(index, 3)))


@settings(max_examples=60, deadline=None)
@given(
    n_envs=st.sampled_from([1, 3]), rows=st.integers(9, 40), steps=st.integers(1, 150), seed=st.integers(0, 1000),
    data=st.data(),
)  # fmt: skip
def test_the_same_transitions_can_be_drawn(n_envs, rows, steps, seed, data):
    """After any number of steps: Stable-Baselines3 scans for them, we keep two numbers an env."""
    ours, theirs = pair(rows * n_envs, n_envs, steps, seed)
    assert drawable(ours) == set(np.flatnonzero(theirs.ep_length > 0))
    index = np.array(sorted(drawable(ours)), int)
    record = records_of(ours, index)
    np.testing.assert_array_equal(record["start"] % rows, theirs.ep_start.ravel()[index])
    np.testing.assert_array_equal(record["length"], theirs.ep_length.ravel()[index])
    assert len(ours.episodes) == theirs.size() * n_envs


def test_an_episode_longer_than_the_buffer_keeps_its_end():
    ours = make(size=10)
    transitions = Transitions(1, longest=10**9)
    for step in range(25):
        transition = next(transitions)
        transition = (*transition[:4], np.array([step == 24]), transition[5])
        ours.add(*transition)
    drawn = ours.sample(5000)
    assert set(drawn.actions[:, 1].tolist()) == set(range(15, 25))
    assert set(drawn.observations["desired_goal"][1000:, 2].tolist()) == set(range(16, 26))
    ours.add(*next(transitions))  # the next one overwrites its beginning: it is forgotten as a whole
    assert drawable(ours) == set()


@pytest.mark.parametrize("n_envs", [1, 8])
@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_indices_are_drawn_from_stable_baselines3s_distribution(strategy, n_envs):
    """Transition and goal index together, 200,000 draws of each, by a two-sample chi-square test."""
    steps = 150 if n_envs == 1 else 25  # the buffer has been overwritten in part
    ours, theirs = pair(100, n_envs, steps, goal_selection_strategy=strategy)
    theirs.goal_selection_strategy = type(theirs.goal_selection_strategy)[strategy.upper()]
    np.random.seed(0)
    ours.rng = np.random.default_rng(0)
    n = 200_000
    mine = ours.episodes.draw(ours.rng, n)
    my_goals = STRATEGIES[strategy](ours.rng, ours.episodes, mine, records_of(ours, mine))
    valid = np.flatnonzero(theirs.ep_length > 0)
    other = np.random.choice(valid, n)
    position = np.arange(theirs.buffer_size * n_envs, dtype=float).reshape(-1, n_envs)
    theirs.next_observations["achieved_goal"] = position
    other_goals = theirs._sample_goals(*np.divmod(other, n_envs)).astype(int)
    pairs = position.size
    mine_counts = np.bincount(mine * pairs + my_goals, minlength=pairs**2)
    other_counts = np.bincount(other * pairs + other_goals, minlength=pairs**2)
    seen = mine_counts + other_counts > 0
    table = np.stack([mine_counts[seen], other_counts[seen]])
    assert table.min() > 0, "one of the two draws what the other never does"
    assert stats.chi2_contingency(table).pvalue > 1e-3
    assert stats.chisquare(np.bincount(mine, minlength=pairs)[valid]).pvalue > 1e-3


def test_random_takes_goals_from_everything_stored():
    """From episodes under way too, all with the same probability; the transition itself is from a whole episode."""
    ours, _ = pair(100, 8, 25, goal_selection_strategy="random")
    ours.rng = np.random.default_rng(0)
    drawn = ours.episodes.draw(ours.rng, 100_000)
    goals = STRATEGIES["random"](ours.rng, ours.episodes, drawn, records_of(ours, drawn))
    counts = np.bincount(goals)
    assert len(counts) == 12 * 8
    assert stats.chisquare(counts).pvalue > 1e-3
    assert abs(np.corrcoef(drawn, goals)[0, 1]) < 0.02


@pytest.mark.parametrize("strategy", [*STRATEGY_NAMES, "random"])
@pytest.mark.parametrize(("n_envs", "steps"), [(1, 40), (1, 333), (8, 90)])
def test_which_goal_a_transition_carries(strategy, n_envs, steps):
    """Read off the fields: real ones their own goal, virtual ones a next achieved goal of where the strategy looks."""
    ours, _ = pair(100, n_envs, steps, goal_selection_strategy=strategy)
    last = {}
    for index in drawable(ours):
        transition = ours.storage.take(np.array([index]))
        env, episode, at = transition.observations(np.empty((0, 6)))[0]["observation"][0, :3]
        last[env, episode] = max(last.get((env, episode), 0), at + 1)
    real = 0
    for _ in range(20):
        batch = ours.sample(100)
        goals = batch.observations["desired_goal"]
        assert torch.equal(goals, batch.next_observations["desired_goal"])
        for row, (env, episode, at) in enumerate(batch.observations["observation"][:, :3].tolist()):
            goal = goals[row, :3].tolist()
            assert batch.actions[row].tolist() == [episode, at]
            assert batch.next_observations["achieved_goal"][row, :3].tolist() == [env, episode, at + 1]
            if row < 20:
                assert goal == [env, episode, -1]
                assert batch.rewards[row] == -(100.0 * episode + at)
                real += 1
            elif strategy == "random":
                assert goal[2] >= 1
            else:
                assert goal[:2] == [env, episode]
                lowest = {"future": at + 1, "final": last[env, episode], "episode": 1}[strategy]
                assert lowest <= goal[2] <= last[env, episode]
    assert real / 2000 == ours.real_share == 0.2


@pytest.mark.parametrize(("n_sampled_goal", "real"), [(1, 128), (2, 86), (4, 52), (8, 29)])
def test_the_share_of_real_transitions(n_sampled_goal, real):
    """Stable-Baselines3's rounding: of a batch of 256, int(n / (n + 1) * 256) are virtual."""
    ours, _ = pair(100, 1, 60, n_sampled_goal=n_sampled_goal)
    assert ours.real_share is None
    batch = ours.sample(256)
    assert int((batch.observations["desired_goal"][:, 2] == -1).sum()) == real
    assert ours.real_share == real / 256


def ended(how, option=None):
    """A buffer with one episode of three steps that ends as a crash, a success or a timeout; the first is its goal."""
    ours = make(goal_selection_strategy="final", reward=REWARD, **(option or {}))
    for step in range(3):
        last = step == 2
        observed = np.full((1, 6), float(step))
        observed[:, 2:4] = 0.7  # it moves
        after = observed.copy()
        after[:, [0, 1]] += 1
        entries = [{"observation": o, "achieved_goal": o, "desired_goal": np.zeros((1, 6))} for o in (observed, after)]
        info = {"crashed": last and how == "crash", "TimeLimit.truncated": last and how == "timeout"}
        ours.add(*entries, np.full((1, 2), step), np.array([-7.0]), np.array([last]), [info])
    return ours


@pytest.mark.parametrize("how", ["crash", "success", "timeout"])
@pytest.mark.parametrize("collision", ["keep", "sb3"])
@pytest.mark.parametrize("terminated", ["sb3", "goal", "goal_and_crash", "env"])
def test_reward_and_end_of_a_relabelled_transition(how, collision, terminated):
    """The last transition reaches the virtual goal, which is its own; the first does not."""
    ours = ended(how, {"relabel_collision": collision, "relabel_terminated": terminated})
    batch = ours._collect(ours.storage.take(np.array([0, 2, 0, 2])), np.array([2, 2]))
    crashed = how == "crash"
    assert batch.rewards[:2, 0].tolist() == [-7.0, -7.0]
    # The goal is (3, 3, .7, .7, 2, 2), the first transition achieves (1, 1, .7, .7, 0, 0).
    far = -np.sqrt(2 * 1 + 2 * 0.3 + 2 * 0.02 + 2 * 0.02)
    assert batch.rewards[2].item() == pytest.approx(far, rel=1e-6)
    assert batch.rewards[3].item() == (-5.0 if crashed and collision == "keep" else 0.0)
    real_end = float(how != "timeout")
    assert batch.dones[:2, 0].tolist() == [0.0, real_end]
    assert batch.dones[2:, 0].tolist() == [0.0, real_end if terminated == "sb3" else 1.0]


def test_a_relabelled_crash_away_from_the_goal():
    for terminated, end in (("sb3", 1.0), ("goal", 0.0), ("goal_and_crash", 1.0), ("env", 1.0)):
        ours = ended("crash", {"relabel_collision": "keep", "relabel_terminated": terminated})
        batch = ours._collect(ours.storage.take(np.array([2])), np.array([0]))
        dense, reached = REWARD(
            batch.next_observations["achieved_goal"].numpy(), batch.observations["desired_goal"].numpy()
        )
        assert not reached
        assert batch.rewards.item() == np.float32(dense[0] - 5.0)
        assert batch.dones.item() == end


@pytest.mark.parametrize("n_envs", [1, 8])
@pytest.mark.parametrize("steps", slow_but([8, 333], [8, 25, 333]))
@pytest.mark.parametrize("velocity", ["achieved", "zero"])
@pytest.mark.parametrize("collision", ["keep", "sb3", "exclude"])
@pytest.mark.parametrize("terminated", ["sb3", "goal", "goal_and_crash", "env"])
@pytest.mark.parametrize("reward", [REWARD, SPARSE], ids=["dense", "sparse"])
def test_what_every_relabelled_transition_carries(tmp_path, reward, n_envs, steps, velocity, collision, terminated):
    """Goal, reward, end and crash, worked out from the fields: at first, after wrap-around, saved and loaded midway."""
    options = {"relabel_collision": collision, "relabel_terminated": terminated, "goal_velocity": velocity}
    ours = make(size=12 * n_envs, n_envs=n_envs, reward=reward, **options)
    transitions = Transitions(n_envs)
    for step in range(steps):
        if step == steps // 2:
            ours = through_pickle(ours, tmp_path)
        ours.add(*next(transitions))
    ends = []
    for _ in range(5):
        batch = ours.sample(100)
        for row in range(20, 100):
            env, episode, index = batch.observations["observation"][row, :3].int().tolist()
            goal = batch.observations["desired_goal"][row].numpy()
            _, _, later = goal[:3]
            last, how = transitions.ends[env, episode]
            ends.append((how, index == last))
            if later == -1:  # it keeps the goal that it had
                assert terminated == "env" or (collision, how) == ("exclude", "crash")
                assert batch.rewards[row].item() == -(100.0 * episode + index)
                assert batch.dones[row].item() == (index == last and how != "timeout")
                continue
            assert (
                terminated != "env"
            )  # x and y are the same in all of an episode: its goals are reached from the start
            if collision == "exclude" and how == "crash":
                assert index < last
                assert later <= last
            if velocity == "achieved":
                assert goal.tolist() == [env, episode, later, 0, 0, 0]
                assert index < later <= last + 1
            else:  # the third entry of a goal is a velocity
                assert goal.tolist() == [env, episode, 0, 0, 0, 0]
            crashed = how == "crash" and index == last
            goal_reward, reached = reward(np.array([env, episode, index + 1, 0, 0, 0.0]), goal)
            penalty = (-20.0 if reward is SPARSE else -5.0) if crashed and collision == "keep" else 0.0
            assert batch.rewards[row].item() == np.float32(goal_reward + penalty)
            expected = {
                "sb3": index == last and how != "timeout", "goal": reached, "goal_and_crash": reached or crashed,
            }[terminated]  # fmt: skip
            assert batch.dones[row].item() == expected
    assert len(set(ends)) > 1


@pytest.mark.parametrize("terminated", ["sb3", "goal", "goal_and_crash"])
def test_without_virtual_goals_for_crashes_a_crash_stays_what_it_was_and_is_no_goal(terminated):
    ours = ended("crash", {"relabel_collision": "exclude", "relabel_terminated": terminated})
    batch = ours._collect(ours.storage.take(np.array([0, 2, 0, 1, 2])), np.array([1, 2, 2]))
    goals = batch.observations["desired_goal"]
    # The first virtual goal is no crash; the second is, and the third transition is one itself.
    assert goals[:, 0].tolist() == [0.0, 0.0, 2.0, 0.0, 0.0]
    assert torch.equal(goals, batch.next_observations["desired_goal"])
    assert batch.rewards[2].item() == pytest.approx(-np.sqrt(1 + 0.3 + 0.02 + 0.02), rel=1e-6)
    assert batch.rewards[[0, 1, 3, 4], 0].tolist() == [-7.0] * 4
    assert batch.dones[:, 0].tolist() == [0.0, 1.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("offset", [0.0, 5.0], ids=["compact", "observation_is_not_what_is_achieved"])
def test_as_in_the_env_no_relabelled_transition_begins_where_its_goal_is_reached(offset):
    """A car at x = 0, 1, 2, 3. The goals are what the first, the first and the last transition achieve."""
    ours = make(goal_selection_strategy="final", reward=REWARD, relabel_collision="keep", relabel_terminated="env")
    for step in range(3):
        observed = [
            {"observation": o, "achieved_goal": o, "desired_goal": np.full((1, 6), 9.0)} for o in np.zeros((2, 1, 6))
        ]
        for entry, x in zip(observed, (step, step + 1), strict=True):
            entry["achieved_goal"][:, 0] = x
            entry["observation"] = entry["achieved_goal"] + offset
        ours.add(*observed, np.zeros((1, 2)), np.array([-7.0]), np.array([step == 2]), [{}])
    batch = ours._collect(ours.storage.take(np.array([0, 0, 1, 2])), np.array([0, 0, 2]))
    assert batch.observations["achieved_goal"][:, 0].tolist() == [0.0, 0.0, 1.0, 2.0]
    assert batch.observations["observation"][:, 0].tolist() == [offset, offset, offset + 1, offset + 2]
    assert batch.observations["desired_goal"][:, 0].tolist() == [9.0, 1.0, 9.0, 3.0]
    assert torch.equal(batch.observations["desired_goal"], batch.next_observations["desired_goal"])
    assert batch.rewards[:, 0].tolist() == [-7.0, 0.0, -7.0, 0.0]
    assert batch.dones[:, 0].tolist() == [0.0, 1.0, 0.0, 1.0]


def test_those_that_keep_their_goal_count_as_real():
    """Two thirds of a batch may have a virtual goal, but not where the episode is one step that ends in a crash."""
    ours = make(goal_selection_strategy="final", reward=REWARD, n_sampled_goal=2, relabel_collision="exclude")
    entry = dict.fromkeys(("observation", "achieved_goal", "desired_goal"), np.zeros((1, 6)))
    for crashed in (True, False):
        ours.add(entry, entry, np.zeros((1, 2)), np.zeros(1), np.array([True]), [{"crashed": crashed}])
    batch = ours._collect(ours.storage.take(np.array([0, 1, 0, 1, 1, 0])), np.array([0, 1, 0, 0]))
    assert len(batch.rewards) == 6
    assert ours.real_share == 5 / 6


def test_without_crashes_excluding_them_changes_nothing():
    batches = [
        ended("success", {"relabel_collision": one, "relabel_terminated": "goal"}) for one in ("exclude", "keep")
    ]
    one, other = (ours._collect(ours.storage.take(np.array([0, 1, 2])), np.array([2, 2])) for ours in batches)
    for mine, theirs in zip((one.rewards, one.dones), (other.rewards, other.dones), strict=True):
        assert torch.equal(mine, theirs)
    assert torch.equal(one.observations["desired_goal"], other.observations["desired_goal"])


def test_goal_velocity():
    for option, speed in (("achieved", 0.7), ("zero", 0.0)):
        batch = ended("success", {"goal_velocity": option}).sample(10)
        assert set(batch.observations["desired_goal"][2:, 2].tolist()) == {speed}
        assert set(batch.observations["desired_goal"][2:, 3].tolist()) == {speed}
        assert set(batch.observations["achieved_goal"][:, 2].tolist()) == {0.7}
        assert set(batch.observations["desired_goal"][:2, 2].tolist()) == {0.0}


@pytest.mark.parametrize("n_envs", [1, 8])
def test_without_a_strategy_everything_stored_is_drawn_as_it_is(n_envs):
    """Stable-Baselines3's DictReplayBuffer: at every step, also of episodes that are half overwritten, and reloaded."""
    ours = make(size=12 * n_envs, n_envs=n_envs, goal_selection_strategy=None)
    theirs = DictReplayBuffer(12 * n_envs, *SPACES, device="cpu", n_envs=n_envs)
    transitions = Transitions(n_envs)
    for step in range(150):
        transition = next(transitions)
        ours.add(*transition)
        theirs.add(*transition)
        index = np.arange(len(ours.episodes))
        row, env = np.divmod(index, n_envs)
        expected = [
            {k: torch.tensor(v[row, env]) for k, v in theirs.observations.items()},
            torch.tensor(theirs.actions[row, env]),
            {k: torch.tensor(v[row, env]) for k, v in theirs.next_observations.items()},
            torch.tensor((theirs.dones * (1 - theirs.timeouts))[row, env][:, None]),
            torch.tensor(theirs.rewards[row, env][:, None]),
        ]
        for buffer in (ours, pickle.loads(pickle.dumps(ours)) if step % 7 == 0 else ours):
            assert_equal(buffer._collect(buffer.storage.take(index), NO_GOALS), expected)
    ours.rng = np.random.default_rng(0)
    batch = ours.sample(20_000)
    drawn = batch.observations["observation"][:, 0] * 1e6 + batch.actions[:, 0] * 1000 + batch.actions[:, 1]
    _, counts = np.unique(drawn.numpy(), return_counts=True)
    assert len(counts) == 12 * n_envs
    assert stats.chisquare(counts).pvalue > 1e-3
    assert ours.real_share == 1.0


def through_pickle(buffer, tmp_path):
    save_to_pkl(tmp_path / "buffer.pkl", buffer)
    loaded = load_from_pkl(tmp_path / "buffer.pkl")
    loaded.set_env(buffer.env)
    return loaded


def through_arrays(buffer, tmp_path):
    np.savez(tmp_path / "buffer.npz", allow_pickle=False, **buffer.get_state())
    loaded = make(
        size=buffer.buffer_size * buffer.n_envs,
        n_envs=buffer.n_envs,
        goal_selection_strategy=buffer.goal_selection_strategy,
    )
    with np.load(tmp_path / "buffer.npz", allow_pickle=False) as state:
        loaded.set_state(state)
    return loaded


@pytest.mark.parametrize("through", [through_pickle, through_arrays])
@pytest.mark.parametrize("strategy", ["future", "random", None])
@pytest.mark.parametrize(("n_envs", "steps"), [(1, 39), (1, 335), (8, 90)])
def test_saved_in_the_middle_of_episodes_it_goes_on_identically(tmp_path, through, strategy, n_envs, steps):
    ours = make(size=100, n_envs=n_envs, goal_selection_strategy=strategy)
    transitions = Transitions(n_envs)
    for _ in range(steps):
        ours.add(*next(transitions))
    assert (ours.episodes.current >= 0).any()
    ours.sample(32)
    other = through(ours, tmp_path)
    for _ in range(150):
        transition = next(transitions)
        ours.add(*transition)
        other.add(*transition)
        assert_equal(ours.sample(32), other.sample(32))
    assert ours.real_share == other.real_share
    assert drawable(ours) == drawable(other)


def test_truncating_the_last_trajectory_is_stable_baselines3s():
    """As `load_replay_buffer` does: episodes under way end, and bootstrap."""
    ours, theirs = pair(100, 8, 90)
    for buffer in (ours, theirs):
        with pytest.warns(UserWarning, match="truncated"):
            buffer.truncate_last_trajectory()
    assert drawable(ours) == set(np.flatnonzero(theirs.ep_length > 0))
    index = np.array(sorted(drawable(ours)))
    assert_equal(ours._collect(ours.storage.take(index), NO_GOALS), theirs._get_real_samples(*np.divmod(index, 8)))


@pytest.mark.parametrize(
    ("size", "n_envs", "message"),
    [
        (50, 1, "has 100 rows and this one 50"),
        (500, 1, "has 100 rows and this one 500"),
        (200, 2, "of other spaces or another number of envs"),
    ],
)
def test_a_state_of_another_buffer_is_refused_and_changes_nothing(size, n_envs, message):
    ours, _ = pair(100, 1, 133)
    other, _ = pair(size, n_envs, 45)
    before = pickle.dumps(other)
    with pytest.raises(ValueError, match=message):
        other.set_state(ours.get_state())
    assert pickle.dumps(other) == before


def test_a_reset_forgets_everything_and_goes_on():
    ours, theirs = pair(100, 2, 133)
    ours.sample(10)
    ours.reset()
    assert (len(ours.episodes), ours.size(), ours.real_share) == (0, 0, None)
    with pytest.raises(RuntimeError, match="learning_starts"):
        ours.sample(1)
    theirs = make(HerReplayBuffer, 100, 2)
    transitions = Transitions(2, seed=5)
    for _ in range(70):
        transition = next(transitions)
        ours.add(*transition)
        theirs.add(*transition)
    index = np.array(sorted(drawable(ours)))
    assert set(index) == set(np.flatnonzero(theirs.ep_length > 0))
    assert_equal(ours._collect(ours.storage.take(index), NO_GOALS), theirs._get_real_samples(*np.divmod(index, 2)))


def test_a_copy_is_independent_and_leaves_numpys_global_generator_alone():
    ours, _ = pair(100, 1, 133)
    np.random.seed(0)
    other = copy.deepcopy(ours)
    assert np.random.rand() == np.random.RandomState(0).rand()
    ours.add(*next(Transitions(1)))
    assert (ours.pos, other.pos) == (34, 33)


def test_an_env_that_was_reset_without_a_word_starts_another_episode():
    """As `learn` does when it is called a second time; the old episode ends as if by time, and no memory is lost."""
    ours = make(size=100)
    first, second = Transitions(1, longest=10**9), Transitions(1, longest=10**9)
    second.episode += 7
    for transitions in (first, second):
        for _ in range(5):
            ours.add(*next(transitions))
    assert ours.storage.compact
    assert ours.storage.data.dtype.itemsize == 112
    batch = ours._collect(ours.storage.take(np.arange(10)), NO_GOALS)
    assert batch.observations["desired_goal"][:, 1].tolist() == [0.0] * 5 + [7.0] * 5
    assert not batch.dones.any()
    assert drawable(ours) == {0, 1, 2, 3, 4}
    config = make_config("experiment=smoke", "tracking.mlflow=false")
    model = build_model(config, make_training_envs(config.env, 2), seed=0)
    model.set_logger(Logger(None, []))
    for _ in range(2):
        model.learn(105)
    assert model.replay_buffer.storage.data.dtype.itemsize == 112


def test_memory_and_file():
    ours = make(size=5000)
    transitions = Transitions(1, longest=20)
    for _ in range(2020):
        ours.add(*next(transitions))
    assert ours.storage.data.dtype.itemsize == 112
    assert ours.nbytes / 5000 < 150
    assert not any(array.dtype.hasobject for array in ours.get_state().values())
    file = io.BytesIO()
    pickle.dump(ours, file, protocol=pickle.HIGHEST_PROTOCOL)
    assert 112 < len(file.getbuffer()) / 2020 < 120  # of 2,020 transitions, not of 5,000


def test_saving_streams(tmp_path):
    """No second copy of the rows is made on the way to the file."""
    import tracemalloc

    ours = make(size=200_000)
    ours.full = True
    tracemalloc.start()
    save_to_pkl(tmp_path / "buffer.pkl", ours)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (tmp_path / "buffer.pkl").stat().st_size > 200_000 * 112
    assert peak < 2_000_000


@pytest.mark.parametrize("at", [0, 57, 130])
def test_goals_that_change_within_an_episode_and_other_achieved_goals(at):
    """From such a transition on, everything is stored with each; batches stay Stable-Baselines3's."""
    ours, theirs = make(size=100, n_envs=2), make(HerReplayBuffer, 100, 2)
    transitions = Transitions(2)
    for step in range(170):
        obs, next_obs, *rest = next(transitions)
        if step >= at:
            obs["achieved_goal"], next_obs["desired_goal"] = obs["achieved_goal"] + 0.5, next_obs["desired_goal"] + step
        assert ours.storage.compact == (step <= at)
        for buffer in (ours, theirs):
            buffer.add(obs, next_obs, *rest)
    assert not ours.storage.compact
    index = np.array(sorted(drawable(ours)))
    assert_equal(ours._collect(ours.storage.take(index), NO_GOALS), theirs._get_real_samples(*np.divmod(index, 2)))
    other = pickle.loads(pickle.dumps(ours))
    other.set_env(ours.env)
    assert_equal(ours.sample(64), other.sample(64))


def test_with_vec_normalize_batches_are_stable_baselines3s():
    ours, theirs = pair(100, 1, 80)
    normalize = VecNormalize(ParkingVecEnv(ENV, 1), norm_obs_keys=["observation"])
    normalize.obs_rms["observation"].mean = np.arange(6.0)
    normalize.ret_rms.var = np.array(4.0)
    index = np.array(sorted(drawable(ours)))
    goals = theirs.next_observations["achieved_goal"].reshape(-1, 6)[index[::-1]]
    theirs._sample_goals = lambda *_: goals
    at = (index, index * 0, normalize)
    taken = ours.storage.take(index)
    assert_equal(ours._collect(taken, NO_GOALS, normalize), theirs._get_real_samples(*at))
    assert_equal(ours._collect(ours.storage.take(index), index[::-1], normalize), theirs._get_virtual_samples(*at))


def test_other_spaces():
    """Images, discrete observations, more keys than HER asks for, and keys that are called like a row's own fields."""
    space = spaces.Dict(
        {
            "observation": spaces.Box(0, 255, (2, 2, 1), np.uint8),
            "achieved_goal": spaces.Box(-9, 9, (3,), np.float32),
            "desired_goal": spaces.Box(-9, 9, (3,), np.float32),
            "next_obs": spaces.Discrete(5),
            "action": spaces.Box(-9, 9, (1,), np.float32),
            "reward": spaces.MultiBinary(3),
        }
    )
    ours, theirs = (make(cls, 40, 2, observation_space=space) for cls in (HerBuffer, HerReplayBuffer))
    rng = np.random.default_rng(0)

    def observation():
        observed = {key: np.stack([part.sample() for _ in range(2)]) for key, part in space.spaces.items()}
        return observed | {"next_obs": rng.integers(5, size=2)}

    for step in range(70):
        transition = (
            observation(), observation(), rng.normal(size=(2, 2)).astype(np.float32), rng.normal(size=2),
            np.array([step % 5 == 4, step % 7 == 6]), [{}, {}],
        )  # fmt: skip
        for buffer in (ours, theirs):
            buffer.add(*transition)
    index = np.array(sorted(drawable(ours)))
    assert_equal(ours._collect(ours.storage.take(index), NO_GOALS), theirs._get_real_samples(*np.divmod(index, 2)))
    assert_equal(*(buffer._collect(buffer.storage.take(index), NO_GOALS) for buffer in (ours, copy.deepcopy(ours))))


def test_another_env_is_asked_for_its_rewards(tmp_path):
    """Stable-Baselines3's bit flipping, whose achieved goal is not named here, from `learn` to a loaded buffer."""
    envs = DummyVecEnv([lambda: BitFlippingEnv(n_bits=4, continuous=True, max_steps=4)] * 2)
    model = SAC(
        "MultiInputPolicy", envs, replay_buffer_class=HerBuffer, learning_starts=20, buffer_size=200, batch_size=64,
        policy_kwargs={"net_arch": [8]}, seed=0,
    )  # fmt: skip
    model.learn(100)
    batch = model.replay_buffer.sample(50)
    reached = (batch.next_observations["achieved_goal"] == batch.observations["desired_goal"]).all(dim=1)
    assert batch.rewards[:, 0].tolist() == [0.0 if r else -1.0 for r in reached]
    assert reached[10:].any()
    model.save_replay_buffer(tmp_path / "buffer")
    size = model.replay_buffer.size()
    model.load_replay_buffer(tmp_path / "buffer", truncate_last_traj=False)
    assert model.replay_buffer.size() == size
    model.learn(20, reset_num_timesteps=False)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"goal_selection_strategy": "past"}, "goal_selection_strategy='past' is not one of"),
        ({"relabel_collision": "drop"}, "relabel_collision='drop' is not one of"),
        ({"relabel_terminated": True}, "relabel_terminated=True is not one of"),
        ({"goal_velocity": "none"}, "goal_velocity='none' is not one of"),
        ({"copy_info_dict": True}, "copy_info_dict must be False"),
        ({"n_sampled_goal": 0}, "n_sampled_goal=0 is below 1"),
        ({"relabel_collision": "keep"}, "needs to know the reward"),
        ({"goal_velocity": "zero"}, "needs to know the reward"),
    ],
)
def test_wrong_arguments_are_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        make(**keywords)


@pytest.mark.parametrize("strategy", ["FUTURE", GoalSelectionStrategy.FUTURE])
def test_strategies_are_named_as_stable_baselines3_names_them(strategy):
    assert make(goal_selection_strategy=strategy).goal_selection_strategy == "future"


def test_rewards_of_another_shape_are_taken_as_stable_baselines3_takes_them():
    ours, _ = pair(100, 1, 60)
    ours.env.env_method = lambda name, achieved, *_, **__: [achieved[:, 1:2] * 2]
    batch = ours.sample(20)
    assert torch.equal(batch.rewards[4:, 0], 2 * batch.next_observations["achieved_goal"][4:, 1].float())


def test_an_empty_buffer_has_nothing_to_draw():
    with pytest.raises(RuntimeError, match="nothing to sample yet"):
        make(goal_selection_strategy=None).sample(1)


def test_before_the_first_episode_has_ended_there_is_nothing_to_draw():
    ours = make()
    ours.add(*next(Transitions(1, longest=10**9)))
    with pytest.raises(RuntimeError, match="learning_starts"):
        ours.sample(1)


def test_the_models_seed_seeds_the_buffer():
    config = make_config("experiment=smoke", "n_envs=1")
    states = [
        build_model(config, make_training_envs(config.env, 1), seed=seed).replay_buffer.rng.bit_generator.state
        for seed in (3, 3, 4)
    ]
    assert states[0] == states[1] != states[2]


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_is_an_option_of_the_config(strategy):
    buffer = make_config(f"buffer=her_{strategy}").buffer
    assert (buffer.name, buffer.arguments["goal_selection_strategy"]) == (f"her_{strategy}", strategy)


def test_a_users_strategy_is_a_subclass_and_a_yaml_of_their_own():
    """In the directory given with --config-dir. The whole example: tests/support/user_buffers.py and user_conf/buffer."""
    (composed_config,) = composed("config", ["experiment=smoke", "buffer=her_next_second"], str(USER_CONF))
    config = validate(composed_config)
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    model.set_logger(Logger(None, []))
    model.learn(60)
    assert type(model.replay_buffer) is NextSecondHer
    assert model._n_updates > 0
    ours = make(NextSecondHer, size=1000, n_envs=2)
    transitions = Transitions(2, longest=40)
    for _ in range(400):
        ours.add(*next(transitions))
    batch = ours.sample(500)
    steps = batch.observations["desired_goal"][:, 2] - batch.observations["observation"][:, 2]
    assert set(steps[100:].tolist()) == {1, 2, 3, 4, 5}
