"""A search: its settings, the config of each trial, its study."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from parking_exp.config.cell_labels import GROUPS
from parking_exp.config.compose import ComposedCell, compose_runs, hydra_ready
from parking_exp.config.overrides import in_quotes
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import parse_config, parse_plain, raise_problems, validate
from parking_exp.errors import ConfigError
from parking_exp.evaluation.init_sources import pin_source
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.foreign_files import read_object
from parking_exp.runs.lookup import LATEST
from parking_exp.tuning.search_config import SearchConfig, SearchFile, TuneRequest
from parking_exp.tuning.study import OpenStudy, as_store_error, open_storage, open_study
from parking_exp.tuning.trials import RetestedTrial, TrialRow, read_retest, read_trials

SEARCH_FILE = "search.json"
_COMPOSING = threading.Lock()  # Hydra's state is global, and workers are threads


@cache
def _compose_groups(overrides: tuple[str, ...], extra_config_dir: str | None) -> ComposedCell:
    """Compose a trial's groups."""
    runs = compose_runs("tune", list(overrides), extra_config_dir)
    if len(runs) > 1 or runs[0].seed is not None:
        raise ConfigError(
            "a search takes one value for each key, and its seeds as search.tuning_seeds"
        )
    return runs[0].cell


@dataclass(frozen=True)
class Search:
    """A search: the overrides of its command, and Hydra's `--config-dir`.

    A trial's changes map keys and groups to values: `{"algorithm": "td3", "algorithm.gamma":
    0.97}`.
    """

    overrides: Sequence[str]
    extra_config_dir: str | None = None

    def compose(self, changes: Mapping[str, Any]) -> ComposedCell:
        """Return the config of a trial as Hydra composes it, with the keys of scripts/tune.py.

        Raises:
            ConfigError: it does not compose, or the overrides are a sweep.
        """
        options = []
        values = {}
        for key, value in changes.items():
            if key in GROUPS:
                options.append(f"{key}={in_quotes(str(value))}")
            else:
                values[key] = value
        with _COMPOSING, hydra_ready():
            cell = _compose_groups((*self.overrides, *options), self.extra_config_dir)
            return cell.with_values(values)

    @cached_property
    def request(self) -> TuneRequest:
        """The keys of scripts/tune.py, checked."""
        config = self.compose({}).config
        if "search" not in config:
            raise ConfigError("search is missing; write search=NAME, e.g. search=smoke")
        return parse_config(TuneRequest, {key: config[key] for key in TuneRequest.model_fields})

    @cached_property
    def base(self) -> RunConfig:
        """The config that trials change, checked."""
        return self.config({})

    @property
    def folder(self) -> Path:
        """The experiment's folder, with the study."""
        return self.base.output_path / self.base.experiment_name

    def config(self, changes: Mapping[str, Any]) -> RunConfig:
        """Return the checked config of a trial; raises ConfigError if it can't run."""
        plain: Any = OmegaConf.to_container(self.compose(changes).config, resolve=True)
        for key in TuneRequest.model_fields:
            del plain[key]
        config = validate(plain)
        if config.init == LATEST:
            raise ConfigError("init=latest: name a run, so that all trials start from the same one")
        return pin_source(config)

    def check(self) -> None:
        """Check the space: every key, both ends of each range, and every choice.

        Raises:
            ConfigError: with a sentence for each of the first five things that are wrong.
        """
        space = self.request.search.space
        _ = self.base  # an error of the base config is reported once, not for each value
        problems = []
        for key, dimension in space.items():
            for changes in self._options_for(key):
                for value in dimension.values_to_check:
                    try:
                        self.config({**changes, key: value})
                    except ConfigError as error:
                        lines = str(error).splitlines()
                        problems += [f"search.space.{key}: {line}" for line in lines]
        raise_problems(problems)

    def _options_for(self, key: str) -> list[dict[str, Any]]:
        """Return the group options that a key is checked with, if its group is in the space."""
        group = key.partition(".")[0]
        dimension = self.request.search.space.get(group)
        if group == key or dimension is None:
            return [{}]
        return [{group: option} for option in dimension.values_to_check]

    def open(self) -> OpenStudy:
        """Return the study; create it, and its folder, if there is none yet."""
        cell = self.compose({})
        values = {}
        for key in self.request.search.space:
            values[key] = cell.options.get(key) or OmegaConf.select(cell.config, key.lstrip("+"))
        return open_study(self.folder, self.request.search, self.base, values, self._hash_options())

    def _hash_options(self) -> dict[str, str]:
        """Return a run key for each option that trials choose from.

        The key changes with the contents of the option's file.
        """
        keys = {}
        for group, dimension in self.request.search.space.items():
            if group not in GROUPS:
                continue
            for option in dimension.values_to_check:
                config = self.config({group: option}).model_copy(update={"seed": 0})
                keys[f"{group}={option}"] = config.run_key
        return keys

    def save(self) -> None:
        """Write `search.json`, from which other commands read the search."""
        stored = SearchFile(n_trials=self.request.n_trials, search=self.request.search)
        write_json(self.folder / SEARCH_FILE, stored.model_dump(by_alias=True))


@dataclass(frozen=True)
class StoredSearch:
    """A search as other commands read it from its folder, with its trials so far.

    Attributes:
        n_trials: number of trials requested.
        settings: its space, sampler, pruner and seeds.
        trials: trial 0 and those that have begun, by number.
        retested: trials that were trained again on test seeds, best first.
    """

    experiment: str
    n_trials: int
    settings: SearchConfig
    trials: Sequence[TrialRow]
    retested: Sequence[RetestedTrial] = ()


def read_search(folder: Path) -> StoredSearch | None:
    """Return the search of an experiment's folder; None without one.

    A `search.json` that holds no JSON object counts as none. The search's own command writes it
    anew.

    Raises:
        ConfigError: an entry is missing or wrong.
        StoreError: its trials are damaged.
        UntrustedError: see `open_storage`.
    """
    content = read_object(folder / SEARCH_FILE)
    if not content:
        return None
    import optuna

    stored = parse_plain(SearchFile, content)
    with as_store_error(folder.name):
        study = optuna.load_study(study_name=folder.name, storage=open_storage(folder))
        retested = read_retest(folder)
    return StoredSearch(
        experiment=folder.name,
        n_trials=stored.n_trials,
        settings=stored.search,
        trials=read_trials(study, folder, stored.search.space, stored.n_trials),
        retested=retested,
    )
