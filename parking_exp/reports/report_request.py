"""The config of `scripts/report.py`, checked before anything is read."""

import re
from collections.abc import Sequence
from typing import Annotated, Literal

from omegaconf import DictConfig, OmegaConf
from pydantic import Field

from parking_exp.config.cell_labels import settings_of
from parking_exp.config.compose import compose_configs
from parking_exp.config.schema import OutputConfig, StoreConfig
from parking_exp.config.validate import parse
from parking_exp.config_model import ConfigModel
from parking_exp.errors import ConfigError, did_you_mean

SIMILAR = 0.8  # similarity from which on a key counts as misspelt


class ReportOptions(ConfigModel):
    """The `report` group."""

    quick: bool
    formats: list[Literal["svg", "png"]]


class ReportRequest(OutputConfig):
    """The config of scripts/report.py."""

    experiment_name: str | list[str] | None
    source: Annotated[str, Field(min_length=1)] | None = Field(alias="from")
    export: Annotated[str, Field(min_length=1)] | None
    cells: str | list[str] | None
    baseline: str | None
    contrast: str | None
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$", max_length=200)] | None
    tracking: StoreConfig
    report: ReportOptions

    @property
    def experiments(self) -> list[str] | None:
        """Names of experiments, None for all."""
        return (
            [self.experiment_name]
            if isinstance(self.experiment_name, str)
            else self.experiment_name
        )

    @property
    def cells_asked(self) -> list[str]:
        """Labels, patterns and conditions."""
        return [self.cells] if isinstance(self.cells, str) else self.cells or []


KEYS = {
    "experiment",
    "tracking.uri",
    *(field.alias or name for name, field in ReportRequest.model_fields.items()),
}
"""Keys of the command as users write them."""


def validate_report(config: DictConfig) -> ReportRequest:
    """Validate a composed config."""
    request = parse(ReportRequest, config)
    of_stores = {
        "experiment": request.experiments,
        "tracking.uri": request.tracking.uri,
        "export": request.export,
    }
    if request.source and (beside := [key for key, value in of_stores.items() if value]):
        raise ConfigError(
            f"{beside[0]}: cannot be combined with from={request.source}; leave one of them out"
        )
    if request.contrast is not None:
        _check_contrast(request.contrast, request.baseline)
    if keys := [text.partition("=")[0] for text in request.cells_asked if "=" in text]:
        _refuse_misspelt(keys)
    return request


def _check_contrast(contrast: str, baseline: str | None) -> None:
    if baseline is not None:
        raise ConfigError(
            f"contrast: cannot be combined with baseline={baseline}; leave one of them out"
        )
    if not re.fullmatch(r"[^:]+:.+-.+", contrast):
        example = "contrast=buffer:her_future-replay"
        raise ConfigError(
            f"contrast={contrast}: write a factor and two of its levels, e.g. {example}"
        )


def _refuse_misspelt(keys: Sequence[str]) -> None:
    """Refuse what is nearly a key of this command or of a run's config; the class of a run may have
    any arguments.
    """
    run = settings_of(OmegaConf.to_container(compose_configs("config", [])[0]))  # type: ignore[arg-type]
    known = set(KEYS)
    for path in (key.split(".") for key in run):
        known |= {
            ".".join(path[first:last])
            for first in range(len(path))
            for last in range(first + 1, len(path) + 1)
        }
    for key in keys:
        is_argument = key.startswith(("algorithm.", "buffer."))
        if (
            key not in known
            and not is_argument
            and (hint := did_you_mean(key, known, cutoff=SIMILAR))
        ):
            raise ConfigError(f"{key}: there is no such key{hint}")
