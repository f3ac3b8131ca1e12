"""The schema of a search: its space, objective, sampler, pruner and seeds."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from parking_exp.config.credentials import keep_password
from parking_exp.config.paths import absolute
from parking_exp.config.schema import ConfigModel, Count, Name, Positive

Objective = Literal["success_auc", "final_success", "final_parked"]
Sampler = Literal["tpe", "random"]
Pruner = Literal["median", "hyperband"]
Value = bool | int | float | str | None | list[Any] | dict[str, Any]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Seeds = Annotated[list[Annotated[int, Field(ge=0, lt=2**32)]], Field(min_length=1)]
TUNING_KEYS = frozenset({"search", "n_trials", "n_workers", "storage"})
"""Keys of `conf/tune.yaml` beside those of a run."""
Storage = Annotated[str, AfterValidator(lambda uri: absolute(keep_password(uri)))]
"""URI of Optuna's storage, without the password; `with_password` has that where the storage is opened."""


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


class Dimension(ConfigModel):
    """The range or choices of one key, in one of five forms, and the condition under which it is sampled.

    Attributes:
        log: lowest and highest value, on a log scale.
        uniform: lowest and highest value.
        one_minus_log: lowest and highest value, with one minus it on a log scale, for values close below 1.
        int: lowest and highest whole number.
        choices: values, or options of a group.
        when: key -> values of that key with which this one is sampled; other trials keep the config's own value.
    """

    log: Range | None = None
    uniform: Range | None = None
    one_minus_log: Range | None = None
    whole: Annotated[list[int], Field(min_length=2, max_length=2)] | None = Field(default=None, alias="int")
    choices: Annotated[list[Value], Field(min_length=1)] | None = None
    when: dict[str, Annotated[list[Value], Field(min_length=1)]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [form for form in ("log", "uniform", "one_minus_log", "whole", "choices") if getattr(self, form)]
        if len(given) != 1:
            raise ValueError("takes one of log, uniform, one_minus_log, int and choices")
        if given[0] == "choices":
            return self
        low, high = self.bounds
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"has no room between {low} and {high}; write [lowest, highest]")
        if given[0] == "log" and low <= 0:
            raise ValueError(f"is on a log scale, and {low} is not above 0")
        if given[0] == "one_minus_log" and high >= 1:
            raise ValueError(f"has one minus the value on a log scale, and {high} is not below 1")
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest value, of a range."""
        low, high = self.log or self.uniform or self.one_minus_log or self.whole or (0, 0)
        return low, high

    @property
    def ends(self) -> list[Any]:
        """Values to validate: both ends of a range, or every choice."""
        return self.choices if self.choices is not None else list(self.bounds)


class SearchConfig(ConfigModel):
    """The `search` group; values and comments stand in `conf/search/shared/defaults.yaml`."""

    name: Name
    space: dict[str, Dimension]
    objective: Annotated[list[Objective], Field(min_length=1), BeforeValidator(_as_list)]
    sampler: Sampler
    pruner: Pruner | None
    grace_updates: Count
    tuning_seeds: Seeds
    test_seeds: Seeds
    n_retest: Count
    enqueue: list[dict[str, Value]]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.space:
            raise ValueError("space is empty; give it at least one key, e.g. algorithm.gamma: {uniform: [0.9, 0.99]}")
        if shared := set(self.tuning_seeds) & set(self.test_seeds):
            raise ValueError(
                f"seed {min(shared)} is among tuning_seeds and test_seeds; the best are tried on fresh seeds"
            )
        for name in ("tuning_seeds", "test_seeds"):
            if len(set(getattr(self, name))) < len(getattr(self, name)):
                raise ValueError(f"{name} has a seed twice")
        if "seed" in self.space or "seeds" in self.space:
            raise ValueError("space has seeds; tuning_seeds are those that every trial is trained on")
        self._check_conditions()
        if self.pruner and len(self.objective) > 1:
            raise ValueError(
                f"pruner={self.pruner} takes one objective, and there are {len(self.objective)}; write null"
            )
        return self

    def _check_conditions(self) -> None:
        for key, dimension in self.space.items():
            for other, values in dimension.when.items():
                if other not in self.space:
                    raise ValueError(f"space.{key}.when names {other}, which the space does not have")
                choices = self.space[other].choices
                if choices is not None and (unknown := [one for one in values if one not in choices]):
                    raise ValueError(f"space.{key}.when: {other} is never {unknown[0]}; its choices are {choices}")


class TuneRequest(ConfigModel):
    """The keys of scripts/tune.py beside those of a run."""

    search: SearchConfig
    n_trials: Positive
    n_workers: Positive | None
    storage: Storage | None
