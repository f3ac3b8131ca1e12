"""Figures of Optuna studies by `optuna.visualization.matplotlib`: of a search, and of a sweep over many values."""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.ticker import LogLocator, NullLocator

from parking_exp.errors import ResultsError
from parking_exp.figure_style import WIDTH_IN, Drawing, clean, report_style
from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell, Factor, ReportData
from parking_exp.reports.search_report import Tuning

MOST_AXES = 8  # of parallel coordinates
MOST_SLICES = 4  # in one figure
FEWEST_TRIALS = 20  # for importances: PED-ANOVA looks at the best tenth


def study_of(tuning: Tuning) -> Any:
    """Return an in-memory Optuna study of the finished trials of a report, which may be from an export."""
    from optuna.distributions import json_to_distribution

    try:
        kinds = {name: json_to_distribution(json.dumps(kind)) for name, kind in tuning.parameters.items()}
        return _study(kinds, [(trial.parameters, trial.value) for trial in tuning.trials if trial.value is not None])
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"the search of {tuning.experiment} can't be drawn: {error}") from error


def _study(distributions: Mapping[str, Any], trials: Sequence[tuple[Mapping[str, Any], float]]) -> Any:
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(direction="maximize")
    for parameters, value in trials:
        used = {name: distributions[name] for name in parameters}
        study.add_trial(optuna.trial.create_trial(value=value, params={**parameters}, distributions=used))
    return study


def _plot(name: str, study: Any, height: float = 3.0, **arguments: Any) -> Any:
    """Return the figure that the named function of `optuna.visualization.matplotlib` draws of a study."""
    import optuna.visualization.matplotlib
    from matplotlib import pyplot
    from optuna.exceptions import ExperimentalWarning

    matplotlib.use("agg")
    with report_style(), warnings.catch_warnings():  # Optuna sets a style of its own
        warnings.simplefilter("ignore", ExperimentalWarning)
        figure = np.ravel(getattr(optuna.visualization.matplotlib, name)(study, **arguments))[0].figure
    pyplot.close(figure)
    figure.set(size_inches=(WIDTH_IN, height), facecolor="white")
    figure.suptitle("")
    for axes in figure.axes:
        axes.set_title("")
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":  # without mathematical labels, which would make names mathematics, too
                axis.set_major_locator(LogLocator(subs=(1, 3)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
    return figure


def _varied(tuning: Tuning) -> list[str]:
    """Return the parameters of which the finished trials of a search have several values."""
    values: dict[str, set[Any]] = {}
    for trial in tuning.trials:
        for name, value in trial.parameters.items() if trial.value is not None else ():
            values.setdefault(name, set()).add(value)
    return [name for name in values if len(values[name]) > 1]


def draw_history(report: ReportData) -> Iterator[Drawing]:
    """Draw the value of each trial and the best so far."""
    if (tuning := report.tuning) and _varied(tuning):
        objective = tuning.objective
        figure = _plot("plot_optimization_history", study_of(tuning), target_name=objective)
        yield figure, f"{objective} of each trial that is done, and the best so far."


def draw_parameter_importance(report: ReportData) -> Iterator[Drawing]:
    """Draw the importance of parameters, if enough trials differ in their values."""
    if (tuning := report.tuning) and _varied(tuning):
        yield from _importance("trials", study_of(tuning), tuning.objective)


def draw_slices(report: ReportData) -> Iterator[Drawing]:
    """Draw the objective against each parameter, some parameters to a figure."""
    if (tuning := report.tuning) is None or not (names := _varied(tuning)):
        return
    objective = tuning.objective
    for begin in range(0, len(names), MOST_SLICES):
        chosen = names[begin : begin + MOST_SLICES]
        figure = _plot("plot_slice", study_of(tuning), params=chosen, target_name=objective)
        yield figure, f"{objective} against {', '.join(chosen)}; darker trials are later ones."


def draw_trial_coordinates(report: ReportData) -> Iterator[Drawing]:
    """Draw each trial as a line across its values and parameters."""
    if (tuning := report.tuning) and (names := _varied(tuning)):
        yield _coordinates("trial", study_of(tuning), names, tuning.objective)


def draw_cell_coordinates(report: ReportData) -> Iterator[Drawing]:
    """Draw each cell of a sweep over many hyperparameters as a line."""
    if study := _cell_study(report):
        yield _coordinates("cell", study, [clean(factor.name) for factor in report.factors], "success")


def draw_cell_importance(report: ReportData) -> Iterator[Drawing]:
    """Draw the importance of the hyperparameters of such a sweep."""
    if study := _cell_study(report):
        yield from _importance("cells", study, "success")


def _cell_study(report: ReportData) -> Any:
    """Return the cells of a sweep over many hyperparameters as an Optuna study; None for other reports."""
    rated = [cell for cell in report.cells if cell.success.value is not None]
    if report.design != "search" or report.tuning is not None or not rated:
        return None
    factors = report.factors
    trials = [
        ({clean(f.name): level for f in factors if (level := _level(f, cell)) is not None}, cell.success.value or 0.0)
        for cell in rated
    ]
    return _study({clean(factor.name): _distribution(factor) for factor in factors}, trials)


def _level(factor: Factor, cell: Cell) -> Any:
    """Return a cell's level of a factor, None where it has none, as `buffer=replay` has no `n_sampled_goal`."""
    level = cell.settings.get(factor.key)
    return level if factor.numeric or level is None else clean(formats.level(level))


def _distribution(factor: Factor) -> Any:
    from optuna.distributions import CategoricalDistribution, FloatDistribution

    levels: Sequence[Any] = factor.levels
    if not factor.numeric:
        return CategoricalDistribution([clean(formats.level(level)) for level in levels])
    return FloatDistribution(min(levels), max(levels), log=factor.log and min(levels) > 0)


def _importance(nouns: str, study: Any, objective: str) -> Iterator[Drawing]:
    values = [trial.value for trial in study.trials]
    if len(values) >= FEWEST_TRIALS and len(set(values)) > 1:
        height = 1.0 + 0.3 * len(study.trials[0].params)
        figure = _plot("plot_param_importances", study, height, target_name=objective)
        yield figure, f"Importance of each parameter for the best tenth of {nouns} by {objective} (PED-ANOVA)."


def _coordinates(noun: str, study: Any, names: Sequence[str], objective: str) -> Drawing:
    left_out = f" {len(names) - MOST_AXES} parameters are left out." if len(names) > MOST_AXES else ""
    figure = _plot("plot_parallel_coordinate", study, params=[*names[:MOST_AXES]], target_name=objective)
    return figure, f"Each {noun} as a line from its value across its parameters.{left_out}"
