"""The HER buffer draws Stable-Baselines3's batches, but for what our options change."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.her.goal_selection_strategy import GoalSelectionStrategy
from support.marks import slow_but

from parking_exp.buffers import HerBuffer
from parking_exp.buffers.her import NO_GOALS
from parking_exp.config.compose import compose
from parking_exp.tasks.parking.reward import ParkingReward
from parking_exp.tasks.parking.vec_env import ParkingVecEnv

ENV = compose().env
REWARD, SPARSE = ParkingReward(ENV), ParkingReward(compose("env=parking_sparse").env)
GOALS = spaces.Box(-np.inf, np.inf, (6,), np.float64)
SPACES = (
    spaces.Dict(dict.fromkeys(("observation", "achieved_goal", "desired_goal"), GOALS)),
    spaces.Box(-1, 1, (2,), np.float32),
)
STRATEGY_NAMES = ["future", "final", "episode"]


class Transitions:
    """Transitions whose fields say where they come from: env, episode, and index in it.

    Observation t of an episode is (t, env, t, episode, 0, 0), the goal (-1, env, -1, episode, 0,
    0), the action (episode, t), the reward -(100 episode + t). The third and the fourth entry are
    velocities. An offset is between observation and achieved goal.
    """

    def __init__(self, n_envs, seed=0, longest=7, offset=0):
        self.n_envs = n_envs
        self.longest = longest
        self.offset = offset
        self.rng = np.random.default_rng(seed)
        self.episode, self.index = np.zeros(n_envs, int), np.zeros(n_envs, int)
        self.ends = {}  # (env, episode) -> index of the last transition, and how it ended

    def observation(self, index):
        index = np.broadcast_to(index, self.n_envs)
        zero = np.zeros(self.n_envs)
        observed = np.stack(
            [index, np.arange(self.n_envs), index, self.episode, zero, zero], axis=1
        ).astype(float)
        goal = observed.copy()
        goal[:, [0, 2]] = -1
        return {
            "observation": observed + self.offset,
            "achieved_goal": observed,
            "desired_goal": goal,
        }

    def __next__(self):
        end = (self.rng.random(self.n_envs) < 1 / self.longest) | (self.index >= self.longest)
        how = self.rng.choice(["success", "crash", "timeout"], size=self.n_envs)
        for env in np.flatnonzero(end):
            self.ends[env, self.episode[env]] = self.index[env], how[env]
        infos = [
            {"crashed": bool(e and h == "crash"), "TimeLimit.truncated": bool(e and h == "timeout")}
            for e, h in zip(end, how, strict=True)
        ]
        action = np.stack([self.episode, self.index], axis=1).astype(np.float32)
        reward = -(100.0 * self.episode + self.index)
        observation = self.observation(self.index)
        next_observation = self.observation(self.index + 1)
        transition = observation, next_observation, action, reward, end, infos
        self.index += 1
        self.episode[end] += 1
        self.index[end] = 0
        return transition


def make(size=100, n_envs=1, reward=REWARD, **options):
    return HerBuffer(size, *SPACES, device="cpu", n_envs=n_envs, reward=reward, **options)


def fill(transitions, steps, *buffers):
    for _ in range(steps):
        transition = next(transitions)
        for buffer in buffers:
            buffer.add(*transition)


def pair(size, n_envs, steps, seed=0, **keywords):
    """Our buffer and Stable-Baselines3's, with the same transitions."""
    ours, env = make(size, n_envs, **keywords), ParkingVecEnv(ENV, n_envs)
    theirs = HerReplayBuffer(size, *SPACES, env=env, device="cpu", n_envs=n_envs)
    fill(Transitions(n_envs, seed), steps, ours, theirs)
    return ours, theirs


def drawable(ours):
    """Indices of the transitions that may be drawn."""
    episodes = ours.episodes
    ranges = [(env, range(episodes.tail[env], episodes.head[env])) for env in range(ours.n_envs)]
    return sorted(
        int(episodes.index(np.array(step), env)) for env, steps in ranges for step in steps
    )


def records_of(ours, index):
    return ours.storage.take(index).records


def batch_of(ours, index, goal_index=NO_GOALS):
    return ours._make_minibatch(ours.storage.take(np.asarray(index)), np.asarray(goal_index))


