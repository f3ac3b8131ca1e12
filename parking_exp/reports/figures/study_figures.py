"""Figures of Optuna studies by `optuna.visualization.matplotlib`: of a search, and of a sweep over many values."""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.ticker import LogLocator, NullLocator

from parking_exp.errors import ResultsError
from parking_exp.reports import formats
from parking_exp.reports.figures.figure_style import WIDTH_IN, Drawing, clean, report_style
from parking_exp.reports.report_data import Factor, ReportData, Setting
from parking_exp.reports.tuning_data import Tuning

MOST_AXES = 8  # of parallel coordinates
MOST_SLICES = 4  # in one figure
FEWEST_TRIALS = 20  # for importances: PED-ANOVA looks at the best tenth


def study_of(tuning: Tuning) -> Any:
    """Return an in-memory study with the finished trials of a report, which may be made from an export.

    Raises:
        ResultsError: the trials do not fit the parameters.
    """
    import optuna

    try:
        distributions = {
            name: optuna.distributions.json_to_distribution(json.dumps(kind))
            for name, kind in tuning.parameters.items()
        }
        trials = [(trial.parameters, trial.values) for trial in tuning.trials if trial.values]
        return _study(len(tuning.objectives), distributions, trials)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ResultsError(f"the search of {tuning.experiment} can't be drawn: {error}") from error


