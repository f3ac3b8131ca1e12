"""Figures of a search by `optuna.visualization.matplotlib`."""

import json
import warnings
from collections.abc import Iterator
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, NullLocator

from parking_exp.errors import ResultsError
from parking_exp.figure_style import WIDTH_IN, Drawing, report_style
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.search_report import Tuning

MAX_SLICES = 4  # in one figure
MIN_TRIALS = 20  # for importances: PED-ANOVA looks at the best tenth


def rebuild_study(tuning: Tuning) -> Any:
    """Return an in-memory Optuna study of the finished trials of a report, which may be from an
    export.
    """
    import optuna
    from optuna.distributions import json_to_distribution

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(direction="maximize")
    try:
        kinds = {
            name: json_to_distribution(json.dumps(kind)) for name, kind in tuning.parameters.items()
        }
        for trial in tuning.trials:
            if trial.value is not None:
                used = {name: kinds[name] for name in trial.parameters}
                study.add_trial(
                    optuna.trial.create_trial(
                        value=trial.value, params={**trial.parameters}, distributions=used
                    )
                )
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"the search of {tuning.experiment} can't be drawn: {error}") from error
    return study


def _plot(name: str, study: Any, height: float = 3.0, **arguments: Any) -> Any:
    """Return the figure that the named function of `optuna.visualization.matplotlib` draws of a
    study.
    """
    import optuna.visualization.matplotlib
    from matplotlib import pyplot
    from optuna.exceptions import ExperimentalWarning

    matplotlib.use("agg")
    with report_style(), warnings.catch_warnings():  # Optuna sets a style of its own
        warnings.simplefilter("ignore", ExperimentalWarning)
        figure = np.ravel(getattr(optuna.visualization.matplotlib, name)(study, **arguments))[
            0
        ].figure
    pyplot.close(figure)
    figure.set(size_inches=(WIDTH_IN, height), facecolor="white")
    figure.suptitle("")
    for axes in figure.axes:
        axes.set_title("")
        for axis in (axes.xaxis, axes.yaxis):
            if (
                axis.get_scale() == "log"
            ):  # without mathematical labels, which would make names mathematics, too
                axis.set_major_locator(LogLocator(subs=(1, 3)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
    return figure


def _find_varied(tuning: Tuning) -> list[str]:
    """Return the parameters of which the finished trials of a search have several values."""
    parameters = pd.DataFrame(
        [trial.parameters for trial in tuning.trials if trial.value is not None]
    )
    return [str(name) for name in parameters if parameters[name].nunique() > 1]


def draw_history(report: ReportData) -> Iterator[Drawing]:
    """Draw the value of each trial and the best so far."""
    if (tuning := report.tuning) and _find_varied(tuning):
        objective = tuning.objective
        figure = _plot("plot_optimization_history", rebuild_study(tuning), target_name=objective)
        yield figure, f"{objective} of each trial that is done, and the best so far."


def draw_parameter_importance(report: ReportData) -> Iterator[Drawing]:
    """Draw the importance of parameters, if enough trials differ in their values."""
    if (tuning := report.tuning) is None or not (names := _find_varied(tuning)):
        return
    study = rebuild_study(tuning)
    values = [trial.value for trial in study.trials]
    if len(values) >= MIN_TRIALS and len(set(values)) > 1:
        figure = _plot(
            "plot_param_importances", study, 1.0 + 0.3 * len(names), target_name=tuning.objective
        )
        yield (
            figure,
            f"Importance of each parameter for the best tenth of trials by {tuning.objective} "
            "(PED-ANOVA).",
        )


def draw_slices(report: ReportData) -> Iterator[Drawing]:
    """Draw the objective against each parameter, some parameters to a figure."""
    if (tuning := report.tuning) is None or not (names := _find_varied(tuning)):
        return
    objective = tuning.objective
    for begin in range(0, len(names), MAX_SLICES):
        parameters = names[begin : begin + MAX_SLICES]
        figure = _plot(
            "plot_slice", rebuild_study(tuning), params=parameters, target_name=objective
        )
        yield figure, f"{objective} against {', '.join(parameters)}; darker trials are later ones."
