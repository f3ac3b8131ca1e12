"""Figures of a search by `optuna.visualization.matplotlib`."""

import warnings
from collections.abc import Iterator
from typing import Any

import matplotlib
import numpy as np
from matplotlib.ticker import LogLocator, NullLocator

from parking_exp.figure_style import WIDTH_IN, report_style
from parking_exp.report_section import CaptionedFigure
from parking_exp.reports.report_data import ReportData
from parking_exp.tuning.search import StoredSearch
from parking_exp.tuning.trials import OBJECTIVE, rank_trials

MAX_SLICES = 4  # in one figure
MIN_TRIALS = 20  # for importances: PED-ANOVA looks at the best tenth


def rebuild_study(search: StoredSearch) -> Any:
    """Return an in-memory study of a report's finished trials, which may be from an export."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    space = search.settings.space
    study = optuna.create_study(direction="maximize")
    for trial in search.trials:
        if trial.value is not None:
            study.add_trial(
                optuna.trial.create_trial(
                    value=trial.value,
                    params=dict(trial.parameters),
                    distributions={name: space[name].distribution() for name in trial.parameters},
                )
            )
    return study


def _plot(name: str, search: StoredSearch, height: float = 3.0, **arguments: Any) -> Any:
    """Return the figure of a search that a function of `optuna.visualization.matplotlib` draws."""
    import optuna.visualization.matplotlib
    from matplotlib import pyplot

    matplotlib.use("agg")
    plot = getattr(optuna.visualization.matplotlib, name)
    study = rebuild_study(search)
    # Optuna sets a style of its own, and warns of parameters that have one value.
    with report_style(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        drawn = plot(study, target_name=OBJECTIVE, **arguments)
    figure = np.ravel(drawn)[0].figure
    pyplot.close(figure)
    figure.set(size_inches=(WIDTH_IN, height), facecolor="white")
    figure.suptitle("")
    for axes in figure.axes:
        axes.set_title("")
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                # Labels with mathematics would make names mathematics, too.
                axis.set_major_locator(LogLocator(subs=(1, 3)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
    return figure


def draw_history(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw the value of each trial and the best so far."""
    search = report.tuning
    if search is not None and len(rank_trials(search.trials)) > 1:
        figure = _plot("plot_optimization_history", search)
        yield figure, f"{OBJECTIVE} of each trial that is done, and the best so far."


def draw_parameter_importance(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw the importance of parameters, if enough trials differ in their values."""
    search = report.tuning
    if search is None:
        return
    values = [trial.value for trial in rank_trials(search.trials)]
    if len(values) >= MIN_TRIALS and len(set(values)) > 1:
        height = 1.0 + 0.3 * len(search.settings.space)
        yield (
            _plot("plot_param_importances", search, height),
            f"Importance of each parameter for the best tenth of trials by {OBJECTIVE} "
            "(PED-ANOVA).",
        )


def draw_slices(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw the objective against each parameter, some parameters to a figure."""
    search = report.tuning
    if search is None or len(rank_trials(search.trials)) < 2:
        return
    names: dict[str, None] = {}
    for trial in rank_trials(search.trials):
        names |= dict.fromkeys(trial.parameters)
    for begin in range(0, len(names), MAX_SLICES):
        parameters = list(names)[begin : begin + MAX_SLICES]
        figure = _plot("plot_slice", search, params=parameters)
        caption = f"{OBJECTIVE} against {', '.join(parameters)}; darker trials are later."
        yield figure, caption
