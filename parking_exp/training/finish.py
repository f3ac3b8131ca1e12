"""The end of a run: final evaluation, cross-check on the reference simulator, final model, learning
curves, video.
"""

import numpy as np
import pandas as pd

from parking_exp.config.schema import RunConfig
from parking_exp.errors import CrossCheckError, VideoError
from parking_exp.evaluation.evaluate_policy import describe_rates, find_differences
from parking_exp.evaluation.video import record
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.training.checkpoints import save_model
from parking_exp.training.loop import TrainingLoop, derive_seeds
from parking_exp.training.plot_curves import plot_learning_curves


def finish(loop: TrainingLoop) -> pd.DataFrame:
    """Evaluate the final model on all episodes, cross-check some of them, write all files; return
    the episodes.

    Raises:
        CrossCheckError: an episode differs between two simulators of the task; all files are
            written.
    """
    config, path, metrics = loop.config, loop.directory.path, loop.task.metrics
    loop.bar.show_activity("final evaluation")
    cross_checked = certified_seeds(config)
    # Cross-checked episodes have batches of their own: the last bits of actions depend on the
    # batch.
    others = [
        seed
        for seed in loop.episode_seeds(config.evaluation.final_n_scenes)
        if seed not in cross_checked
    ]
    parts = [loop.run_episodes(seeds) for seeds in (cross_checked, others) if len(seeds)]
    episodes = pd.concat(parts).sort_values(EPISODE_SEED, ignore_index=True)
    summary = loop.record_evaluation(episodes.head(config.evaluation.n_scenes), "eval")
    loop.bar.say(describe_rates(summary, loop.model.num_timesteps, metrics))
    loop.record_evaluation(episodes, "final")
    certified, reference = parts[0], config.env.simulators[-1]
    if cross_checked and config.env.simulator != reference:
        loop.bar.show_activity(f"cross-check on {reference}")
        certified = loop.run_episodes(cross_checked, reference)
    if cross_checked:
        loop.record_evaluation(certified, "certified")
    loop.dump_metrics()
    loop.model.logger.close()
    save_model(loop.model, loop.directory.models / "final.zip")
    title = f"{config.experiment_name}: {path.parent.name}"
    plot_learning_curves(loop.metrics.frame(), metrics, title, path / "curves.png")
    if number := config.evaluation.video_episodes:
        loop.bar.show_activity("video")
        try:
            record(loop.policy, loop.task, loop.episode_seeds(number), path / "video.mp4")
        except VideoError as error:
            loop.bar.say(str(error))
    if cross_checked and (different := find_differences(parts[0], certified)):
        raise CrossCheckError(
            f"{len(different)} of {len(certified)} cross-checked episodes differ between "
            "env.simulator="
            f"{config.env.simulator} and {reference}; {'; '.join(different[:3])}"
        )
    return episodes


def certified_seeds(config: RunConfig) -> list[int]:
    """Return the seeds of the final evaluation's episodes that are repeated on the reference
    simulator, sorted.

    They are drawn with the run's seed, so that a sweep covers many; on the reference itself, all
    are returned.
    """
    first, number = config.evaluation.first_scene, config.evaluation.final_n_scenes
    rng = np.random.default_rng(derive_seeds(config.seed, config.env.training_seeds).certified)
    return sorted(
        rng.choice(range(first, first + number), config.n_certified, replace=False).tolist()
    )