def assert_equal(ours, theirs):
    torch.testing.assert_close(ours[:5], theirs[:5], rtol=0, atol=0)


def assert_same_batches(ours, theirs, index, goal_index):
    """Both buffers give the same real transitions, and the same with these virtual goals."""
    goals = theirs.next_observations["achieved_goal"].reshape(-1, 6)
    theirs._sample_goals = lambda *_: goals[goal_index]
    at = np.divmod(index, ours.n_envs)
    assert_equal(batch_of(ours, index, goal_index), theirs._get_virtual_samples(*at))
    assert_equal(batch_of(ours, index), theirs._get_real_samples(*at))


@pytest.mark.parametrize("n_envs", [1, 8])
@pytest.mark.parametrize("steps", [30, 95, 613])
def test_given_the_same_indices_batches_are_stable_baselines3s(n_envs, steps):
    """Before the buffer is full, and after it was overwritten several times."""
    ours, theirs = pair(100, n_envs, steps)
    rng = np.random.default_rng(1)
    index = rng.choice(drawable(ours), 64)
    ours.rng = rng
    goal_index = ours.select_goals(index, records_of(ours, index))
    assert_same_batches(ours, theirs, index, goal_index)
    mixed = batch_of(ours, index, goal_index[13:])
    real = batch_of(ours, index)
    for part in ("actions", "rewards", "dones"):  # a batch has its real transitions first
        assert torch.equal(getattr(mixed, part)[:13], getattr(real, part)[:13])


@settings(max_examples=60, deadline=None)
@given(
    n_envs=st.sampled_from([1, 3]),
    rows=st.integers(9, 40),
    steps=st.integers(1, 150),
    seed=st.integers(0, 1000),
)
def test_the_same_transitions_can_be_drawn(n_envs, rows, steps, seed):
    """After any number of steps: Stable-Baselines3 scans for them, we keep two numbers an env."""
    ours, theirs = pair(rows * n_envs, n_envs, steps, seed)
    index = np.array(drawable(ours), int)
    assert index.tolist() == np.flatnonzero(theirs.ep_length > 0).tolist()
    record = records_of(ours, index)
    np.testing.assert_array_equal(record["start"] % rows, theirs.ep_start.ravel()[index])
    np.testing.assert_array_equal(record["length"], theirs.ep_length.ravel()[index])
    assert len(ours.episodes) == theirs.size() * n_envs


def test_an_episode_longer_than_the_buffer_keeps_its_end():
    ours, transitions = make(size=10), Transitions(1, longest=10**9)
    fill(transitions, 24, ours)
    *transition, _, infos = next(transitions)
    ours.add(*transition, np.array([True]), infos)
    drawn = ours.sample(5000)
    assert set(drawn.actions[:, 1].tolist()) == set(range(15, 25))
    assert set(drawn.observations["desired_goal"][1000:, 0].tolist()) == set(range(16, 26))
    # The next transition overwrites the beginning of the episode, which is forgotten as a whole.
    ours.add(*next(transitions))
    assert drawable(ours) == []


@pytest.mark.parametrize("n_envs", [1, 8])
@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_indices_are_drawn_from_stable_baselines3s_distribution(strategy, n_envs):
    """Transition and goal index together, 200,000 draws, by a two-sample chi-square test."""
    steps = 150 if n_envs == 1 else 25  # the buffer has been overwritten in part
    ours, theirs = pair(100, n_envs, steps, goal_selection_strategy=strategy)
    theirs.goal_selection_strategy = type(theirs.goal_selection_strategy)[strategy.upper()]
    np.random.seed(0)
    ours.rng = np.random.default_rng(0)
    n = 200_000
    our_index = ours.episodes.sample(ours.rng, n)
    our_goals = ours.select_goals(our_index, records_of(ours, our_index))
    valid = np.flatnonzero(theirs.ep_length > 0)
    other = np.random.choice(valid, n)
    position = np.arange(theirs.buffer_size * n_envs, dtype=float).reshape(-1, n_envs)
    theirs.next_observations["achieved_goal"] = position
    their_goals = theirs._sample_goals(*np.divmod(other, n_envs)).astype(int)
    pairs = position.size
    our_counts = np.bincount(our_index * pairs + our_goals, minlength=pairs**2)
    their_counts = np.bincount(other * pairs + their_goals, minlength=pairs**2)
    seen = our_counts + their_counts > 0
    table = np.stack([our_counts[seen], their_counts[seen]])
    assert table.min() > 0, "one of the two draws what the other never does"
    assert stats.chi2_contingency(table).pvalue > 1e-3
    assert stats.chisquare(np.bincount(our_index, minlength=pairs)[valid]).pvalue > 1e-3


