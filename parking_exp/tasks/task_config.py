"""The base of the `env` groups of all tasks: what the rest of the package needs from them."""

from collections.abc import Iterator, Mapping
from operator import not_
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field

from parking_exp.config_model import TRAINING_SEEDS_START, ConfigModel, Name


class TaskConfig(ConfigModel):
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
    # Left out of stored configs and of the names of evaluations where there are none.
    metrics: Annotated[list[str] | None, Field(exclude_if=not_)] = None

    if TYPE_CHECKING:  # a key of some tasks, and fixed for others

        @property
        def simulator(self) -> str:
            """The simulator that trains."""

    def for_training(self) -> Self:
        """Return the config of training envs."""
        return self

    def episode_steps(self) -> int | None:
        """Return the longest episode in steps; None where only the environment knows."""
        raise NotImplementedError

    def overlap_problem(self, setting: str, first_seed: int, n_episodes: int) -> str | None:
        """Say why evaluation can't begin with a seed: its episodes would be training episodes.

        `setting` is the key of the seed, for the sentence.
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
        """Keys by which making an env may import a module or open a file, and their values."""
        return {f"metrics.{number}": path for number, path in enumerate(self.metrics or ())}

    def problems(self) -> Iterator[str]:
        """Yield a sentence for each rule between keys that is violated."""
        yield from ()

    def change_problems(self, changes: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence for each of the changes, by key, that evaluations can't make."""
        yield from ()

    def model_problems(self, features: str, buffer: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence for the policy's features, or an argument of the buffer, that the task
        does not support.
        """
        if features != "raw":
            yield (
                f"algorithm.features={features} is available for parking only; use "
                "algorithm.features=raw"
            )
        if buffer.get("relabel_collision") == "keep":
            yield (
                "buffer.relabel_collision=keep needs the penalty for a failure, which is unknown; "
                "use exclude or sb3"
            )
        if buffer.get("goal_velocity") == "zero":
            yield (
                "buffer.goal_velocity=zero needs to know which entries of a goal are velocities; "
                "use achieved"
            )
