"""The end of a run: final evaluation, cross-check, final model, learning curves and video."""

from collections.abc import Sequence

import pandas as pd

from parking_exp.errors import CrossCheckError
from parking_exp.evaluation.evaluate_policy import describe_rates, find_differences
from parking_exp.evaluation.path_recorder import PathRecorder
from parking_exp.evaluation.video import record_video
from parking_exp.runs.run_files import CURVES_FILE, FINAL_MODEL, PATHS_FILE, VIDEO_FILE
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.training.plot_curves import plot_learning_curves
from parking_exp.training.run_session import RunSession
from parking_exp.training.seeds import cross_checked_seeds

N_PATHS = 50
"""Final episodes whose paths are kept, the first ones: as many as a figure can show."""


def evaluate_final(session: RunSession) -> pd.DataFrame:
    """Evaluate and cross-check the final policy, write the last files, and return the final
    episodes.

    Raises:
        CrossCheckError: an episode differs between two simulators of the task; all files are
            written.
    """
    config = session.config
    settings = config.evaluation
    metrics = session.task.metrics
    session.display.show_activity("final evaluation")
    cross_checked = cross_checked_seeds(config)
    # Cross-checked episodes have batches of their own: the last bits of actions depend on the
    # batch.
    all_seeds = settings.seeds(settings.final_n_scenes)
    others = [seed for seed in all_seeds if seed not in cross_checked]
    path_recorder = PathRecorder(session.task, all_seeds[:N_PATHS])
    parts = []
    for seeds in (cross_checked, others):
        if seeds:
            parts.append(session.run_episodes(seeds, path_recorder=path_recorder))
    episodes = pd.concat(parts).sort_values(EPISODE_SEED, ignore_index=True)

    summary = session.record_evaluation(episodes.head(settings.n_scenes), "eval")
    session.display.say(describe_rates(summary, session.step, metrics))
    session.record_evaluation(episodes, "final")
    problem = _cross_check(session, cross_checked, parts[0]) if cross_checked else None
    session.dump_metrics()

    _write_files(session, path_recorder)
    if problem is not None:
        raise CrossCheckError(problem)
    return episodes


def _write_files(session: RunSession, path_recorder: PathRecorder) -> None:
    """Write the last files of a run: final model, paths, learning curves and video."""
    config = session.config
    folder = session.directory.path
    session.save_final(session.directory.models / FINAL_MODEL)
    path_recorder.write(folder / PATHS_FILE)
    title = f"{config.experiment_name}: {folder.parent.name}"
    log = session.metrics_log.frame()
    plot_learning_curves(log, session.task.metrics, title, folder / CURVES_FILE)
    if config.evaluation.video_episodes:
        session.display.show_activity("video")
        filmed = config.evaluation.seeds(config.evaluation.video_episodes)
        reason = record_video(session.policy, session.task, filmed, folder / VIDEO_FILE)
        if reason is not None:
            session.display.say(reason)


def _cross_check(session: RunSession, seeds: Sequence[int], episodes: pd.DataFrame) -> str | None:
    """Repeat episodes on the reference simulator; return what differs, if anything."""
    simulator = session.config.env.simulator
    reference = session.config.env.reference_simulator
    repeated = episodes
    if simulator != reference:
        session.display.show_activity(f"cross-check on {reference}")
        repeated = session.run_episodes(seeds, reference)
    session.record_evaluation(repeated, "certified")

    differences = find_differences(episodes, repeated)
    if not differences:
        return None
    return (
        f"{len(differences)} of {len(repeated)} cross-checked episodes differ between "
        f"env.simulator={simulator} and {reference}; {'; '.join(differences[:3])}"
    )
