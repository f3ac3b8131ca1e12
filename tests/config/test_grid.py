"""Experiment files: which runs they stand for, and how a command line narrows them."""

import re
from collections import Counter

import pytest
from support.marks import slow_but
from support.runs import run_script

from parking_exp.config.compose import composed, composed_runs
from parking_exp.config.grid import points, seeds_of
from parking_exp.config.validate import validate
from parking_exp.errors import ConfigError

BLOCKS = [{"buffer": ["her_future", "her_final"], "buffer.n_sampled_goal": [1, 4]}, {"buffer": "replay"}]
FOUR = [
    ["buffer=her_future", "buffer.n_sampled_goal=1"],
    ["buffer=her_future", "buffer.n_sampled_goal=4"],
    ["buffer=her_final", "buffer.n_sampled_goal=1"],
    ["buffer=her_final", "buffer.n_sampled_goal=4"],
]


def has(key, point):
    return True


def runs(*overrides):
    return [validate(config) for config in composed("config", list(overrides))]


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ({}, [*FOUR, ["buffer=replay"]]),
        ({"buffer": ["her_final"]}, FOUR[2:]),
        ({"buffer": ["replay"]}, [["buffer=replay"]]),
        ({"buffer": ["her_random"]}, [["buffer=her_random", f"buffer.n_sampled_goal={n}"] for n in (1, 4)]),
        ({"buffer.n_sampled_goal": ["4"]}, [FOUR[1], FOUR[3], ["buffer=replay"]]),
        ({"buffer.n_sampled_goal": ["3"], "buffer": ["her_final"]}, [["buffer=her_final", "buffer.n_sampled_goal=3"]]),
        ({"algorithm": ["td3"], "buffer": ["replay"]}, [["buffer=replay", "algorithm=td3"]]),
        (
            {"seed": ["1", "2"], "buffer": ["replay"]},
            [["buffer=replay", "seed=1"], ["buffer=replay", "seed=2"]],
        ),
    ],
)
def test_blocks_are_products_that_the_command_line_narrows(typed, expected):
    """Replay has no n_sampled_goal, and is left alone by it."""
    assert points(BLOCKS, typed, lambda key, point: "buffer=replay" not in point) == expected


def test_where_no_cell_matches_the_values_that_there_are_are_told():
    blocks = [{"a": "x", "b": [1, 2]}, {"a": "y", "b": [3]}]
    with pytest.raises(
        ConfigError, match=r"^no cell of experiment mine matches a=x b=3; its values are a=x,y and b=1,2,3$"
    ):
        points(blocks, {"a": ["x"], "b": ["3"]}, has, "mine")


def test_without_blocks_what_is_typed_is_the_product():
    assert points([], {}, has) == [[]]
    assert points([], {"a": ["1", "2"], "b": ["x"]}, has) == [["a=1", "b=x"], ["a=2", "b=x"]]


def test_values_are_written_as_hydra_reads_them():
    (point,) = points([{"a": None, "b": True, "c": [[64, 64]], "d": 1e-3}], {}, has)
    assert point == ["a=null", "b=true", "c=[64,64]", "d=0.001"]


@pytest.mark.parametrize(("value", "seeds"), [(None, None), (3, [0, 1, 2]), ([4, 2, 4], [4, 2])])
def test_seeds(value, seeds):
    assert seeds_of(value) == seeds


