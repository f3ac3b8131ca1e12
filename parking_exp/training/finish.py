"""The end of a run: final evaluation, certification on highway-env, final model, learning curves, video."""

import numpy as np
import pandas as pd

from parking_exp.algorithms.model_files import save_model
from parking_exp.config.schema import RunConfig
from parking_exp.errors import CertificationError
from parking_exp.evaluation.evaluate_policy import Recorder, differences, success_line
from parking_exp.evaluation.metrics import TRAJECTORIES_FILE
from parking_exp.evaluation.video import record
from parking_exp.training.loop import TrainingLoop, derive_seeds
from parking_exp.training.plot_curves import learning_curves


def finish(loop: TrainingLoop) -> pd.DataFrame:
    """Evaluate the final model on all scenes, certify some of them, write all files; return the episodes.

    Raises:
        CertificationError: an episode differs between highway-env and the simulator; all files are written.
    """
    config, path = loop.config, loop.directory.path
    recorder = Recorder()
    loop.bar.busy("final evaluation")
    chosen = certified_scenes(config)
    # Scenes that are certified are stepped by themselves, since a policy's last bits depend on what is in its batch.
    others = [scene for scene in loop.scenes(config.evaluation.final_n_scenes) if scene not in chosen]
    parts = [loop.run_episodes(scenes, recorder=recorder) for scenes in (chosen, others) if len(scenes)]
    recorder.save(path / TRAJECTORIES_FILE)
    episodes = pd.concat(parts).sort_values("scene", ignore_index=True)
    summary = loop.record_evaluation(episodes.head(config.evaluation.n_scenes), "eval")
    loop.bar.say(success_line(summary, loop.model.num_timesteps))
    loop.record_evaluation(episodes, "final")
    certified = parts[0]
    if config.env.simulator != "highway_env":
        loop.bar.busy("certification on highway-env")
        certified = loop.run_episodes(chosen, "highway_env")
    loop.record_evaluation(certified, "certified")
    loop.dump_metrics()
    loop.model.logger.close()
    save_model(loop.model, loop.directory.models / "final.zip")
    learning_curves(loop.metrics.frame(), f"{config.experiment_name}: {path.parent.name}", path / "curves.png")
    if number := config.evaluation.video_episodes:
        loop.bar.busy("video")
        record(loop.policy, config.env, loop.scenes(number), path / "video.mp4")
    if different := differences(parts[0], certified):
        raise CertificationError(
            f"{len(different)} of {len(certified)} certified episodes differ between env.simulator="
            f"{config.env.simulator} and highway-env; {'; '.join(different[:3])}"
        )
    return episodes


def certified_scenes(config: RunConfig) -> list[int]:
    """Return the scenes of the final evaluation that are repeated on highway-env, sorted.

    They are drawn by the run's seed, so that a sweep covers many. On highway-env itself they are all.
    """
    evaluation = config.evaluation
    scenes = range(evaluation.first_scene, evaluation.first_scene + evaluation.final_n_scenes)
    rng = np.random.default_rng(derive_seeds(config.seed).certified_scenes)
    return sorted(rng.choice(scenes, config.n_certified_scenes, replace=False).tolist())
