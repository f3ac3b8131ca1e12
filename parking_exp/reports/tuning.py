"""The hyperparameter search of an experiment for its report: trials, budget, importance, and re-runs on fresh seeds.

Nothing here imports Optuna before there is a search.
"""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parking_exp.config.schema import NAME
from parking_exp.errors import ParkingError, plural
from parking_exp.reports import formats
from parking_exp.reports.report_data import Factor, Interval, ReportData, Setting
from parking_exp.reports.tuning_data import Budget, Objective, Retested, Trial, Tuning
from parking_exp.reports.tuning_findings import claims
from parking_exp.runs.files import read_object
from parking_exp.runs.state import read_state
from parking_exp.statistics import mean_interval, welch
from parking_exp.tuning.objectives import CENSORED_S
from parking_exp.tuning.retest import RETEST_FILE
from parking_exp.tuning.schema import HIGHER_IS_BETTER, Dimension, SearchConfig
from parking_exp.tuning.search import SEARCH_FILE, study_in
from parking_exp.tuning.space import parameter
from parking_exp.tuning.study import storage_errors
from parking_exp.tuning.trials import TrialRow, front

if TYPE_CHECKING:
    from optuna import Study

FEWEST_TRIALS = 20  # that are done, for importances: their best tenth is two trials
GROUP_PREFIX = re.compile(r"\b(algorithm|buffer|env)\.")
WHERE_FROM = "Cells of a search have runs with its tuning seeds, by which trials were chosen"


def with_search(report: ReportData, output_dir: Path, storage: str | None = None) -> ReportData:
    """Return a report with the search of its experiments, and unchanged where none of them has one.

    Of several searches it is the first. One whose study can't be read is left out with a warning.
    """
    named = [name for name in report.experiments if re.fullmatch(NAME, name)]
    searches = [name for name in named if (output_dir / name / SEARCH_FILE).exists()]
    found, problems, others = None, [], list(searches)
    for name in searches:
        others.remove(name)
        folder = output_dir / name
        try:
            if (stored := study_in(folder, storage)) is not None:
                found = tuning_of(folder, stored.search, stored.n_trials, stored.trials, stored.study)
                break
        except ParkingError as error:
            problems.append(f"The search of {name} is left out: {str(error).splitlines()[0].rstrip('.')}.")
    report = replace(report, warnings=[*report.warnings, *problems])
    if found is None:
        return report
    notes = [f"The report shows the search of {found.experiment}, and not those of {', '.join(others)}."]
    return with_tuning(replace(report, notes=[*report.notes, *(notes if others else [])]), found)


def with_tuning(report: ReportData, found: Tuning) -> ReportData:
    """Return a report with a search, what it says, and a warning of how its cells compare."""
    again = "the table of re-runs is the fair comparison" if found.retested else "none was run again on fresh seeds"
    return replace(
        report,
        tuning=found,
        claims=[*claims(found), *report.claims],
        warnings=[*report.warnings, f"{WHERE_FROM}; {again}."],
    )


def tuning_of(folder: Path, search: SearchConfig, n_trials: int, trials: Sequence[TrialRow], study: "Study") -> Tuning:
    """Return a search as reports show it.

    Args:
        folder: of the experiment.
        search: its settings.
        n_trials: how many trials it is to have.
        trials: those that it has.
        study: Optuna's.
    """
    n_seeds = len(search.tuning_seeds)
    objectives = [_objective(name, n_seeds) for name in search.objective]
    tried = dict(zip([parameter(key, one) for key, one in search.space.items()], search.space.values(), strict=True))
    names = _names(list(tried))
    known = [_parameter(key, names[key], dimension, trials) for key, dimension in tried.items()]
    importance, notes = parameter_importance(study, trials)
    retested_on, retested = None, list[Retested]()
    stored = read_object(folder / RETEST_FILE)
    try:
        if stored:
            retested_on = _objective(stored["objective"], n_seeds)
            retested = [_retested(retested_on, one) for one in stored["trials"]]
    except (KeyError, TypeError, ValueError):
        notes.append(f"The re-runs are left out: {folder / RETEST_FILE} can't be read.")
    return Tuning(
        experiment=folder.name,
        sampler=search.sampler,
        pruner=search.pruner,
        n_trials=n_trials,
        objectives=objectives,
        tuning_seeds=search.tuning_seeds,
        test_seeds=search.test_seeds,
        parameters=[factor for factor in known if factor.levels],
        trials=_trials(trials, objectives),
        budget=budget(trials, lambda trial: _whole_steps(trial, folder.parent, n_seeds)),
        front=[trial.number for trial in front(trials, search.objective)] if len(objectives) > 1 else [],
        importance=importance,
        retested=retested,
        retested_on=retested_on if retested else None,
        notes=notes,
    )


def _objective(name: str, n_seeds: int) -> Objective:
    is_rate = name != "cost_to_95"
    return Objective(name, HIGHER_IS_BETTER[name], is_rate, None if is_rate else CENSORED_S / n_seeds)


def _names(keys: Sequence[str]) -> dict[str, str]:
    """Return short names: keys without their group, where these differ."""
    short = {key: GROUP_PREFIX.sub("", key) for key in keys}
    texts = list(short.values())
    return {key: key if texts.count(text) > 1 else text for key, text in short.items()}