@pytest.mark.parametrize("value", [0, -1, True, "x", [], ["a"], 1.5, [True], [[1]]])
def test_other_seeds_are_refused(value):
    with pytest.raises(ConfigError, match=r"neither a number of seeds .* nor a list"):
        seeds_of(value)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["seeds=4294967296"], "seeds=4294967296 makes 4294967296 runs; a sweep has 100000 at most"),
        (["seeds=50001", "buffer=her_future,replay"], "2 cells x 50001 seeds makes 100002 runs; a sweep has 100000 at most"),
        ([f"{key}={','.join(map(str, range(1, 11)))}" for key in ("n_envs", "total_timesteps", "algorithm.batch_size", "env.duration",
          "env.scaling", "checkpoint.keep_last")], "what is swept over makes 1000000 runs; a sweep has 100000 at most"),
        (["seeds=[3,4294967296]"], "seeds: 4294967296 is out of range; seeds are 0 to 4294967295"),
    ],
)  # fmt: skip
def test_more_runs_than_a_sweep_can_have_are_refused(overrides, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        composed_runs("config", overrides)


def test_a_sweep_can_have_a_hundred_thousand_runs():
    assert len(composed_runs("config", ["seeds=100000"])) == 100_000


def test_seeds_on_a_command_line():
    assert [run.seed for run in runs("seeds=3")] == [0, 1, 2]
    assert [run.seed for run in runs("seeds=[5,2]")] == [run.seed for run in runs("seeds=5,2")] == [5, 2]
    assert [run.seed for run in runs("experiment=her_relabelling", "seed=9", "buffer=her_episode")] == [9] * 11
    assert [run.seed for run in runs("experiment=variants", "seeds=null")] == [0] * len(
        runs("experiment=variants", "seeds=1")
    )
    assert [run.seed for run in runs("seed=3", "seeds=null")] == [3]
    # All cells get their first seed before any gets its second.
    assert [(run.seed, run.algorithm.name) for run in runs("seeds=2", "algorithm=sac,td3")] == [
        (0, "sac"), (0, "td3"), (1, "sac"), (1, "td3"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("seeds=a,b",), "seeds=['a', 'b'] is neither"),
        (("seeds=[1,2],[3]",), "seeds=[[1, 2], [3]] is neither"),
        (("seeds=3", "seed=1"), "seed and seeds are both given"),
        (
            ("buffer=her_future,replay", "buffer.n_sampled_goal=2,4"),
            "buffer.n_sampled_goal: buffer=replay has no such key",
        ),
        (("algorithm=sac,td3", "algorithm.policy_delay=1,2"), "algorithm.policy_delay: algorithm=sac has no such key"),
        (("algorithm=sac,td3", "algorithm.gama=1"), "algorithm.gama: algorithm=sac has no such key"),
        (("cells=3",), "cells=3 is not a list"),
        (("cells=[3]",), "cells=[3] is not a list"),
        (("budget=smal",), "budget=smal: there is no such option; did you mean 'small'?"),
    ],
)
def test_what_is_no_sweep_is_refused_in_a_sentence(overrides, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}"):
        runs(*overrides)


@pytest.mark.slow
def test_what_is_typed_applies_to_every_cell_that_has_it():
    found = runs("experiment=her_relabelling", "seeds=1", "algorithm.features=raw")
    assert {run.algorithm.features for run in found} == {"raw"}
    assert len({run.run_key for run in found}) == len(found) == 21
    found = runs("experiment=her_ablation", "seeds=1", "env=parking_crowded,parking_sparse", "buffer=her_final,replay")
    assert Counter((run.env.name, run.buffer.name) for run in found) == {
        ("parking_crowded", "her_final"): 4, ("parking_crowded", "replay"): 1,
        ("parking_sparse", "her_final"): 4, ("parking_sparse", "replay"): 1,
    }  # fmt: skip
    found = runs("experiment=her_ablation", "seeds=1", "env=parking", "++buffer.n_sampled_goal=3", "buffer=her_final")
    assert [run.buffer.arguments["n_sampled_goal"] for run in found] == [3]


def test_several_experiments_are_one_after_the_other():
    found = runs("experiment=smoke,her_relabelling", "seeds=1")
    assert Counter(run.experiment_name for run in found) == {"smoke": 1, "her_relabelling": 22}


def test_a_cell_may_name_its_seeds():
    found = runs("cells=[{seed:[5,6],algorithm:[sac,td3]}]", "seeds=2")
    assert Counter((run.seed, run.algorithm.name) for run in found) == dict.fromkeys(
        [(5, "sac"), (5, "td3"), (6, "sac"), (6, "td3")], 1
    )


@pytest.mark.slow
def test_one_run_of_a_sweep_is_the_run_that_was_asked_for(tmp_path):
    """One seed and one cell: the run that was checked is the one that is trained."""
    arguments = (
        "experiment=smoke", "seeds=[5]", "cells=[{algorithm:td3}]", "total_timesteps=60", "tracking.mlflow=false",
        "evaluation.video_episodes=0", "evaluation.final_n_scenes=3", f"output_dir={tmp_path}",
    )  # fmt: skip
    done = run_script("train", *arguments)
    assert done.returncode == 0, done.stderr
    (result,) = tmp_path.glob("*/*/*/result.json")
    assert result.parent.name == "seed=5"
    assert result.parents[1].name.startswith("parking-td3-")