def test_random_takes_goals_from_everything_stored():
    """From episodes under way too, all with the same probability."""
    ours, _ = pair(100, 8, 25, goal_selection_strategy="random")
    ours.rng = np.random.default_rng(0)
    drawn = ours.episodes.sample(ours.rng, 100_000)
    goals = ours.select_goals(drawn, records_of(ours, drawn))
    counts = np.bincount(goals)
    assert len(counts) == 12 * 8
    assert stats.chisquare(counts).pvalue > 1e-3
    assert abs(np.corrcoef(drawn, goals)[0, 1]) < 0.02


class Drawn:
    """A relabelled transition of a batch, and where it comes from by its fields."""

    def __init__(self, batch, row, ends):
        achieved = batch.observations["achieved_goal"][row].int().tolist()
        self.index, self.env, _, self.episode, *_ = achieved
        self.goal = batch.observations["desired_goal"][row].numpy()
        self.reward = batch.rewards[row].item()
        self.done = batch.dones[row].item()
        self.last, self.how = ends[self.env, self.episode]
        self.is_last = self.index == self.last
        self.has_ended = self.is_last and self.how != "timeout"
        self.is_crash = self.is_last and self.how == "crash"
        # The virtual goal is the goal achieved before transition `goal_index`.
        self.goal_index = self.goal[0]
        self.has_own_goal = self.goal_index == -1
        self.leads_to_crash = self.how == "crash" and self.goal_index == self.last + 1

    def achieved(self, index):
        """The goal achieved before a transition of its episode."""
        return np.array([index, self.env, index, self.episode, 0, 0.0])


@pytest.mark.parametrize("strategy", ["future", "episode"])
@pytest.mark.parametrize(
    ("n_envs", "offset"),
    slow_but([(8, 0)], [(1, 5), (8, 0)], several=True),
    ids=["wide", "compact"],
)
@pytest.mark.parametrize("velocity", ["achieved", "zero"])
@pytest.mark.parametrize("collision", ["keep", "sb3", "exclude"])
@pytest.mark.parametrize("terminated", ["sb3", "goal", "goal_and_crash", "env"])
@pytest.mark.parametrize("reward", slow_but([REWARD], [REWARD, SPARSE]), ids=["dense", "sparse"])
def test_what_every_relabelled_transition_carries(
    reward, n_envs, offset, velocity, collision, terminated, strategy
):
    """Goal, reward, end and crash, worked out from the fields, after wrap-around."""
    ours = make(
        size=40 * n_envs,
        n_envs=n_envs,
        reward=reward,
        goal_selection_strategy=strategy,
        relabel_collision=collision,
        relabel_terminated=terminated,
        goal_velocity=velocity,
    )
    transitions = Transitions(n_envs, offset=offset)
    fill(transitions, 333, ours)
    assert ours.storage.compact == (offset == 0)

    # With `env`, the virtual goal may be reached where the transition begins.
    may_begin_at_goal = terminated == "env" and strategy == "episode"
    n_own_goals = 0
    cases = set()
    for _ in range(5):
        batch = ours.sample(100)
        for row in range(20, 100):
            drawn = Drawn(batch, row, transitions.ends)
            if drawn.has_own_goal:
                # A virtual goal is a crash where it is the last of an episode that ended so.
                may_be_crash = collision == "exclude" and drawn.how == "crash"
                assert may_be_crash or may_begin_at_goal
                assert drawn.reward == -(100.0 * drawn.episode + drawn.index)
                assert drawn.done == drawn.has_ended
                n_own_goals += 1
                continue

            velocity_of_goal = (0, 0) if velocity == "zero" else (drawn.goal_index, drawn.episode)
            assert drawn.goal[1:].tolist() == [drawn.env, *velocity_of_goal, 0, 0]
            assert drawn.index < drawn.goal_index or strategy == "episode"
            assert drawn.goal_index <= drawn.last + 1
            if collision == "exclude":
                assert not drawn.is_crash
                assert not drawn.leads_to_crash
            if terminated == "env":
                assert not reward(drawn.achieved(drawn.index), drawn.goal)[1]

            goal_reward, reached = reward(drawn.achieved(drawn.index + 1), drawn.goal)
            assert reached == (drawn.goal_index == drawn.index + 1)
            penalty = 0.0
            if drawn.is_crash and collision == "keep":
                penalty = -20.0 if reward is SPARSE else -5.0
            assert drawn.reward == np.float32(goal_reward + penalty)
            ends = {"sb3": drawn.has_ended, "goal": reached}
            assert drawn.done == ends.get(terminated, reached or drawn.is_crash)
            cases.add((bool(reached), drawn.is_crash))

    assert ours.real_share == (100 + n_own_goals) / 500
    assert len(cases) > 1
    assert (n_own_goals > 0) == (collision == "exclude" or may_begin_at_goal)


