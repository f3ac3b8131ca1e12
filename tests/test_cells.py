"""Experiment files: which runs they stand for, and how a command line narrows them."""

from collections import Counter

import pytest
from conftest import run_script

from parking_exp.cells import points, seeds_of
from parking_exp.composition import composed
from parking_exp.errors import ConfigError
from parking_exp.validation import validate

BLOCKS = [{"buffer": ["her_future", "her_final"], "buffer.n_sampled_goal": [1, 4]}, {"buffer": "replay"}]
FOUR = [
    ["buffer=her_future", "buffer.n_sampled_goal=1"],
    ["buffer=her_future", "buffer.n_sampled_goal=4"],
    ["buffer=her_final", "buffer.n_sampled_goal=1"],
    ["buffer=her_final", "buffer.n_sampled_goal=4"],
]


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
        ({"algorithm": ["td3"], "buffer": ["replay"]}, [["algorithm=td3", "buffer=replay"]]),
        (
            {"seed": ["1", "2"], "buffer": ["replay"]},
            [["seed=1", "buffer=replay"], ["seed=2", "buffer=replay"]],
        ),
    ],
)
def test_blocks_are_products_that_the_command_line_narrows(typed, expected):
    assert points(BLOCKS, typed) == expected


def test_without_blocks_what_is_typed_is_the_product():
    assert points([], {}) == [[]]
    assert points([], {"a": ["1", "2"], "b": ["x"]}) == [["a=1", "b=x"], ["a=2", "b=x"]]


def test_values_are_written_as_hydra_reads_them():
    (point,) = points([{"a": None, "b": True, "c": [[64, 64]], "d": 1e-3}], {})
    assert point == ["a=null", "b=true", "c=[64,64]", "d=0.001"]


@pytest.mark.parametrize(("value", "seeds"), [(None, [7]), (3, [0, 1, 2]), ([4, 2], [4, 2])])
def test_seeds(value, seeds):
    assert seeds_of(value, default=7) == seeds


@pytest.mark.parametrize("value", [0, -1, True, "x", [], ["a"], 1.5])
def test_other_seeds_are_refused(value):
    with pytest.raises(ConfigError, match="neither a number of seeds nor a list"):
        seeds_of(value, default=7)


def test_seeds_on_a_command_line():
    assert [run.seed for run in runs("seeds=3")] == [0, 1, 2]
    assert [run.seed for run in runs("seeds=[5,2]")] == [run.seed for run in runs("seeds=5,2")] == [5, 2]
    assert [run.seed for run in runs("experiment=her_traps", "seed=9", "buffer=her_episode")] == [9] * 6
    # All cells get their first seed before any gets its second.
    assert [(run.seed, run.algorithm.name) for run in runs("seeds=2", "algorithm=sac,td3")] == [
        (0, "sac"), (0, "td3"), (1, "sac"), (1, "td3"),
    ]  # fmt: skip


def test_the_her_ablation_is_every_strategy_with_every_share_and_a_control_on_both_rewards():
    found = runs("experiment=her_ablation", "seeds=2")
    cells = Counter((run.env.reward, run.buffer.name, run.buffer.arguments.get("n_sampled_goal")) for run in found)
    strategies = ("her_future", "her_final", "her_episode", "her_random")
    expected = {(r, s, n) for r in ("dense", "sparse") for s in strategies for n in (1, 2, 4, 8)}
    assert cells == dict.fromkeys(expected | {("dense", "replay", None), ("sparse", "replay", None)}, 2)
    assert len({run.run_key for run in found}) == 68


def test_the_her_traps_are_the_relabelling_options_where_they_can_make_a_difference():
    found = runs("experiment=her_traps", "seeds=1")
    names = ("relabel_collision", "relabel_terminated", "goal_velocity")
    cells = {
        (run.buffer.name, run.algorithm.features, *(run.buffer.arguments[name] for name in names)) for run in found
    }
    assert cells == {
        *(("her_future", "ego", c, t, "achieved") for c in ("keep", "sb3") for t in ("sb3", "goal")),
        *(("her_episode", "ego", c, t, "achieved") for c in ("keep", "sb3") for t in ("sb3", "goal", "goal_and_crash")),
        *(("her_future", "raw", "keep", "sb3", v) for v in ("achieved", "zero")),
    }
    assert len(found) == 12


@pytest.mark.parametrize("experiment", ["her_ablation", "her_traps"])
@pytest.mark.parametrize(("budget", "steps"), [("small", 20_000), ("full", 60_000)])
def test_every_cell_has_as_many_env_steps_and_updates(experiment, budget, steps):
    """Whatever differs, it is the buffer or the reward: the same steps, updates, networks and evaluation."""
    found = runs(f"experiment={experiment}", f"budget={budget}", "seeds=1")
    assert {run.total_timesteps for run in found} == {steps}
    assert {run.update_rounds() for run in found} == {(1, 8)}
    rest = [run.plain() | {"buffer": None, "env": None} for run in found if run.algorithm.features == "ego"]
    assert all(one == rest[0] for one in rest)


def test_ten_seeds_and_the_small_budget_unless_said_otherwise():
    found = runs("experiment=her_traps", "buffer.relabel_collision=keep", "buffer.relabel_terminated=sb3")
    assert len(found) == 40
    assert {run.total_timesteps for run in found} == {20_000}


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
    assert done.stderr.splitlines()[-1] == "error: 1 of 3 runs failed: 2"
    assert "run 3 of 3" in done.stdout
