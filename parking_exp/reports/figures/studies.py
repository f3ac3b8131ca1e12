"""Figures of Optuna studies by `optuna.visualization.matplotlib`, in the style of the other figures of a report."""

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from parking_exp.errors import ResultsError
from parking_exp.reports import formats
from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.figures.style import FULL_IN, INK, TEXT_PT, clean, report_style
from parking_exp.reports.report_data import Factor, ReportData
from parking_exp.reports.tuning_data import Tuning
from parking_exp.tuning.trials import TrialRow

Drawn = tuple[Canvas, str]
MOST_AXES = 8  # of parallel coordinates
MOST_SLICES = 4  # in one figure
FEWEST_TRIALS = 20  # for importances: PED-ANOVA looks at the best tenth
STATES = {"done": "COMPLETE", "pruned": "PRUNED", "failed": "FAIL", "running": "RUNNING", "pending": "WAITING"}


def study_of(tuning: Tuning) -> Any:
    """Return an in-memory study with the trials of a report, which may be made from an export.

    Raises:
        ResultsError: the trials do not fit the parameters.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        kinds = {
            clean(name): optuna.distributions.json_to_distribution(json.dumps(_with_clean_choices(kind)))
            for name, kind in tuning.parameters.items()
        }
        study = optuna.create_study(directions=["maximize"] * len(tuning.objectives))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            study.set_metric_names(list(tuning.objectives))
        for trial in tuning.trials:
            settings = {clean(name): _clean(value) for name, value in trial.parameters.items()}
            study.add_trial(
                optuna.trial.create_trial(
                    state=optuna.trial.TrialState[STATES[trial.state]],
                    values=list(trial.values) or None,
                    params=settings,
                    distributions={name: kinds[name] for name in settings},
                )
            )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ResultsError(f"the search of {tuning.experiment} can't be drawn: {error}") from error
    return study


def _with_clean_choices(kind: Mapping[str, Any]) -> dict[str, Any]:
    attributes = dict(kind["attributes"])
    if "choices" in attributes:
        attributes["choices"] = [_clean(choice) for choice in attributes["choices"]]
    return {**kind, "attributes": attributes}


def _clean(value: Any) -> Any:
    """Return a value without what can't be drawn in a text."""
    return clean(value) if isinstance(value, str) else value


