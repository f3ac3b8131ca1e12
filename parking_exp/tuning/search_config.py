"""The schema of a search: its space, objective, sampler, pruner and seeds."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from parking_exp.config.credentials import keep_password, strip_password
from parking_exp.config.paths import absolute
from parking_exp.config.schema import ConfigModel, Count, Name, Positive, SweepOptions
from parking_exp.tuning.space import Dimension, Value

Objective = Literal["success_auc", "final_success", "final_parked"]
Seeds = Annotated[list[Annotated[int, Field(ge=0, lt=2**32)]], Field(min_length=1)]
Storage = Annotated[str, AfterValidator(lambda uri: absolute(keep_password(uri)))]
"""URI of Optuna's storage without the password, which `with_password` adds where the storage is opened."""


class SearchConfig(ConfigModel):
    """The `search` group; values and comments are in `conf/search/shared/defaults.yaml`."""

    name: Name
    space: Annotated[dict[str, Dimension], Field(min_length=1)]
    objective: Objective
    sampler: Literal["tpe", "random"]
    pruner: Literal["median"] | None
    grace_updates: Count
    tuning_seeds: Seeds
    test_seeds: Seeds
    n_retest: Count
    enqueue: list[dict[str, Value]]

    @model_validator(mode="after")
    def _check(self) -> Self:
        seeds = [*self.tuning_seeds, *self.test_seeds]
        if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
            raise ValueError(f"seed {twice[0]} occurs twice in tuning_seeds and test_seeds; all have to differ")
        if "seed" in self.space or "seeds" in self.space:
            raise ValueError("space has seeds; every trial is trained on tuning_seeds")
        return self


class TuneRequest(SweepOptions):
    """The keys of `conf/tune.yaml` beside those of a run."""

    search: SearchConfig
    n_trials: Positive
    n_workers: Positive | None
    storage: Storage | None


class SearchFile(ConfigModel):
    """The content of `search.json`, from which workers and other commands find the study and compose trials."""

    overrides: list[str] = Field(default_factory=list)
    extra_config_dir: str | None = None
    storage: Annotated[str, AfterValidator(strip_password)] | None = None
    n_trials: int
    search: SearchConfig
