"""The base of the `env` groups of all tasks: what the rest of the package needs from them."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from operator import not_
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field

from parking_exp.config_model import TRAINING_SEEDS_START, ConfigModel, Name


class TaskConfig(ConfigModel, ABC):
    """The `env` group of a task, chosen by its key `task`.

    Attributes:
        simulators: names that the key `simulator` may have, if there are several. The last is the
            reference that results are cross-checked on.
        agent_keys: keys that evaluation takes from an agent's training, e.g. what the agent
            observes.
        training_keys: keys that do not change the episodes of an evaluation.
        training_seeds: possible seeds of the first training env, from which the others count
            up. Seeds of evaluation are smaller.
    """

    simulators: ClassVar[tuple[str, ...]]
    agent_keys: ClassVar[tuple[str, ...]] = ()
    training_keys: ClassVar[tuple[str, ...]] = ()
    training_seeds: ClassVar[range] = range(TRAINING_SEEDS_START, 2 * TRAINING_SEEDS_START)

    task: Any
    name: Name
    # Stored configs and the names of evaluations leave out an empty list, too.
    metrics: Annotated[list[str] | None, Field(exclude_if=not_)] = None

    if TYPE_CHECKING:  # a key of some tasks, and fixed for others

        @property
        def simulator(self) -> str:
            """The simulator that trains."""

    @property
    def reference_simulator(self) -> str:
        """The simulator that results are cross-checked on."""
        return self.simulators[-1]

    def for_training(self) -> Self:
        """Return the config of training envs."""
        return self

    @property
    @abstractmethod
    def episode_steps(self) -> int | None:
        """The longest episode in steps; None where only the environment knows."""

    def overlap_problem(self, setting: str, first_seed: int, n_episodes: int) -> str | None:
        """Return why an evaluation would share episodes with training, or None.

        `setting` is the config key of its first seed.
        """
        start = self.training_seeds.start
        if first_seed + n_episodes <= start:
            return None
        return (
            f"{setting}={first_seed} overlaps the training seeds; it can be at most "
            f"{start - n_episodes}"
        )

    @property
    def imports(self) -> dict[str, str]:
        """Config keys that may make an env import a module or open a file, and their values."""
        return {f"metrics.{number}": path for number, path in enumerate(self.metrics or ())}

    def problems(self) -> Iterator[str]:
        """Yield a sentence for each rule between keys that is violated."""
        yield from ()

    def change_problems(self, changes: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence for each of the changes, by key, that evaluations can't make."""
        yield from ()

    def model_problems(self, features: str, buffer: Any) -> Iterator[str]:
        """Yield a sentence for each option of policy or buffer that the task does not support.

        `buffer` is the `buffer` group.
        """
        if features != "raw":
            yield (
                f"algorithm.features={features} is available for parking only; use "
                "algorithm.features=raw"
            )
        if buffer.arguments.get("relabel_collision") == "keep":
            yield (
                "buffer.relabel_collision=keep needs the penalty for a failure, which is unknown; "
                "use exclude or sb3"
            )
        if buffer.arguments.get("goal_velocity") == "zero":
            yield (
                "buffer.goal_velocity=zero needs to know which entries of a goal are velocities; "
                "use achieved"
            )
