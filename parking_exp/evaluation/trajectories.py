"""Record the car's trajectories of an evaluation as `trajectories.npz`, which `results` reads."""

from pathlib import Path

import numpy as np

from parking_exp.runs.atomic_files import replacing

TRAJECTORIES_FILE = "trajectories.npz"
CAR_COLUMNS = ("x_m", "y_m", "heading_rad", "speed_mps")  # speed is signed


class Recorder:
    """Collects the cars of many scenes while they are stepped together."""

    def __init__(self) -> None:
        self._scenes: list[np.ndarray] = []
        self._cars: list[np.ndarray] = []

    def add(self, scenes: np.ndarray, cars: np.ndarray) -> None:
        """Add the start, or a step, of unfinished scenes: their numbers, shape (n,), and CAR_COLUMNS, shape (n, 4)."""
        self._scenes.append(scenes.copy())
        self._cars.append(cars.astype(np.float32))

    def save(self, path: Path) -> None:
        """Write an npz file: `scene`, sorted, and `length`, shape (n,), and CAR_COLUMNS of all scenes in turn."""
        rows, cars = np.concatenate(self._scenes), np.concatenate(self._cars)
        order = np.argsort(rows, kind="stable")  # rows of a scene stay in the order of time
        scene, length = np.unique(rows, return_counts=True)
        columns = dict(zip(CAR_COLUMNS, cars[order].T, strict=True))
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, scene=scene, length=length, **columns)
