"""Tests of an env of several lots, on one of which each scene is."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.seeding import np_random
from support.runs import call_script, config_refusal, refusal
from support.simulator_equality import find_mismatches

from parking_exp import compose, train
from parking_exp.config.settings import flatten_config
from parking_exp.evaluation.agents import find_agent
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_report import cell_data, figure_data
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.parking.scenes import NO_SLOT
from parking_exp.tasks.parking.stored_lot import stored_lot

NAMES = ("parallel", "bays", "angled", "dead_end")


def env_config(*overrides):
    return compose("env=parking_lots", *overrides).env


@pytest.mark.parametrize("level", ["easy", "normal", "hard", "extreme"])
def test_the_lots_are_those_of_their_own_envs(level):
    several = env_config(f"env.level={level}")
    assert tuple(several.lots) == NAMES
    for name, lot in several.lots.items():
        alone = compose(f"env=parking_{name}", f"env.level={level}").env
        assert lot.model_copy(update={"vehicles_count": None}) == alone.lot
        assert lot.vehicles_range(several.vehicles_count) == alone.vehicles_range


def test_the_first_number_of_a_scene_chooses_its_lot_and_the_others_are_that_lots():
    lot = lot_of(env_config("env.level=normal"))
    draws = np.random.default_rng(0).random((40, lot.n_draws))
    scenes = lot.scenes(draws)
    for row, (first, *others) in enumerate(draws):
        alone = lot_of(compose(f"env=parking_{NAMES[int(4 * first)]}", "env.level=normal").env)
        expected = alone.scenes(np.array([others[: alone.n_draws]]))
        n_cars = expected.vehicles.shape[1]
        # Where a lot has fewer slots than another one, its last slot is repeated.
        slots = np.minimum(np.arange(18), expected.slots.shape[1] - 1)
        np.testing.assert_array_equal(scenes.slots[row], expected.slots[0, slots])
        np.testing.assert_array_equal(scenes.vehicles[row, :n_cars], expected.vehicles[0])
        assert (scenes.vehicles[row, n_cars:] == NO_SLOT).all()
        for name in ("start", "goal", "slot_size", "box"):
            np.testing.assert_array_equal(getattr(scenes, name)[row], getattr(expected, name)[0])


def test_scenes_are_simulated_as_highway_env_does():
    config = env_config("env.level=normal", "env.observation.rays=8", "env.duration=20")
    assert find_mismatches(config, "biased", 16) == []
    firsts = [np_random(seed)[0].random() for seed in range(16)]
    assert {int(4 * first) for first in firsts} == {0, 1, 2, 3}


def test_what_all_lots_share_and_one_lot_can_be_overridden_and_a_lot_left_out():
    shared = env_config("env.lot.end_m=9").lots
    assert [lot.end_m for lot in shared.values()] == [9.0, 9.0, 9.0, 16.0]
    of_one = env_config("env.lots.angled.angle_deg=45", "+env.lots.angled.end_m=9").lots
    assert [lot.angle_deg for lot in of_one.values()] == [0.0, 90.0, 45.0, 90.0]
    assert [lot.end_m for lot in of_one.values()] == [8.0, 8.0, 9.0, 16.0]
    assert tuple(env_config("~env.lots.dead_end").lots) == NAMES[:3]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "+env.lots.bays.pitch_m=3.4",
            "env.lots.bays.pitch_m=3.4: slots overlap below 3.5 m",
        ),
        (
            "env.lots.dead_end.vehicles_count=8",
            "env.lots.dead_end.vehicles_count=8: env.lots.dead_end has 8 slots",
        ),
        (
            "+env.lots.bays.aisle_m=7",
            "env.lots.bays.aisle_m: there is no such key; did you mean 'aisle_width_m'?",
        ),
        ("+env.lots.a-b={}", "env.lots.a-b"),
        ("env.lots.bays=7", "env.lots.bays=7"),
        ("env.lots=null", "lots: name one or more, or choose an env that has one lot"),
    ],
)
def test_a_lot_that_cannot_be_is_one_sentence_that_names_it(override, message):
    assert message in config_refusal("env=parking_lots", override)


def test_features_have_the_symmetries_of_all_lots_and_the_largest_size():
    lot = lot_of(env_config("env.level=normal"))
    parts = [lot_of(compose(f"env=parking_{name}", "env.level=normal").env) for name in NAMES]
    assert lot.size_m == tuple(np.max([part.size_m for part in parts], axis=0))
    assert lot.nearest_row_m == min(part.nearest_row_m for part in parts)
    assert (lot.is_turn_symmetric, lot.handed, lot.same_walls) == (False, True, False)
    alike = lot_of(env_config("~env.lots.angled", "~env.lots.dead_end"))
    assert (alike.is_turn_symmetric, alike.handed) == (True, False)
    features = ParkingTask(env_config("env.level=normal")).features("ego_mirrored")[1]
    assert (features["turned"], features["handed"]) == (False, True)
    assert features["lot_size_m"] == lot.size_m


def test_a_report_has_no_picture_by_slot_and_rates_by_number_of_cars():
    config = env_config("env.level=normal")
    # As frames have it: ranges are text, numbers may have become floats, and other cells have keys
    # of their own.
    stored = {"env.lot.angle_deg": None}
    for key, value in flatten_config({"env": config.model_dump()}).items():
        stored[key] = value
        if isinstance(value, list):
            stored[key] = json.dumps(value)
        elif type(value) is int:
            stored[key] = np.float64(value)
    scenes = lot_of(config).from_seeds(range(60))
    again = stored_lot(stored).from_seeds(range(60))
    for name, array in vars(scenes).items():
        np.testing.assert_array_equal(array, getattr(again, name))

    episodes = pd.DataFrame({"scene": range(60), "outcome": "success"})
    data = cell_data([episodes], stored)
    n_cars, n_scenes = np.unique((scenes.vehicles != NO_SLOT).sum(axis=1), return_counts=True)
    assert [row["vehicles"] for row in data["vehicles"]] == n_cars.tolist()
    assert [row["n"] for row in data["vehicles"]] == n_scenes.tolist()
    assert "slots" not in data
    assert figure_data(episodes, stored) is None


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The directory of a run on all lots."""
    output = tmp_path_factory.mktemp("lots")
    overrides = ("env=parking_lots", "env.level=normal", "algorithm.features=ego_mirrored")
    return train(compose("experiment=smoke", *overrides, f"output_dir={output}")).run_dir


