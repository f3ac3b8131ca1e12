"""Scenes: the initial states of episodes."""

from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.geometry import WALL_THICKNESS_M

NO_SLOT = -1  # the slot of an absent car, where a scene has fewer than others
FAR_M = 1e6  # cars farther away than this count as absent
MOST_SCENES = 10**7  # of a batch; arrays that are equal in all scenes are views of this length


def scene_rng(seed: int) -> np.random.Generator:
    """Return the generator that `env.reset(seed=seed)` samples a scene from.

    It equals the generator of gymnasium's `np_random(seed)`. Reports use it without gymnasium.
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(seed))))


@dataclass(frozen=True)
class Scenes:
    """A batch of n scenes. A pose is x, y and heading [m, m, rad]; slots are numbered."""

    start: np.ndarray  # pose of the car, shape (n, 3)
    goal: np.ndarray  # goal slots, shape (n,)
    # Slots of the parked cars, in their order on the road, NO_SLOT for none, shape (n, vehicles)
    vehicles: np.ndarray
    obstacles: np.ndarray  # places of the obstacles, shape (n, obstacles, 2) [m]
    slots: np.ndarray  # poses of all slots, shape (n, slots, 3)
    slot_size: np.ndarray  # their length and width, shape (n, 2) [m]
    box: np.ndarray  # length and width between the centre lines of the walls, shape (n, 2) [m]

    def __len__(self) -> int:
        return len(self.goal)

    @property
    def heading(self) -> np.ndarray:
        """The car's heading at the start, shape (n,) [rad]."""
        return self.start[:, 2]

    @property
    def free(self) -> np.ndarray:
        """Half the space between the walls' inner faces, shape (2, n) [m]."""
        return (self.box.T - WALL_THICKNESS_M) / 2

    @property
    def goal_pose(self) -> np.ndarray:
        """Poses of the goal slots, shape (n, 3)."""
        return self.slots[np.arange(len(self)), self.goal]

    @property
    def vehicle_pose(self) -> np.ndarray:
        """Poses of the parked cars, shape (n, vehicles, 3); those at NO_SLOT are far away."""
        poses = self.slots[np.arange(len(self))[:, None], self.vehicles]
        row, vehicle = np.nonzero(self.vehicles == NO_SLOT)
        poses[row, vehicle, 0] = 2 * FAR_M * (1 + vehicle)  # apart from each other
        return poses