def _parameter(key: str, name: str, dimension: Dimension, trials: Sequence[TrialRow]) -> Factor:
    levels: list[Any] = list(dict.fromkeys(trial.parameters[key] for trial in trials if key in trial.parameters))
    numeric = bool(levels) and all(isinstance(one, int | float) and not isinstance(one, bool) for one in levels)
    if numeric:
        levels.sort()
    on_log = bool(dimension.log or dimension.one_minus_log)
    wide = dimension.choices is not None and numeric and levels[0] > 0 and levels[-1] / levels[0] >= 8
    return Factor(key, name, levels, numeric, log=on_log or wide)


def _trials(trials: Sequence[TrialRow], objectives: Sequence[Objective]) -> list[Trial]:
    found, best = [], list[float]()
    for row in trials:
        values = [float(value) for value in row.values]
        if values:
            pairs = zip(objectives, best, values, strict=True) if best else ()
            best = [max(old, new) if one.higher_is_better else min(old, new) for one, old, new in pairs] or values
        settings: dict[str, Setting] = dict(row.parameters)
        known = {"env_steps": row.env_steps, "cpu_s": row.cpu_s, "cost": row.cost, "seconds": row.seconds}
        found.append(
            Trial(
                number=row.number,
                label=row.label,
                state=row.state,
                settings=settings,
                values=values,
                best=best,
                by_seed=[list(one) for one in row.by_seed],
                reason=row.reason,
                **known,  # type: ignore[arg-type]
            )
        )
    return found


def budget(trials: Sequence[TrialRow], whole_steps: Callable[[TrialRow], int | None]) -> Budget:
    """Return the env steps that trials took, and those that pruned ones did not take.

    Args:
        trials: of the search. One whose runs an earlier trial has had took nothing.
        whole_steps: trial -> env steps that it takes if it is not pruned; None: as many as the longest that is done.
    """
    longest = max((trial.env_steps for trial in trials if trial.state == "done" and trial.env_steps), default=None)
    took: dict[str, list[int]] = {"done": [], "pruned": []}
    seen, saved, unknown = set[str](), 0, False
    for trial in trials:
        if trial.state not in took or trial.env_steps is None or (trial.runs and seen >= set(trial.runs)):
            continue
        seen |= set(trial.runs)
        took[trial.state].append(trial.env_steps)
        if trial.state == "pruned":
            whole = whole_steps(trial) or longest
            unknown |= whole is None
            saved += max(0, (whole or 0) - trial.env_steps)
    done, pruned = took["done"], took["pruned"]
    return Budget(sum(done), sum(pruned), len(done), len(pruned), None if unknown else saved)


def _whole_steps(trial: TrialRow, output_dir: Path, n_seeds: int) -> int | None:
    total = read_state(output_dir / trial.runs[0]).total_timesteps if trial.runs else None
    return None if total is None else n_seeds * total


def parameter_importance(study: "Study", trials: Sequence[TrialRow]) -> tuple[dict[str, float], list[str]]:
    """Return the importance of parameters by PED-ANOVA, the largest first, and a sentence where there is none.

    It is how much a parameter matters for being among the best tenth of the trials that are done (Watanabe et al.,
    IJCAI 2023); of several objectives, for being on the Pareto front.
    """
    done = [trial for trial in trials if trial.values]
    left_out = "The importance of parameters is left out:"
    if len(done) < FEWEST_TRIALS:
        are = "is" if len(done) == 1 else "are"
        return {}, [f"{left_out} {plural(len(done), 'trial')} {are} done, and it takes {FEWEST_TRIALS}."]
    if len({tuple(trial.values) for trial in done}) == 1:
        return {}, [f"{left_out} all trials that are done have the same value."]
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

    with storage_errors(study.study_name), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parameters that few trials have
        found = get_param_importances(study, evaluator=PedAnovaImportanceEvaluator())
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0]))), []


def _retested(objective: Objective, stored: Mapping[str, Any]) -> Retested:
    """Read a trial of `retest.json`.

    Raises:
        KeyError, TypeError, ValueError: something is missing, or is no number.
    """
    tuning, test = ([float(value) for value in stored[key]] for key in ("tuning", "test"))
    tuning_missed, test_missed = (_missed(objective, values) for values in (tuning, test))
    difference = Interval(None)
    if not (tuning_missed or test_missed):
        found, bound = welch(tuning, test), 1.0 if objective.is_rate else float("inf")
        low, high = (formats.within(end, -bound, bound) for end in (found.low, found.high))
        difference = Interval(found.difference, low, high, min(found.n_a, found.n_b), found.method)
    return Retested(
        number=int(stored["number"]),
        label=str(stored["label"]),
        tuning=tuning,
        test=test,
        tuning_mean=_mean(objective, tuning),
        test_mean=_mean(objective, test),
        difference=difference,
        tuning_missed=tuning_missed,
        test_missed=test_missed,
    )


def _missed(objective: Objective, values: Sequence[float]) -> int:
    return 0 if objective.is_rate else sum(value >= CENSORED_S for value in values)


def _mean(objective: Objective, values: Sequence[float]) -> Interval:
    if _missed(objective, values):
        return Interval(None)
    found = mean_interval(values, bounds=(0.0, 1.0) if objective.is_rate else None)
    return Interval(found.mean, formats.finite(found.low), formats.finite(found.high), found.n, found.method)
