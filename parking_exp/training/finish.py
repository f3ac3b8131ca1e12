"""The end of a run: final evaluation, certification on highway-env, final model, learning curves, video."""

import pandas as pd

from parking_exp.algorithms.model_files import save_model
from parking_exp.errors import CertificationError
from parking_exp.evaluation.description import success_line
from parking_exp.evaluation.evaluate import differences
from parking_exp.evaluation.trajectories import TRAJECTORIES_FILE, Recorder
from parking_exp.evaluation.video import record
from parking_exp.training.loop import TrainingLoop
from parking_exp.training.plot_curves import learning_curves


def finish(loop: TrainingLoop) -> pd.DataFrame:
    """Evaluate the final model on all scenes, write everything down, and return the episodes on real highway-env.

    Raises:
        CertificationError: an episode went otherwise there than in the simulator; all tables are written.
    """
    config, path = loop.config, loop.directory.path
    loop.bar.busy("final evaluation")
    recorder = Recorder()
    episodes = loop.run_episodes(config.evaluation.final_n_scenes, recorder=recorder)
    recorder.save(path / TRAJECTORIES_FILE)
    summary = loop.record_evaluation(episodes.head(config.evaluation.n_scenes), "eval")
    loop.bar.say(success_line(summary, loop.model.num_timesteps))
    loop.record_evaluation(episodes, "final")
    certified = _certify(loop, episodes)
    loop.dump_metrics()
    loop.model.logger.close()
    save_model(loop.model, loop.directory.models / "final.zip")
    learning_curves(loop.metrics.frame(), f"{config.experiment_name}: {path.parent.name}", path / "curves.png")
    if number := config.evaluation.video_episodes:
        loop.bar.busy("video")
        record(loop.policy, config.env, loop.scenes(number), path / "video.mp4")
    loop.env.close()
    if found := differences(episodes, certified):
        raise CertificationError(
            f"{len(found)} of {len(episodes)} final episodes differ between env.simulator="
            f"{config.env.simulator} and highway-env; {'; '.join(found[:3])}"
        )
    return certified


def _certify(loop: TrainingLoop, episodes: pd.DataFrame) -> pd.DataFrame:
    """Repeat the final evaluation on real highway-env, unless that is where it was made."""
    certified = episodes
    if loop.config.env.simulator != "highway_env":
        loop.bar.busy("certification on highway-env")
        certified = loop.run_episodes(len(episodes), "highway_env")
    loop.record_evaluation(certified, "certified")
    return certified