def canvas_of(plot: Callable[..., Any], study: Any, height: float = 3.0, **arguments: Any) -> Canvas:
    """Return what a function of `optuna.visualization.matplotlib` draws of a study."""
    import matplotlib
    from matplotlib import pyplot
    from optuna.exceptions import ExperimentalWarning

    matplotlib.use("agg")
    with report_style(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        warnings.filterwarnings("ignore", "PedAnova")  # `importance` does what it asks for
        matplotlib.rcParams["figure.constrained_layout.use"] = True
        figure = np.ravel(plot(study, **arguments))[0].figure
    pyplot.close(figure)
    figure.set_facecolor("none")
    figure.suptitle("")
    for axes in figure.axes:
        _restyle(axes)
    return Canvas(FULL_IN, height, figure)


def _restyle(axes: Any) -> None:
    """Replace Optuna's style, which suits white pages only, and its mathematical tick labels."""
    from matplotlib.ticker import LogLocator, NullLocator

    axes.set_facecolor("none")
    axes.set_title("")
    axes.set_title("", loc="left")
    axes.tick_params(which="both", colors=INK)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set(color=INK, size=TEXT_PT)
        if axis.get_scale() == "log":
            axis.set_major_locator(LogLocator(subs=(1, 3)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_locator(NullLocator())
            axis.set_tick_params(labelrotation=30 if axis is axes.xaxis else 0)
    if legend := axes.get_legend():
        legend.set_frame_on(False)


def _with_trials(report: ReportData) -> tuple[Tuning, Any] | None:
    """Return the search of a report and its study, if it has trials that are done and vary a parameter."""
    tuning = report.tuning
    if tuning is None or not _varied(tuning):
        return None
    return tuning, study_of(tuning)


def _varied(tuning: Tuning) -> list[str]:
    """Return the parameters of which trials that are done have several values."""
    done = [trial for trial in tuning.trials if trial.values]
    return [
        clean(name)
        for name in tuning.parameters
        if len({trial.parameters[name] for trial in done if name in trial.parameters}) > 1
    ]


def history(report: ReportData) -> Drawn | None:
    """Draw the value of each trial and the best so far."""
    from optuna.visualization.matplotlib import plot_optimization_history

    if (found := _with_trials(report)) is None:
        return None
    tuning, study = found
    several = len(tuning.objectives) > 1
    target: dict[str, Any] = {"target": lambda trial: trial.values[0]} if several else {}
    canvas = canvas_of(plot_optimization_history, study, target_name=tuning.objectives[0], **target)
    return canvas, f"{tuning.objectives[0]} of each trial that is done" + ("." if several else ", and the best so far.")


def pareto_front(report: ReportData) -> Drawn | None:
    """Draw the trials of a search for two or three objectives, and their Pareto front."""
    from optuna.visualization.matplotlib import plot_pareto_front

    if (found := _with_trials(report)) is None or len(found[0].objectives) not in (2, 3):
        return None
    names = list(found[0].objectives)
    return canvas_of(plot_pareto_front, found[1], target_names=names), f"Pareto front of {' and '.join(names)}."


def importance(report: ReportData) -> Drawn | None:
    """Draw the importance of parameters, if enough trials differ in their values."""
    from optuna.visualization.matplotlib import plot_param_importances

    if (found := _with_trials(report)) is None:
        return None
    tuning, study = found
    done = [tuple(trial.values) for trial in tuning.trials if trial.values]
    if len(done) < FEWEST_TRIALS or any(len(set(values)) == 1 for values in zip(*done, strict=True)):
        return None
    objective, height = tuning.objectives[0], 1.0 + 0.3 * len(tuning.parameters)
    # PED-ANOVA looks at the lowest values of a target.
    target: dict[str, Any] = {"target": lambda trial: -trial.values[0]} if len(tuning.objectives) > 1 else {}
    canvas = canvas_of(plot_param_importances, study, height, target_name=objective, **target)
    return canvas, f"Importance of each parameter for the best tenth of trials by {objective} (PED-ANOVA)."


def slices(report: ReportData) -> list[Drawn]:
    """Draw each objective against each parameter, some parameters to a figure."""
    from optuna.visualization.matplotlib import plot_slice

    if (found := _with_trials(report)) is None:
        return []
    (tuning, study), names = found, _varied(found[0])
    drawn = []
    for place, objective in enumerate(tuning.objectives):
        for begin in range(0, len(names), MOST_SLICES):
            chosen = names[begin : begin + MOST_SLICES]
            target: dict[str, Any] = {"target": lambda trial, place=place: trial.values[place]}
            canvas = canvas_of(plot_slice, study, params=chosen, target_name=objective, **target)
            drawn.append((canvas, f"{objective} against {', '.join(chosen)}; darker trials are later ones."))
    return drawn


def trial_coordinates(report: ReportData) -> Drawn | None:
    """Draw each trial as a line across its values and parameters."""
    from optuna.visualization.matplotlib import plot_parallel_coordinate

    if (found := _with_trials(report)) is None:
        return None
    tuning, study = found
    names, noun = _varied(tuning), "cell" if report.design == "search" else "trial"
    left_out = f" {len(names) - MOST_AXES} parameters are left out." if len(names) > MOST_AXES else ""
    canvas = canvas_of(plot_parallel_coordinate, study, params=names[:MOST_AXES], target_name=tuning.objectives[0])
    return canvas, f"Each {noun} as a line from its value across its parameters.{left_out}"


def cell_coordinates(report: ReportData) -> Drawn | None:
    """Draw each cell of a sweep over many hyperparameters as a line, the most important ones first."""
    cells = [(cell, cell.success.value) for cell in report.cells if cell.success.value is not None]
    if report.design != "search" or report.tuning is not None or not cells:
        return None
    order = {item.factor: rank for rank, item in enumerate(report.importance)}
    factors = sorted(report.factors, key=lambda factor: order.get(factor.key, len(order)))
    settings = {
        factor.name: _levels(factor, [cell.settings.get(factor.key) for cell, _ in cells]) for factor in factors
    }
    trials = [
        TrialRow(row, "done", parameters={name: levels[row] for name, levels in settings.items()}, values=[success])
        for row, (_, success) in enumerate(cells)
    ]
    parameters = {factor.name: _distribution(factor, settings[factor.name]) for factor in factors}
    tuning = Tuning(report.title, "", None, len(cells), ["success"], 0, parameters, trials)
    return trial_coordinates(replace(report, tuning=tuning))


def _levels(factor: Factor, values: Sequence[Any]) -> list[Any]:
    """Return the levels of cells as numbers, or as texts where one of them has none, such as `buffer=replay`."""
    numeric = factor.numeric and all(isinstance(value, int | float) for value in values)
    return list(values) if numeric else [str(formats.level(value)) for value in values]


def _distribution(factor: Factor, levels: Sequence[Any]) -> dict[str, Any]:
    if any(isinstance(level, str) for level in levels):
        return {"name": "CategoricalDistribution", "attributes": {"choices": list(dict.fromkeys(levels))}}
    ends = {"low": min(levels), "high": max(levels), "log": factor.log and min(levels) > 0, "step": None}
    return {"name": "FloatDistribution", "attributes": ends}