@pytest.mark.slow
def test_the_her_ablation_is_every_strategy_with_every_share_and_a_control_on_both_rewards():
    found = runs("experiment=her_ablation", "seeds=2")
    cells = Counter((run.env.reward, run.buffer.name, run.buffer.arguments.get("n_sampled_goal")) for run in found)
    strategies = ("her_future", "her_final", "her_episode", "her_random")
    expected = {(r, s, n) for r in ("dense", "sparse") for s in strategies for n in (1, 2, 4, 8)}
    assert cells == dict.fromkeys(expected | {("dense", "replay", None), ("sparse", "replay", None)}, 2)
    assert len({run.run_key for run in found}) == 68


def test_the_her_relabelling_are_the_relabelling_options_where_they_can_make_a_difference():
    found = runs("experiment=her_relabelling", "seeds=1")
    names = ("relabel_collision", "relabel_terminated", "goal_velocity")
    cells = {
        (run.buffer.name, run.algorithm.features, *(run.buffer.arguments[name] for name in names)) for run in found
    }
    assert cells == {
        *(
            ("her_future", "ego_mirrored", c, t, "achieved")
            for c in ("keep", "sb3", "exclude")
            for t in ("sb3", "goal", "env")
        ),
        *(
            ("her_episode", "ego_mirrored", c, t, "achieved")
            for c in ("keep", "sb3")
            for t in ("sb3", "goal", "goal_and_crash", "env")
        ),
        *(("her_episode", "ego_mirrored", "exclude", t, "achieved") for t in ("sb3", "goal", "env")),
        *(("her_future", "raw", "sb3", "sb3", v) for v in ("achieved", "zero")),
    }
    assert len(found) == 22


@pytest.mark.parametrize("experiment", slow_but(["her_relabelling"], ["her_ablation", "her_relabelling"]))
@pytest.mark.parametrize(("budget", "steps"), [("small", 96_000), ("full", 256_000)])
def test_every_cell_has_as_many_env_steps_and_updates(experiment, budget, steps):
    """Whatever differs, it is the buffer or the reward: the same steps, updates, networks and evaluation."""
    found = runs(f"experiment={experiment}", f"budget={budget}", "seeds=1")
    assert {run.total_timesteps for run in found} == {steps}
    assert {run.update_rounds() for run in found} == {(1, 8)}
    rest = [run.plain() | {"buffer": None, "env": None} for run in found if run.algorithm.features != "raw"]
    assert all(one == rest[0] for one in rest)


def test_ten_seeds_and_the_small_budget_unless_said_otherwise():
    found = runs("experiment=her_relabelling", "buffer.relabel_collision=sb3", "buffer.relabel_terminated=sb3")
    assert len(found) == 40
    assert {run.total_timesteps for run in found} == {96_000}


@pytest.mark.slow
def test_a_sweep_goes_on_after_a_run_that_failed(tmp_path):
    """The second of three runs cannot make its directory; the others are done, and the exit status tells."""
    blocked = tmp_path / "default"
    arguments = (
        "experiment=smoke", "seeds=3", "total_timesteps=60", "tracking.mlflow=false", "evaluation.video_episodes=0",
        "evaluation.final_n_scenes=3", f"output_dir={tmp_path}",
    )  # fmt: skip
    (run,) = runs(*arguments[:1], "seed=1", *arguments[2:])
    run.run_dir.parent.mkdir(parents=True)
    run.run_dir.write_text("in the way")
    done = run_script("train", *arguments)
    assert not blocked.exists()
    assert sorted(path.parent.name for path in tmp_path.glob("*/*/*/result.json")) == ["seed=0", "seed=2"]
    assert done.returncode == 2
    assert f"error: output_dir: {run.run_dir} cannot be made: File exists" in done.stderr
    assert done.stderr.splitlines()[-1] == "error: of 3 runs, 1 not done; rerun the same command to resume"
