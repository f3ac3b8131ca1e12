"""The config of `scripts/report.py`, checked before anything is read."""

import re
from typing import Annotated, Literal

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.schema import OutputConfig, StoreConfig
from parking_exp.config.validate import parse_config
from parking_exp.config_model import ConfigModel, NonEmptyText
from parking_exp.errors import ConfigError
from parking_exp.phrases import did_you_mean


class ReportOptions(ConfigModel):
    """The `report` group."""

    quick: bool
    formats: list[Literal["svg", "png"]]
    sections: list[str]


class ReportRequest(OutputConfig):
    """The config of scripts/report.py."""

    experiment_name: str | list[str] | None
    source: NonEmptyText | None = Field(alias="from")
    export: NonEmptyText | None
    cells: str | list[str] | None
    baseline: str | None
    contrast: str | None
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$", max_length=200)] | None
    tracking: StoreConfig
    report: ReportOptions

    @property
    def experiments(self) -> list[str] | None:
        """Names of experiments, None for all."""
        name = self.experiment_name
        return [name] if isinstance(name, str) else name

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
    """Return the checked request of `scripts/report.py`.

    Raises:
        ConfigError: a key is wrong, or keys do not fit together.
    """
    request = parse_config(ReportRequest, config)
    if request.source:
        store_keys = {
            "experiment": request.experiments,
            "tracking.uri": request.tracking.uri,
            "export": request.export,
        }
        for key, value in store_keys.items():
            if value:
                _refuse_both(key, f"from={request.source}")
    if request.contrast is not None:
        if request.baseline is not None:
            _refuse_both("contrast", f"baseline={request.baseline}")
        if not re.fullmatch(r"[^:]+:.+-.+", request.contrast):
            raise ConfigError(
                f"contrast={request.contrast}: write a factor and two of its levels, e.g. "
                "contrast=buffer:her_future-replay"
            )
    for text in request.cells_asked:
        key, is_condition, _ = text.partition("=")
        hint = did_you_mean(key, KEYS, cutoff=0.75)  # `form` and `from` have this ratio
        if is_condition and hint and key not in KEYS:
            raise ConfigError(f"{key}: there is no such key{hint}")
    return request


def _refuse_both(key: str, override: str) -> None:
    raise ConfigError(f"{key}: cannot be combined with {override}; leave one of them out")
