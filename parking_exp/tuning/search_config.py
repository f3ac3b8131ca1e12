"""The schema of a search: its space in the config and in Optuna, its sampler, pruner and seeds."""

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, NonNegativeInt, model_validator

from parking_exp.config.schema import SweepOptions
from parking_exp.config_model import Bounds, ConfigModel, Name, RunSeed, Two

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

DIGITS = 6  # sampled numbers are rounded, so that configs stay readable
HYPERPARAMETERS = ("algorithm", "buffer", "env", "n_envs", "updates_per_step")
"""Keys that a space may have: these, and keys of these groups."""
Value = bool | int | float | str | None | list[Any] | dict[str, Any]
NumberOfTrials = Annotated[int, Field(ge=1, le=100_000)]
Seeds = Annotated[list[RunSeed], Field(min_length=1)]


class Dimension(ConfigModel):
    """The range or choices of one key, in one of four forms.

    Attributes:
        log: lowest and highest value, on a log scale.
        uniform: lowest and highest value.
        whole: lowest and highest integer; `int` in YAML.
        choices: values, or options of a group.
    """

    log: Bounds | None = None
    uniform: Bounds | None = None
    whole: Two[int] | None = Field(default=None, alias="int")
    choices: Annotated[list[Value], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        forms = [self.log, self.uniform, self.whole, self.choices]
        if forms.count(None) != len(forms) - 1:
            raise ValueError("give exactly one of log, uniform, int and choices")
        self.distribution()  # refuses a wrong range
        return self

    @property
    def values_to_check(self) -> list[Any]:
        """Values to validate: both ends of a range, or every choice."""
        return self.choices or self.log or self.uniform or self.whole or []

    def __str__(self) -> str:
        """Describe the dimension as the YAML does: `log [0.001, 0.01]`."""
        ((form, ends),) = self.model_dump(by_alias=True, exclude_none=True).items()
        return f"{form} {ends}"

    def distribution(self) -> "BaseDistribution":
        """Return the dimension as Optuna's distribution."""
        from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

        if self.choices is not None:
            return CategoricalDistribution([_choice_text(choice) for choice in self.choices])
        low, high = self.values_to_check
        if self.whole:
            return IntDistribution(low, high)
        return FloatDistribution(low, high, log=self.log is not None)

    def to_parameter(self, value: Any) -> Any:
        """Return a config's value as Optuna's parameter, or None if it is outside the dimension."""
        if self.choices is not None:
            if value not in self.choices:
                return None
            return _choice_text(self.choices[self.choices.index(value)])
        low, high = self.values_to_check
        is_inside = isinstance(value, int | float) and low <= value <= high
        return value if is_inside else None

    def to_value(self, parameter: Any) -> Any:
        """Return Optuna's parameter as a config's value.

        Raises:
            KeyError: it is none of the choices.
        """
        if self.choices is not None:
            return {_choice_text(choice): choice for choice in self.choices}[parameter]
        return parameter if self.whole else float(f"{parameter:.{DIGITS}g}")


def _choice_text(choice: Any) -> str | float:
    """Return a choice as Optuna stores it: lists, mappings, booleans and null as JSON."""
    if isinstance(choice, str | int | float) and not isinstance(choice, bool):
        return choice
    return json.dumps(choice)


class SearchConfig(ConfigModel):
    """The `search` group; values and comments are in `conf/search/shared/defaults.yaml`."""

    name: Name
    space: Annotated[dict[str, Dimension], Field(min_length=1)]
    sampler: Literal["tpe", "random"]
    pruner: Literal["median"] | None
    tuning_seeds: Seeds
    test_seeds: Seeds
    n_retest: NonNegativeInt

    @model_validator(mode="after")
    def _check(self) -> Self:
        seeds = [*self.tuning_seeds, *self.test_seeds]
        if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
            raise ValueError(
                f"seed {twice[0]} occurs twice in tuning_seeds and test_seeds; all have to differ"
            )
        for key in self.space:
            if key.lstrip("+").partition(".")[0] not in HYPERPARAMETERS:
                raise ValueError(
                    f"space has {key}, which is not a hyperparameter; it may have n_envs, "
                    "updates_per_step, and keys or options of algorithm, buffer and env (seeds "
                    "are in tuning_seeds)"
                )
        return self


class TuneRequest(SweepOptions):
    """The keys of `conf/tune.yaml` beside the keys of a run."""

    search: SearchConfig
    n_trials: NumberOfTrials
    n_workers: Annotated[int, Field(ge=1, le=10_000)] | None


class SearchFile(ConfigModel):
    """The content of `search.json`, from which other commands read the search."""

    n_trials: NumberOfTrials
    search: SearchConfig
