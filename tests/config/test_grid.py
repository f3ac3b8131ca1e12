"""Tests of experiment files: which runs they stand for, and how a command line narrows them."""

from collections import Counter

import pytest
from support.marks import slow_but

from parking_exp.config.compose import compose_configs, compose_runs
from parking_exp.config.grid import expand_points, seeds_of
from parking_exp.config.validate import validate
from parking_exp.errors import ConfigError

BLOCKS = [
    {"buffer": ["her_future", "her_final"], "buffer.n_sampled_goal": [1, 4]},
    {"buffer": "replay"},
]
FOUR = [
    ("buffer=her_future", "buffer.n_sampled_goal=1"),
    ("buffer=her_future", "buffer.n_sampled_goal=4"),
    ("buffer=her_final", "buffer.n_sampled_goal=1"),
    ("buffer=her_final", "buffer.n_sampled_goal=4"),
]


def has(key, point):
    return "buffer=replay" not in point


def runs(*overrides):
    return [validate(config) for config in compose_configs("config", list(overrides))]


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ({}, [*FOUR, ("buffer=replay",)]),
        ({"buffer": ["her_final"]}, FOUR[2:]),
        ({"buffer": ["replay"]}, [("buffer=replay",)]),
        (
            {"buffer": ["her_random"]},
            [("buffer=her_random", f"buffer.n_sampled_goal={n}") for n in (1, 4)],
        ),
        ({"buffer.n_sampled_goal": ["4"]}, [FOUR[1], FOUR[3], ("buffer=replay",)]),
        (
            {"buffer.n_sampled_goal": ["3"], "buffer": ["her_final"]},
            [("buffer=her_final", "buffer.n_sampled_goal=3")],
        ),
        ({"algorithm": ["td3"], "buffer": ["replay"]}, [("buffer=replay", "algorithm=td3")]),
        (
            {"seed": ["1", "2"], "buffer": ["replay"]},
            [("buffer=replay", "seed=1"), ("buffer=replay", "seed=2")],
        ),
    ],
)
def test_blocks_are_products_that_the_command_line_narrows(axes, expected):
    """The block of replay, which has no n_sampled_goal, is not changed by it."""
    assert expand_points(BLOCKS, axes, has) == expected


def test_values_of_no_cell_are_refused_by_name():
    with pytest.raises(ConfigError, match=r"^a=x b=3: .*mine"):
        expand_points(
            [{"a": "x", "b": [1, 2]}, {"a": "y", "b": [3]}], {"a": ["x"], "b": ["3"]}, has, "mine"
        )


def test_values_are_written_as_hydra_reads_them():
    (point,) = expand_points([{"a": None, "b": True, "c": [[64, 64]], "d": 1e-3}], {}, has)
    assert point == ("a=null", "b=true", "c=[64,64]", "d=0.001")


@pytest.mark.parametrize("value", [0, 2**32, True, "x", [], 1.5, [True], [3, 2**32]])
def test_other_seeds_are_refused(value):
    with pytest.raises(ConfigError, match=r"^seeds="):
        seeds_of(value)


def test_seeds_on_a_command_line():
    assert [run.seed for run in runs("seeds=3")] == [0, 1, 2]
    assert [run.seed for run in runs("seeds=[5,2,5]")] == [5, 2]
    assert [run.seed for run in runs("seeds=5,2")] == [5, 2]
    assert [
        run.seed for run in runs("experiment=her_relabelling", "seed=9", "buffer=her_episode")
    ] == [9] * 11
    assert [run.seed for run in runs("seed=3", "seeds=null")] == [3]
    assert [run.seed for run in compose_runs("config", ["seed=range(0,20000)"])] == list(
        range(20000)
    )  # in seconds
    # All cells get their first seed before any gets its second.
    assert [(run.seed, run.algorithm.name) for run in runs("seeds=2", "algorithm=sac,td3")] == [
        (0, "sac"), (0, "td3"), (1, "sac"), (1, "td3"),
    ]  # fmt: skip
    crossed = runs("cells=[{seed:[5,6],algorithm:[sac,td3]}]", "seeds=2")
    assert {(run.seed, run.algorithm.name) for run in crossed} == {
        (5, "sac"),
        (5, "td3"),
        (6, "sac"),
        (6, "td3"),
    }


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (("seeds=a,b",), r"seeds=\['a', 'b'\]"),
        (("seeds=3", "seed=1"), "seed and seeds"),
        (
            ("buffer=her_future,replay", "buffer.n_sampled_goal=2,4"),
            r"buffer\.n_sampled_goal: .*buffer=replay",
        ),
        (("cells=[3]",), r"cells=\[3\]"),
        (("seeds=1000000000",), "seeds=1000000000"),
        (
            ("seeds=100000", "algorithm.gamma=0.9,0.95"),
            "2 cells x 100000 seeds: a sweep has at most 100000 runs",
        ),
        (
            ("n_envs=range(0,1000)", "total_timesteps=range(1000,2000)"),
            "a sweep has at most 10000 cells",
        ),
        (
            ("seed=range(0,1000)", "total_timesteps=range(1000,2000)"),
            "1000 cells x 1000 seeds: a sweep has at most 100000",
        ),
        (("seed=1,4294967296",), "seeds="),
    ],
)
def test_an_invalid_sweep_is_refused_in_one_sentence(overrides, named):
    with pytest.raises(ConfigError, match=rf"^{named}[^\n]*$"):
        runs(*overrides)


@pytest.mark.slow
def test_an_override_applies_to_every_cell_with_the_key():
    expanded = runs("experiment=her_relabelling", "seeds=1", "algorithm.features=raw")
    assert {run.algorithm.features for run in expanded} == {"raw"}
    assert len({run.run_key for run in expanded}) == len(expanded) == 21
    expanded = runs(
        "experiment=her_ablation", "seeds=1", "env=parking_crowded", "buffer=her_final,replay"
    )
    assert Counter((run.env.name, run.buffer.name) for run in expanded) == {
        ("parking_crowded", "her_final"): 4, ("parking_crowded", "replay"): 1,
    }  # fmt: skip


@pytest.mark.slow
def test_several_experiments_run_one_after_the_other():
    expanded = runs("experiment=smoke,her_relabelling", "seeds=1")
    assert Counter(run.experiment_name for run in expanded) == {"smoke": 1, "her_relabelling": 22}


@pytest.mark.parametrize(
    "experiment", slow_but(["her_relabelling"], ["her_ablation", "her_relabelling"])
)
@pytest.mark.parametrize(
    ("budget", "steps"), [("small", 96_000), pytest.param("full", 256_000, marks=pytest.mark.slow)]
)
def test_every_cell_has_as_many_env_steps_and_updates(experiment, budget, steps):
    """Cells differ in buffer and env only: the same steps, updates, networks and evaluation."""
    expanded = runs(f"experiment={experiment}", f"budget={budget}", "seeds=1")
    assert {run.total_timesteps for run in expanded} == {steps}
    assert {run.update_round() for run in expanded} == {(1, 8)}
    rest = [
        run.plain() | {"buffer": None, "env": None}
        for run in expanded
        if run.algorithm.features != "raw"
    ]
    assert all(plain == rest[0] for plain in rest)