@pytest.mark.parametrize("n_envs", [1, 8])
def test_without_a_strategy_everything_stored_is_drawn_as_it_is(n_envs, monkeypatch):
    """As in DictReplayBuffer, at every step, also of episodes that are half overwritten."""
    ours = make(size=12 * n_envs, n_envs=n_envs, goal_selection_strategy=None)
    theirs = DictReplayBuffer(12 * n_envs, *SPACES, device="cpu", n_envs=n_envs)
    transitions = Transitions(n_envs)
    for _ in range(150):
        fill(transitions, 1, ours, theirs)
        index = np.arange(len(ours.episodes))
        row, env = np.divmod(index, n_envs)
        # Their draw of the envs.
        monkeypatch.setattr(np.random, "randint", lambda *_, env=env, **__: env)
        assert_equal(batch_of(ours, index), theirs._get_samples(row))
    ours.rng = np.random.default_rng(0)
    batch = ours.sample(20_000)
    drawn = (
        batch.observations["observation"][:, 1] * 1e6
        + batch.actions[:, 0] * 1000
        + batch.actions[:, 1]
    )
    _, counts = np.unique(drawn.numpy(), return_counts=True)
    assert len(counts) == 12 * n_envs
    assert stats.chisquare(counts).pvalue > 1e-3
    assert ours.real_share == 1.0


def test_the_number_of_real_transitions_is_rounded_as_in_stable_baselines3():
    """Of a batch of 256, int(n / (n + 1) * 256) are virtual."""
    for n_sampled_goal, real in ((1, 128), (2, 86), (4, 52), (8, 29)):
        ours, _ = pair(100, 1, 60, n_sampled_goal=n_sampled_goal)
        assert int((ours.sample(256).observations["desired_goal"][:, 0] == -1).sum()) == real
        assert ours.real_share == real / 256


@pytest.mark.parametrize(("at", "changed"), [(0, "next_obs"), (57, "obs")])
def test_goals_that_change_within_an_episode_and_other_achieved_goals(at, changed, tmp_path):
    """From such a transition on, all is stored with each; batches are Stable-Baselines3's."""
    ours, theirs = pair(200, 2, 0)
    transitions = Transitions(2)
    for step in range(170):
        obs, next_obs, *rest = next(transitions)
        if step >= at:
            goals = obs if changed == "obs" else next_obs
            goals["desired_goal"] = goals["desired_goal"] + step
            next_obs["achieved_goal"] = next_obs["achieved_goal"] + 0.5
        assert ours.storage.data.dtype.itemsize == (112 if step <= at else 304)
        for buffer in (ours, theirs):
            buffer.add(obs, next_obs, *rest)
    index = np.array(drawable(ours))
    assert_same_batches(ours, theirs, index, index[::-1])
    other = make(200, 2)
    other.set_state(ours.get_state())
    assert_equal(ours.sample(64), other.sample(64))


@pytest.mark.parametrize("strategy", ["futur", GoalSelectionStrategy.FUTURE])
def test_a_strategy_that_is_none_of_the_four_is_refused(strategy):
    with pytest.raises(ValueError, match=r"give one of future, final, episode, random, or None$"):
        make(goal_selection_strategy=strategy)


def test_before_the_first_episode_has_ended_there_is_nothing_to_draw():
    ours = make()
    fill(Transitions(1, longest=10**9), 1, ours)
    with pytest.raises(RuntimeError, match="learning_starts"):
        ours.sample(1)
