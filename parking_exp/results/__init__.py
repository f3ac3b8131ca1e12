"""Results of runs: from the MLflow store to tidy pandas frames. Nothing here imports torch.

    from parking_exp.results import load

    results = load("her_ablation")
    results.runs.groupby("cell")["success_rate"].mean()

`runs` has one row per run, by experiment, cell and seed:

    run_id, name, experiment, cell, run_key    str       MLflow run id and name, without the rate in
                                                         front of it; what it belongs to; hash of
                                                         all that can change its result
    seed                                       int64
    status                                     category  done, running, failed, interrupted: in the
    store error                                      str       why it failed, in one line; missing
    for others
    total_timesteps, n_scenes, first_scene,    Int64     as configured: env steps; episodes of the
    final evaluation and eval_n_scenes                                        their first seed;
    episodes of evaluations during training steps                                      int64     env
    steps trained, as far as the store knows success_rate, timeout_rate, failure_rate,  float64   of
    the final model, over all its episodes; NaN unless the run crash_rate, parked_rate
    is done. Parking has the last two instead of failure_rate episode_steps, episode_return,
    distance_m, float64   means over the same episodes; the last three, of parking, are
    heading_error_rad, speed_mps                         absolute values at their end cpu_s, wall_s
    float64   what it took so far started, ended                             datetime64[ms, UTC]; a
    running one has not ended run_dir, artifact_uri                      str       where its files
    are
    git_commit, git_dirty, cpu                 str, boolean, str: of the process that trained;
    whether files differed version.PACKAGE                            str       as many as there are
    config.KEY                                 the config by dotted keys: int64, float64, bool, str;
                                               object where it is missing or null in some runs
                                               (None), or words and numbers are mixed. Lists are
                                               text

`curves` has one row per evaluation during training and at its end, by run and step:

    run_id                                     str step                                       int64
    env steps trained success_rate, timeout_rate, failure_rate,  float64   over the evaluation's
    episodes crash_rate, parked_rate, steps_mean, return_mean cpu_s
    float64   CPU time until then real_share                                 float64   share of
    sampled transitions not relabelled; 1 with replay

`episodes` has one row per evaluation episode of the runs that are over, in the order of `runs`:

    run_id                                     category
    phase                                      category  eval: during training; final: after it;
                                                         certified: some of the final ones again, on
                                                         the reference simulator
    step, scene                                int64     env steps trained; seed of the episode
    outcome                                    category  success, timeout, failure, which parking
    calls crash parked                                     bool      the strict definition of
    success, of parking
    steps, return                              int64, float64: length; sum of rewards
    distance_m, heading_error_rad, speed_mps   float64   absolute values at its end

A column that a run's task does not have is missing in its rows. phase, step, scene and outcome are
always there.

`read_export(FOLDER)` gives the same frames from what `scripts/report.py export=FOLDER` has written:
gzipped CSV files, which `pandas.read_csv` reads as well, and a JSON file:

    runs.csv.gz      `Results.runs`; config.KEY as text
    curves.csv.gz    `Results.curves`
    outcomes.csv.gz  outcomes of the final episodes: a row per seed of an episode, a column per run
    id report.json      problems; names of the experiments; the search, if there is one

Left out are metrics that none of the runs has, such as those of other tasks; evaluation episodes
during training; what `Results.episodes` has besides outcomes; and everything that names a place on
the machine. Numbers are rounded to 6 significant digits.
"""

from parking_exp.results.frame_export import read_export, write_export
from parking_exp.results.frames import Results, load

__all__ = ["Results", "load", "read_export", "write_export"]
