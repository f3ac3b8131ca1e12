"""Results of runs: from the MLflow store to tidy pandas frames. Nothing here imports torch.

    from parking_exp.results import load

    results = load("her_ablation")
    results.runs.groupby("cell")["success_rate"].mean()

`runs` has one row per run, by experiment, cell and seed:

    run_id                  str       of MLflow
    experiment, cell        str       what it belongs to
    run_key                 str       hash of all that can change its result
    seed                    int64
    status                  category  done, running, failed, interrupted: in the store
    error                   str       why it failed, in one line; missing for others
    steps                   int64     env steps trained, as far as the store knows
    success_rate            float64   of the final model, over all its episodes
    timeout_rate            float64   the same; NaN, as all of these, unless the run is done
    failure_rate            float64   the same; parking has crash_rate and parked_rate instead
    episode_steps           float64   mean over the same episodes
    episode_return          float64   mean over the same episodes
    distance_m              float64   of parking: mean distance to the goal at their end
    heading_error_rad       float64   of parking: mean absolute value at their end
    speed_mps               float64   of parking: mean absolute value at their end
    path_m, gear_changes    float64   of parking: mean over the same episodes
    park_s, path_efficiency float64   of parking: mean over the successful ones; NaN without any
    plan_s                  float64   of parking: mean planning time; NaN where nothing is planned
    cpu_s, wall_s           float64   what it took so far
    started, ended          datetime64[ms, UTC]; a running one has not ended
    run_dir, artifact_uri   str       where its files are
    git_commit, cpu         str       of the process that trained
    git_dirty               boolean   whether its files differed from the commit
    version.PACKAGE         str       as many as there are
    config.KEY                        the config by dotted keys: int64, float64, bool or str. The
                                      column has objects where the key is missing or null in some
                                      runs (None), or words and numbers are mixed. Lists are text

`curves` has one row per evaluation during training and at its end, by run and step:

    run_id                  str
    step                    int64     env steps trained
    success_rate            float64   over the evaluation's episodes; so are the next four
    timeout_rate, failure_rate (parking: crash_rate, parked_rate), steps_mean, return_mean
    cpu_s                   float64   CPU time until then
    real_share              float64   share of the agent's sampled transitions not relabelled;
                                      1 with replay

`episodes` has one row per evaluation episode of all runs but running ones, in the order of
`runs`:

    run_id                  category
    phase                   category  eval: during training; final: after it; certified: some of
                                      the final ones again, on the reference simulator
    step, scene             int64     env steps trained; seed of the episode
    outcome                 category  success, timeout, failure, which parking calls crash
    parked                  bool      the strict definition of success, of parking
    steps, return           int64, float64: length; sum of rewards
    distance_m, heading_error_rad, speed_mps
                            float64   absolute values at its end, of parking
    park_s, path_m, path_efficiency, plan_s
                            float64   of parking; NaN where an episode has none
    gear_changes            int64     of parking

`paths` has one row per step of the first 50 final episodes, of one run of each cell: the
smallest seed that is done. Runs of some tasks have none, such as runs on Gymnasium's environments.

    run_id                  str
    scene, step             int64     seed of the episode; policy step, 0 at the start
    x_m, y_m, heading_rad   float64   of parking: centre and heading of the car

Metrics of users (`env.metrics`) come after the others: NAME_rate or NAME_mean in `runs`, before
versions, and in `curves`; NAME in `episodes`.

A column that a run's task does not have is missing in its rows. phase, step, scene and outcome are
always there.

`read_export(FOLDER)` gives the same frames from what `scripts/report.py export=FOLDER` has written:
gzipped CSV files, which `pandas.read_csv` reads as well, and a JSON file:

    runs.csv.gz      `Results.runs`; config.KEY as text
    curves.csv.gz    `Results.curves`
    outcomes.csv.gz  outcomes of the final episodes: a row per seed of an episode, a column per
                     run id
    report.json      problems; the search, if there is one

An export leaves out metrics that none of its runs has, evaluation episodes during training, all
but the outcomes of `Results.episodes`, paths, and everything that names a place on the machine.
Numbers of runs have 12 significant digits, others 6.
"""

from parking_exp.results.frame_export import read_export, write_export
from parking_exp.results.frames import Results, load

__all__ = ["Results", "load", "read_export", "write_export"]