def _study(
    n_objectives: int,
    distributions: Mapping[str, Any],
    trials: Sequence[tuple[Mapping[str, Any], Sequence[float]]],
) -> Any:
    """Return a study in which every objective is maximised; names and choices are made drawable."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    drawable = {
        name: optuna.distributions.CategoricalDistribution([_drawable(choice) for choice in kind.choices])
        if isinstance(kind, optuna.distributions.CategoricalDistribution)
        else kind
        for name, kind in distributions.items()
    }
    study = optuna.create_study(directions=["maximize"] * n_objectives)
    study.add_trials(
        optuna.trial.create_trial(
            values=list(values),
            params={clean(name): _drawable(value) for name, value in parameters.items()},
            distributions={clean(name): drawable[name] for name in parameters},
        )
        for parameters, values in trials
    )
    return study


def _drawable(value: Any) -> Any:
    return clean(value) if isinstance(value, str) else value


def _plot(name: str, study: Any, height: float = 3.0, **arguments: Any) -> Any:
    """Return the figure that a function of `optuna.visualization.matplotlib` draws of a study."""
    import optuna.visualization.matplotlib
    from matplotlib import pyplot
    from optuna.exceptions import ExperimentalWarning

    matplotlib.use("agg")
    with report_style(), warnings.catch_warnings():  # Optuna sets a style of its own
        warnings.simplefilter("ignore", ExperimentalWarning)
        warnings.filterwarnings("ignore", "PedAnova")  # of many objectives: the first is what we ask for
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


def _with_trials(report: ReportData) -> tuple[Tuning, list[str]] | None:
    """Return the search of a report and the parameters of which finished trials have several values, if any."""
    tuning = report.tuning
    if tuning is None:
        return None
    done = [trial.parameters for trial in tuning.trials if trial.values]
    varied = [name for name in tuning.parameters if len({values[name] for values in done if name in values}) > 1]
    return (tuning, [clean(name) for name in varied]) if varied else None


def draw_history(report: ReportData) -> Iterator[Drawing]:
    """Draw the value of each trial and the best so far."""
    if searched := _with_trials(report):
        tuning, _ = searched
        objective, several = tuning.objectives[0], len(tuning.objectives) > 1
        figure = _plot("plot_optimization_history", study_of(tuning), target_name=objective, **_first(tuning))
        yield figure, f"{objective} of each trial that is done" + ("." if several else ", and the best so far.")


def _first(tuning: Tuning) -> dict[str, Any]:
    """Return the `target` of plots of the first objective, which Optuna wants where there are several."""
    return {"target": lambda trial: trial.values[0]} if len(tuning.objectives) > 1 else {}


def draw_pareto_front(report: ReportData) -> Iterator[Drawing]:
    """Draw the trials of a search for two or three objectives, and their Pareto front."""
    searched = _with_trials(report)
    if searched and len(names := list(searched[0].objectives)) in (2, 3):
        yield (
            _plot("plot_pareto_front", study_of(searched[0]), target_names=names),
            f"Pareto front of {' and '.join(names)}.",
        )


def draw_parameter_importance(report: ReportData) -> Iterator[Drawing]:
    """Draw the importance of parameters, if enough trials differ in their values."""
    if (searched := _with_trials(report)) is None:
        return
    tuning, _ = searched
    values = [trial.values[0] for trial in tuning.trials if trial.values]
    if len(values) < FEWEST_TRIALS or len(set(values)) == 1:
        return
    objective, height = tuning.objectives[0], 1.0 + 0.3 * len(tuning.parameters)
    # PED-ANOVA looks at the lowest values of a target.
    target: dict[str, Any] = {"target": lambda trial: -trial.values[0]} if len(tuning.objectives) > 1 else {}
    figure = _plot("plot_param_importances", study_of(tuning), height, target_name=objective, **target)
    yield figure, f"Importance of each parameter for the best tenth of trials by {objective} (PED-ANOVA)."


def draw_slices(report: ReportData) -> Iterator[Drawing]:
    """Draw each objective against each parameter, some parameters to a figure."""
    if (searched := _with_trials(report)) is None:
        return
    (tuning, names), study = searched, study_of(searched[0])
    for place, objective in enumerate(tuning.objectives):
        for begin in range(0, len(names), MOST_SLICES):
            chosen = names[begin : begin + MOST_SLICES]
            target: dict[str, Any] = {"target": lambda trial, place=place: trial.values[place]}
            figure = _plot("plot_slice", study, params=chosen, target_name=objective, **target)
            yield figure, f"{objective} against {', '.join(chosen)}; darker trials are later ones."


def draw_trial_coordinates(report: ReportData) -> Iterator[Drawing]:
    """Draw each trial as a line across its values and parameters."""
    if searched := _with_trials(report):
        tuning, names = searched
        yield _coordinates("trial", study_of(tuning), names, tuning.objectives[0])


def draw_cell_coordinates(report: ReportData) -> Iterator[Drawing]:
    """Draw each cell of a sweep over many hyperparameters as a line, the most important ones first."""
    cells = [(cell.settings, cell.success.value) for cell in report.cells if cell.success.value is not None]
    if report.design != "search" or report.tuning is not None or not cells:
        return
    order = {item.factor: rank for rank, item in enumerate(report.importance)}
    factors = sorted(report.factors, key=lambda factor: order.get(factor.key, len(order)))
    distributions = {factor.name: _distribution(factor) for factor in factors}
    trials = [
        ({f.name: value for f in factors if (value := _value(f, settings)) is not None}, [success])
        for settings, success in cells
    ]
    yield _coordinates("cell", _study(1, distributions, trials), [clean(factor.name) for factor in factors], "success")


def _value(factor: Factor, settings: Mapping[str, Setting]) -> Any:
    """Return a cell's level of a factor, None where it has none, as `buffer=replay` has no `n_sampled_goal`."""
    value = settings.get(factor.key)
    return value if factor.numeric or value is None else formats.level(value)


def _distribution(factor: Factor) -> Any:
    from optuna.distributions import CategoricalDistribution, FloatDistribution

    levels: Sequence[Any] = factor.levels
    if not factor.numeric:
        return CategoricalDistribution([formats.level(level) for level in levels])
    return FloatDistribution(min(levels), max(levels), log=factor.log and min(levels) > 0)


def _coordinates(noun: str, study: Any, names: Sequence[str], objective: str) -> Drawing:
    left_out = f" {len(names) - MOST_AXES} parameters are left out." if len(names) > MOST_AXES else ""
    figure = _plot("plot_parallel_coordinate", study, params=list(names[:MOST_AXES]), target_name=objective)
    return figure, f"Each {noun} as a line from its value across its parameters.{left_out}"
