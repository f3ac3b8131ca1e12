"""A search as its processes share it: its settings, the config of each trial, its study."""

import copy
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import OmegaConf

from parking_exp.config.compose import Composed, composed_runs, hydra_ready
from parking_exp.config.overrides import as_hydra, in_quotes
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import check, parse, validate
from parking_exp.errors import ConfigError
from parking_exp.runs.atomic_files import read_object, write_json
from parking_exp.tuning.search_config import SearchConfig, SearchFile, TuneRequest
from parking_exp.tuning.study import OpenStudy, open_study, storage_errors, storage_of
from parking_exp.tuning.trials import TrialRow, rows

if TYPE_CHECKING:
    from optuna import Study

SEARCH_FILE = "search.json"
_COMPOSING = threading.Lock()  # Hydra's state is global, and workers are threads


@dataclass(frozen=True)
class Search:
    """A search: the overrides of its command, and Hydra's `--config-dir`.

    A trial's changes map keys and groups to values: `{"algorithm": "td3", "algorithm.gamma": 0.97}`.
    """

    overrides: Sequence[str]
    extra_config_dir: str | None = None

    def compose(self, changes: Mapping[str, Any]) -> Composed:
        """Return the config of a trial as Hydra composes it, with the keys of scripts/tune.py.

        Raises:
            ConfigError: it does not compose, or the overrides are a sweep.
        """
        with _COMPOSING, hydra_ready():
            groups = self._compose_options(()).options
            options = tuple(f"{key}={in_quotes(str(value))}" for key, value in changes.items() if key in groups)
            composed = copy.deepcopy(self._compose_options(options))
            for key, value in changes.items():
                if key not in groups:
                    name, is_added = key.lstrip("+"), key.startswith("+")
                    OmegaConf.update(composed.cell, name, value, merge=True, force_add=is_added)
        return composed

    @cached_property
    def _compositions(self) -> dict[tuple[str, ...], Composed]:
        """Composed configs by the options that trials choose; Hydra takes 0.2 s for each, setting a key 3 ms."""
        return {}

    def _compose_options(self, options: tuple[str, ...]) -> Composed:
        if options not in self._compositions:
            runs = composed_runs("tune", [*self.overrides, *options], self.extra_config_dir)
            if len(runs) > 1 or runs[0].seed is not None:
                raise ConfigError("a search takes one value for each key, and its seeds as search.tuning_seeds")
            self._compositions[options] = runs[0]
        return self._compositions[options]

    @cached_property
    def request(self) -> TuneRequest:
        """The keys of scripts/tune.py, checked."""
        cell = self.compose({}).cell
        if "search" not in cell:
            raise ConfigError("search is missing; write search=NAME, e.g. search=smoke")
        return parse(TuneRequest, {key: cell[key] for key in TuneRequest.model_fields})

    @cached_property
    def base(self) -> RunConfig:
        """The config that trials change, checked."""
        return self.config({})

    @property
    def folder(self) -> Path:
        """The experiment's folder, with the study."""
        return self.base.output_path / self.base.experiment_name

    def config(self, changes: Mapping[str, Any]) -> RunConfig:
        """Return the checked config of a trial.

        Raises:
            ConfigError: it can't run, or a change is not in the space: a study of somebody else may name any class.
        """
        settings = self.request.search
        if changes and changes not in settings.enqueue:
            for key, value in changes.items():
                if key not in settings.space or not settings.space[key].allows(value):
                    raise ConfigError(f"{key}={value!r} is not in search.space")
        plain = cast(dict[str, Any], OmegaConf.to_container(self.compose(changes).cell, resolve=True))
        return validate({key: value for key, value in plain.items() if key not in TuneRequest.model_fields})

    def values(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of each key of the space in the config of a trial."""
        composed, space = self.compose(changes), self.request.search.space
        return {key: composed.options.get(key) or OmegaConf.select(composed.cell, key.lstrip("+")) for key in space}

    def check(self) -> None:
        """Check the space: every key, both ends of each range, every choice, and what is enqueued.

        Raises:
            ConfigError: with a sentence for each of the first five things that are wrong.
        """
        space, enqueue = self.request.search.space, self.request.search.enqueue
        assert self.base  # its errors are reported once
        overridden = {line.partition("=")[0].lstrip("+~") for line in self.overrides}
        twice = (key for key in space if key in overridden)
        problems = [f"{key} is both an override and a key of search.space; remove one of them" for key in twice]
        to_check = [(f"search.enqueue.{number}", changes) for number, changes in enumerate(enqueue)]
        for key, dimension in space.items():
            group = key.partition(".")[0]
            options = space[group].choices if group != key and group in space else None
            for context in [{group: option} for option in options or []] or [{}]:
                to_check += [(f"search.space.{key}", {**context, key: value}) for value in dimension.ends]
        for place, changes in to_check:
            try:
                self.config(changes)
            except ConfigError as error:
                problems += [f"{place}: {line}" for line in str(error).splitlines()]
        if problems:
            raise ConfigError("\n".join(dict.fromkeys(problems[:5])))

    def open(self) -> OpenStudy:
        """Return the study; create it, and its folder, if there is none yet."""
        storage = storage_of(self.folder, self.request.storage)
        return open_study(self.folder, self.request.search, self.base, self.values, storage)

    def save(self) -> None:
        """Write `search.json`, from which workers and other commands load the search."""
        extra = self.extra_config_dir
        stored = SearchFile(
            # Workers may be started from another directory.
            overrides=[as_hydra(line) for line in self.overrides],
            extra_config_dir=extra and str(Path(extra).absolute()),
            storage=self.request.storage,
            n_trials=self.request.n_trials,
            search=self.request.search,
        )
        write_json(self.folder / SEARCH_FILE, stored.model_dump(by_alias=True))

    @classmethod
    def load(cls, folder: Path, storage: str | None) -> "Search":
        """Return the last search of an experiment's folder, with the caller's storage instead of the stored one."""
        stored = check(SearchFile, read_object(folder / SEARCH_FILE))
        own = [f"output_dir={in_quotes(str(folder.parent))}", f"storage={in_quotes(storage) if storage else 'null'}"]
        return cls([*stored.overrides, *own], stored.extra_config_dir)


@dataclass(frozen=True)
class StoredSearch:
    """A search as other commands read it from its folder: its settings, number of trials, study and trials so far."""

    search: SearchConfig
    n_trials: int
    study: "Study"
    trials: list[TrialRow]


def study_in(folder: Path, storage: str | None = None) -> StoredSearch | None:
    """Return the search of an experiment's folder; None without one.

    Args:
        folder: of the experiment.
        storage: as passed by the user; a database that only the folder's files name is not opened.

    Raises:
        ConfigError: its settings or its study are damaged, or the study is in another storage.
        StoreError: its storage fails.
        UntrustedError: see `storage_of`.
    """
    if not (content := read_object(folder / SEARCH_FILE)):
        return None
    stored = check(SearchFile, content)
    if stored.storage not in (None, storage):
        raise ConfigError(f"the study is in {stored.storage}; pass storage={stored.storage} to read it")
    import optuna

    with storage_errors(folder.name):
        try:
            study = optuna.load_study(study_name=folder.name, storage=storage_of(folder, stored.storage))
        except KeyError:  # it has not started yet
            return None
    return StoredSearch(stored.search, stored.n_trials, study, rows(study, folder, stored.n_trials))
