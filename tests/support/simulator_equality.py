"""Simulator and highway-env, side by side: the same scenes, the same actions, every step
compared.
"""

import numpy as np

from parking_exp.config.compose import compose
from parking_exp.tasks.parking.geometry import SLOT_HEADINGS, SLOT_POSITIONS
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.simulator import Simulator

TOLERANCE = 1e-9
KINDS = ("random", "biased", "gentle", "trained")


def actions_of(kind, rng, shape, policy=None):
    """A function of the step's observations and rows -> actions, of one kind for all scenes."""
    bias = rng.uniform(-1, 1, shape)
    # Mostly full throttle or full brake: early crashes.
    bias[:, 0] = np.sign(bias[:, 0]) * np.abs(bias[:, 0]) ** 0.3

    def act(observation, rows):
        size = (len(rows), shape[1])
        if kind == "random":
            actions = rng.uniform(-1, 1, size)
        elif kind == "biased":
            # Beyond [-1, 1] now and then, to be clipped.
            actions = bias[rows] + rng.normal(0, 0.3, size)
        elif kind == "gentle":
            actions = rng.uniform(-0.2, 0.2, size)
        else:
            actions = policy(observation) + rng.normal(0, 0.05, size)
        return actions.astype(np.float32)

    return act


def compare(config, scenes, act):
    """Run whole episodes in the simulator, repeat them in highway-env; return the number of steps
    and what differed.
    """
    starts, records = record(config, scenes, act)
    return sum(len(steps) for steps in records), repeat(config, scenes, starts, records)


def find_mismatches(config, kind, n_scenes, policy=None):
    """Return what differs in whole episodes of the first scenes, with one kind of actions."""
    act = actions_of(kind, np.random.default_rng(1), (n_scenes, 2), policy)
    n_steps, different = compare(config, range(n_scenes), act)
    assert n_steps > 3 * n_scenes
    return different


def record(config, scenes, act):
    """Run whole episodes in the simulator; return first observations, and (action, observation,
    reward, flags) of steps.
    """
    simulator = Simulator(config, lot_of(config).from_seeds(scenes))
    records = [[] for _ in scenes]
    rows = np.arange(len(scenes))
    observation = simulator.observe()
    starts = {key: value.copy() for key, value in observation.items()}
    while len(rows):
        actions = act(observation, rows)
        step = simulator.step(actions)
        for number, row in enumerate(rows):
            observed = {key: value[number] for key, value in step.observation.items()}
            reward, *flags = [values[number] for values in step[1:]]
            records[row].append((actions[number], observed, reward, flags))
        done = step.terminated | step.truncated
        simulator.keep(~done)
        rows = rows[~done]
        observation = {key: value[~done] for key, value in step.observation.items()}
    return starts, records


def repeat(config, scenes, starts, records):
    """Repeat recorded episodes in highway-env; return what differed, at most one entry for each
    scene.
    """
    env = make_parking_env(config)
    mismatches = []
    for row, scene in enumerate(scenes):
        first, _ = env.reset(seed=int(scene))
        if any((first[key] != starts[key][row]).any() for key in first):
            mismatches.append((scene, 0, "start"))
        for number, (action, observed, reward, flags) in enumerate(records[row], start=1):
            theirs, their_reward, terminated, truncated, info = env.step(action)
            far = max(np.abs(theirs[key] - observed[key]).max() for key in theirs)
            same_flags = flags == [terminated, truncated, info["crashed"], info["is_success"]]
            if not (far <= TOLERANCE and abs(their_reward - reward) <= TOLERANCE and same_flags):
                mismatches.append((scene, number, far, reward, their_reward, flags))
                break
    return mismatches


def different_scenes(seeds, vehicles):
    """Seeds whose scenes are not what highway-env makes of them."""
    different = []
    config = compose(f"env.vehicles_count={vehicles}").env
    env = make_parking_env(config).unwrapped
    scenes = lot_of(config).from_seeds(seeds)
    for row, seed in enumerate(seeds):
        env.reset(seed=seed)
        objects = [env.vehicle.goal, *env.road.vehicles[1:]]
        poses = [(*item.position, item.heading) for item in objects]
        slots = [scenes.goal[row], *scenes.vehicles[row]]
        expected = [(*SLOT_POSITIONS[slot], SLOT_HEADINGS[slot]) for slot in slots]
        if poses != expected or env.vehicle.heading != scenes.heading[row]:
            different.append(seed)
    return different