def test_an_agent_of_all_lots_is_evaluated_on_each_and_with_a_replay_of_all(trained):
    options = (f"run={trained}", "episodes=2", "simulator=vectorized", "env.duration=2")
    for name in NAMES:
        lot = (f"env=parking_{name}", "env.level=normal")
        done = call_script("evaluate", *options, *lot, code=0)
        assert done.stderr == ""
    done = call_script("evaluate", *options, "replay=true", code=0)
    assert done.stderr == ""


def test_lots_of_a_run_are_changed_one_by_one(trained):
    sections = "env.lots.parallel, env.lots.bays, env.lots.angled, env.lots.dead_end"
    assert refusal("evaluate", f"run={trained}", "env.lot.end_m=9") == (
        f"env.lot: a run keeps its lots one by one; change {sections}"
    )
    assert refusal("evaluate", f"run={trained}", "env.lots.bay.end_m=9") == (
        f"env.lots.bay: the run has no such lot; choose from {', '.join(NAMES)}"
    )


def test_an_agent_of_all_lots_keeps_its_features_on_one_of_them(trained):
    agent = find_agent(trained, Path(trained).parents[2])
    bays = compose("env=parking_bays", "env.level=normal").env
    extractor = agent.load(ParkingTask(bays)).actor.features_extractor
    assert (extractor.handed, extractor.lot_size_m) == (True, lot_of(agent.config.env).size_m)
