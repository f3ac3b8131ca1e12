"""A search as its processes share it: its settings, the config of each trial, its study."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from parking_exp.config.compose import Composed, composed_runs
from parking_exp.config.credentials import strip_password
from parking_exp.config.overrides import in_quotes, with_absolute_path
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import check, parse, validate
from parking_exp.errors import ConfigError, OutputDirectoryError, suggestion
from parking_exp.runs.files import read_object, write_json
from parking_exp.tuning.schema import TUNING_KEYS, SearchConfig, TuneRequest
from parking_exp.tuning.space import base_value, in_order
from parking_exp.tuning.study import OpenStudy, load_study, open_study, storage_of
from parking_exp.tuning.trials import TrialRow, rows

if TYPE_CHECKING:
    from optuna import Study

SEARCH_FILE = "search.json"
# Hydra's state is global: threads compose one after the other.
_COMPOSING = threading.Lock()


@dataclass(frozen=True)
class Search:
    """A search: the overrides of its command, and Hydra's `--config-dir`.

    The changes of a trial map keys and groups to values: `{"algorithm": "td3", "algorithm.gamma": 0.97}`.
    """

    overrides: Sequence[str]
    extra_config_dir: str | None = None
    _options: dict[tuple[str, ...], Composed] = field(default_factory=dict)

    @property
    def composed(self) -> Composed:
        """The config that trials change, with the keys of scripts/tune.py.

        Raises:
            ConfigError: it does not compose, or the overrides are a sweep.
        """
        return self._with_options([])

    def _with_options(self, lines: Sequence[str]) -> Composed:
        """Return the config with other options of groups, cached because composing takes tenths of a second."""
        with _COMPOSING:
            if (known := self._options.get(tuple(lines))) is not None:
                return known
            found = composed_runs("tune", [*self.overrides, *lines], self.extra_config_dir)
            if len(found) > 1 or found[0].seed is not None:
                raise ConfigError(
                    "a search takes one value for each key, and no seeds; search.tuning_seeds are those of its trials"
                )
            self._options[tuple(lines)] = found[0]
            return found[0]

    @cached_property
    def request(self) -> TuneRequest:
        """The keys of scripts/tune.py, checked.

        Raises:
            ConfigError: with a sentence for each thing that is wrong.
        """
        cell = self.composed.cell
        if "search" not in cell:
            raise ConfigError("search is missing; write search=NAME, e.g. search=smoke")
        return parse(TuneRequest, {key: cell[key] for key in TUNING_KEYS})

    @cached_property
    def base(self) -> RunConfig:
        """The config that trials change, checked.

        Raises:
            ConfigError: it can't run.
        """
        assert self.request
        return self.config({})

    @property
    def folder(self) -> Path:
        """The experiment's folder, with the study."""
        return self.base.output_path / self.base.experiment_name

    def composed_with(self, changes: Mapping[str, Any]) -> Composed:
        """Return the config of a trial as Hydra would compose it, without the keys of scripts/tune.py.

        Raises:
            ConfigError: it does not compose, or has no such key.
        """
        groups = self.composed.options.keys() & changes.keys()
        composed = self._with_options([f"{group}={changes[group]}" for group in sorted(groups)])
        cell = composed.cell.copy()
        cell.experiment_name = cell.experiment_name  # resolved while there is a search, whose name is the default
        with open_dict(cell):
            for key in TUNING_KEYS:
                del cell[key]
        for key, value in changes.items():
            if key not in groups:
                _set(cell, key, value)
        OmegaConf.resolve(cell)
        return replace(composed, cell=cell)

    def config(self, changes: Mapping[str, Any]) -> RunConfig:
        """Return the checked config of a trial.

        Raises:
            ConfigError: it can't run.
        """
        return validate(self.composed_with(changes).cell)

    def values(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of each key of the space in the config of a trial."""
        composed = self.composed_with(changes)
        options = {group: changes.get(group, option) for group, option in composed.options.items()}
        return {key: base_value(composed.cell, options, key) for key in self.request.search.space}

    def check(self) -> None:
        """Check the space: every key, both ends of each range, every choice, and what is enqueued.

        Raises:
            ConfigError: with a sentence for each of the first five things that are wrong.
        """
        search, problems = self.request.search, []
        self.config({})  # report errors of the base config once
        try:
            dimensions = in_order(search)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        overridden = {line.partition("=")[0].lstrip("+~") for line in self.overrides}
        for key, dimension in dimensions:
            if key in overridden:
                problems.append(f"{key} is both an override and a key of search.space; remove one of them")
            for context in _contexts(search, key):
                for value in dimension.ends:
                    problems += self._problems({**context, key: value}, f"search.space.{key}")
        for number, values in enumerate(search.enqueue):
            problems += self._problems(values, f"search.enqueue.{number}")
        if problems:
            raise ConfigError("\n".join(dict.fromkeys(problems[:5])))

    def _problems(self, values: Mapping[str, Any], where: str) -> list[str]:
        try:
            self.config(values)
        except ConfigError as error:
            return [f"{where}: {line}" for line in str(error).splitlines()]
        return []

    def open(self) -> OpenStudy:
        """Return the study, made with its folder if there is none yet.

        Raises:
            OutputDirectoryError: the folder can't be made.
            ConfigError, StoreError: see `study.open_study`.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputDirectoryError(f"output_dir: {self.folder} cannot be made: {error.strerror}") from error
        storage = storage_of(self.folder, self.request.storage)
        return open_study(self.folder, self.request.search, self.base, self.values, storage)

    def save(self) -> None:
        """Save what workers and other commands need to find the study and to compose the configs of trials."""
        request, extra = self.request, self.extra_config_dir
        # Workers may be started from another directory.
        overrides = [strip_password(with_absolute_path(line)) for line in self.overrides]
        command = {"overrides": overrides, "extra_config_dir": extra and str(Path(extra).absolute())}
        settings = {"storage": request.storage, "n_trials": request.n_trials}
        write_json(
            self.folder / SEARCH_FILE, {**command, **settings, "search": request.search.model_dump(by_alias=True)}
        )

    @classmethod
    def load(cls, folder: Path, storage: str | None) -> "Search":
        """Return the last search of an experiment's folder, with the storage of the caller.

        A storage that the folder's files name is never opened.

        Raises:
            ConfigError: there is none.
        """
        stored = read_object(folder / SEARCH_FILE)
        if not isinstance(stored.get("overrides"), list):
            raise ConfigError(f"{folder / SEARCH_FILE} can't be read; rerun the search")
        known = [f"output_dir={in_quotes(str(folder.parent))}", f"storage={in_quotes(storage) if storage else 'null'}"]
        return cls([*stored["overrides"], *known], stored.get("extra_config_dir"))


def _contexts(search: SearchConfig, key: str) -> list[dict[str, Any]]:
    """Return the values of other keys to check a key with: its conditions, and each option of its group."""
    context: dict[str, Any] = {}
    waiting = [key]
    while waiting:
        for other, values in search.space[waiting.pop()].when.items():
            context[other] = values[0]
            waiting.append(other)
    group = key.partition(".")[0]
    options = search.space[group].choices if group != key and group in search.space and group not in context else None
    return [{group: option, **context} for option in options] if options else [context]


def _set(cell: DictConfig, key: str, value: Any) -> None:
    """Set a key of a composed config; `+key` adds one.

    Raises:
        ConfigError: there is no such key.
    """
    added, bare = key.startswith("+"), key.lstrip("+")
    parent, _, name = bare.rpartition(".")
    node = OmegaConf.select(cell, parent) if parent else cell
    if not isinstance(node, DictConfig) or (name not in node and not added):
        known = [str(one) for one in node] if isinstance(node, DictConfig) else []
        raise ConfigError(f"{bare}: there is no such key{suggestion(name, known)}")
    OmegaConf.update(cell, bare, value, merge=True, force_add=added)


@dataclass(frozen=True)
class StoredSearch:
    """A search as other commands find it in its folder: its settings, number of trials, study and the trials so far."""

    search: SearchConfig
    n_trials: int
    study: "Study"
    trials: list[TrialRow]


def study_in(folder: Path, storage: str | None = None) -> StoredSearch | None:
    """Return the search of an experiment's folder, for reading; None without one.

    Args:
        folder: of the experiment; the database that its files name is opened only if it is `storage`.
        storage: as passed by the user.

    Raises:
        ConfigError: its settings or its study are damaged, or the study lies in another storage.
        StoreError: its storage fails.
        UntrustedError: see `storage_of`.
    """
    stored = read_object(folder / SEARCH_FILE)
    if "search" not in stored:
        return None
    settings = check(SearchConfig, stored["search"])
    n_trials, place = stored.get("n_trials"), stored.get("storage")
    place = strip_password(place) if isinstance(place, str) and place else None
    if place not in (None, storage):
        raise ConfigError(f"the study is in {place}; pass storage={place} to read it")
    study = load_study(folder.name, storage_of(folder, place))
    if study is None:
        return None
    if len(study.directions) != len(settings.objective):
        raise ConfigError(f"{folder / SEARCH_FILE} and the study differ in their number of objectives")
    number = n_trials if isinstance(n_trials, int) else 0
    return StoredSearch(settings, number, study, rows(study, folder, number))
