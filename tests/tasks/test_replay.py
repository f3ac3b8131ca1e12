"""Recorded episodes are those of the simulator, and their page shows them in a real browser."""

import base64
import json
import re
import zlib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.user_policies import FunctionPolicy

from parking_exp.config.compose import compose
from parking_exp.errors import VideoError
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.tasks.parking.episode_recording import MOTION, record_episodes
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.replay_page import render_replay
from parking_exp.tasks.parking.scene_shapes import scene_shapes
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.registry import make_task

SEEDS = range(100, 124)
CROWDED = (
    "env=parking_crowded",
    "env.obstacles=2",
    "env.duration=5",
    "env.success_goal_reward=0.27",
)
UNITS = {
    "x": 0.01,
    "y": 0.01,
    "heading": 0.001,
    "speed": 0.02,
    "acceleration": 0.1,
    "steering": 0.01,
}
HOSTILE = "</script><script>window.pwned = 1</script><img src=x onerror='window.pwned = 1'>"


@FunctionPolicy
def wander(observation):
    """Drive somewhere: some scenes crash, some succeed, some time out.

    Rows do not affect each other.
    """
    x, y, _, _, _, sin = observation["achieved_goal"].T
    throttle = 0.3 + 0.5 * np.cos(70 * x + 30 * y)
    return np.stack([throttle, np.sin(50 * y + 3 * sin)], axis=1)


@cache
def crowded_env():
    return compose(*CROWDED).env


def start(seeds):
    return Simulator(crowded_env(), lot_of(crowded_env()).from_seeds(seeds))


@cache
def recorded():
    return record_episodes(wander, crowded_env(), SEEDS)


def page(title="an agent"):
    return render_replay(recorded(), 5, title)


def unpack(html):
    """What the script of a page reads from it, with the differences added up again."""
    (packed,) = re.findall(r'<script type="text/plain" id="recording">(.*?)</script>', html)
    recording = json.loads(zlib.decompress(base64.b64decode(packed)))
    for series in recording["series"].values():
        for _ in range(series["differences"]):
            series["episodes"] = [
                np.cumsum(values, axis=-1).tolist() for values in series["episodes"]
            ]
    return recording


def test_an_episode_is_recorded_from_start_to_end_as_the_simulator_drives_its_scene_alone():
    for episode in recorded():
        simulator = start([episode.seed])
        rows = [[0.0, 0.0, simulator.state.heading[0], 0.0, 0.0, 0.0]]
        ended = False
        while not ended:
            actions = wander(simulator.observe())
            step = simulator.step(actions)
            ended = step.terminated[0] or step.truncated[0]
            state = simulator.state
            x, y = state.position[:, 0]
            rows.append(
                [x, y, state.heading[0], state.speed[0], *simulator.controls(actions)[:, 0]]
            )
        np.testing.assert_array_equal(episode.motion, rows)


def test_controls_are_in_units_of_the_car():
    full_throttle_to_the_right = np.array([[1.0, -1.0]])
    controls = start([0]).controls(full_throttle_to_the_right)
    np.testing.assert_allclose(controls, [[5.0], [-np.pi / 4]], rtol=1e-12)


def test_outcomes_and_steps_are_those_of_an_evaluation():
    episodes = recorded()
    table = evaluate_policy(wander, make_task(crowded_env()), SEEDS, simulator="vectorized")
    assert [episode.seed for episode in episodes] == table["scene"].tolist()
    assert [episode.outcome for episode in episodes] == table["outcome"].tolist()
    assert [len(episode.motion) - 1 for episode in episodes] == table["steps"].tolist()
    assert {*table["outcome"]} == {"crash", "timeout", "success"}


@pytest.mark.parametrize(
    "overrides",
    [
        CROWDED,
        ["env=parking_parallel", "env.level=normal"],
        ["env=parking_angled", "env.lot.angle_deg=[45,90]"],
    ],
)
def test_shapes_of_a_scene_are_those_of_highway_env(overrides):
    from highway_env.vehicle.objects import Landmark, Obstacle

    config = compose(*overrides).env
    scenes = lot_of(config).from_seeds(SEEDS)
    env = make_parking_env(config)
    for row, seed in enumerate(SEEDS):
        shapes = scene_shapes(scenes, row, walls=True)
        env.reset(seed=seed)
        lot = env.unwrapped
        obstacles = [item for item in lot.road.objects if isinstance(item, Obstacle)]
        (goal,) = [item for item in lot.road.objects if isinstance(item, Landmark)]
        others = [vehicle for vehicle in lot.road.vehicles if vehicle is not lot.vehicle]
        theirs = [lot.vehicle, *others, *obstacles]
        ours = [shapes["car"], *shapes["parked_cars"], *shapes["walls"], *shapes["obstacles"]]
        rectangles = [(*each.position, each.heading, each.LENGTH, each.WIDTH) for each in theirs]
        np.testing.assert_allclose(ours, rectangles, rtol=0, atol=1e-12)
        np.testing.assert_allclose(shapes["goal"][:3], [*goal.position, goal.heading], atol=1e-12)
        np.testing.assert_array_equal(shapes["goal"], shapes["slots"][scenes.goal[row]])
        lanes = lot.road.network.lanes_list()
        slots = [(*lane.position(lane.length / 2, 0), lane.length, lane.width) for lane in lanes]
        np.testing.assert_allclose(shapes["slots"][:, [0, 1, 3, 4]], slots, rtol=0, atol=1e-12)


def test_an_env_without_walls_and_obstacles_shows_none():
    scenes = lot_of(compose("env=parking").env).from_seeds([0])
    shapes = scene_shapes(scenes, 0, walls=False)
    for none in (shapes["walls"], shapes["obstacles"], shapes["parked_cars"]):
        assert none.shape == (0, 5)
    assert len(shapes["slots"]) == 28


def test_the_page_has_poses_and_controls_to_half_a_unit():
    recording = unpack(page())
    by_seed = {episode.seed: episode for episode in recorded()}
    assert recording["steps_per_s"] == 5
    for number, scene in enumerate(recording["scenes"]):
        motion = by_seed[scene["seed"]].motion
        for column, name in enumerate(MOTION):
            series = recording["series"][name]
            shown = np.array(series["episodes"][number]) * series["unit"]
            assert np.abs(shown - motion[:, column]).max() <= 0.5 * UNITS[name] + 1e-12
        assert recording["series"]["rays"]["episodes"][number] == []


def test_failures_come_first_and_each_kind_in_the_order_of_its_seeds():
    scenes = unpack(page())["scenes"]
    order = {"crash": 0, "timeout": 1, "success": 2}
    keys = [(order[scene["outcome"]], scene["seed"]) for scene in scenes]
    assert keys == sorted(keys)
    assert sorted(seed for _, seed in keys) == [*SEEDS]


def test_rays_are_recorded_in_metres_and_shown_to_a_decimetre():
    env = compose(*CROWDED, "env.observation.rays=5", "env.observation.rays_range_m=8").env
    (episode,) = record_episodes(wander, env, [SEEDS[0]])
    simulator = Simulator(env, lot_of(env).from_seeds([SEEDS[0]]))
    np.testing.assert_array_equal(episode.rays[[0]], 8 * simulator.observe()["observation"][:, -5:])
    step = simulator.step(wander(simulator.observe()))
    np.testing.assert_array_equal(episode.rays[[1]], 8 * step.observation["observation"][:, -5:])
    assert episode.rays.shape == (len(episode.motion), 5)
    (shown,) = unpack(render_replay([episode], 5, "rays"))["series"]["rays"]["episodes"]
    np.testing.assert_array_equal(shown, np.rint(episode.rays.T / 0.1))


def test_200_timeouts_of_cars_that_never_drive_smoothly_fit_into_a_megabyte():
    env = compose("env.add_walls=false").env
    rng = np.random.default_rng(0)

    @FunctionPolicy
    def act(observation):
        return rng.uniform(-1, 1, (len(observation["observation"]), 2))

    html = make_task(env).replay_page(act, range(200), "random actions")
    recording = unpack(html)
    lengths = [len(values) for values in recording["series"]["x"]["episodes"]]
    assert sum(lengths) > 200 * 490  # nearly all drive to the end
    assert len(html) < 1_000_000


def test_the_page_is_the_same_whatever_simulator_the_env_names():
    pages = []
    for simulator in ("vectorized", "highway_env"):
        env = compose(*CROWDED, f"env.simulator={simulator}").env
        pages.append(make_task(env).replay_page(wander, SEEDS, "an agent"))
    assert pages == [page()] * 2


def test_a_task_without_such_a_page_says_so():
    task = make_task(compose("env=gymnasium", "env.id=support.toy_tasks:BitFlip-v0").env)
    with pytest.raises(VideoError, match=r"^no replay: .*BitFlip-v0 has no page that plays"):
        task.replay_page(wander, [0], "bits")


def test_a_page_names_no_other_file_and_escapes_its_title():
    html = page(HOSTILE)
    others = r"<[^>]+(?:src|href)=|https?://(?!www\.w3\.org/2000/svg)|url\(|@import|fetch\("
    assert re.findall(others, html) == []
    assert HOSTILE not in html
    assert html.count("<script") == 2


@pytest.fixture
def tab(open_page, tmp_path):
    path = tmp_path / "replay.html"
    episodes = [replace(each, rays=np.ones((len(each.motion), 8))) for each in recorded()]
    path.write_text(render_replay(episodes, 5, HOSTILE), encoding="utf-8")
    tab = open_page(path, 360)
    tab.wait_for_selector("[aria-selected=true]")
    return tab


def chosen(tab):
    """The texts of the chosen episode, and the step that is shown."""
    text = tab.locator("[aria-selected=true]").inner_text()
    return " ".join(text.split()), tab.locator("#time").input_value()


def option_texts():
    texts = []
    for scene in unpack(page())["scenes"]:
        (episode,) = [each for each in recorded() if each.seed == scene["seed"]]
        texts.append(f"seed {episode.seed} {episode.outcome} {len(episode.motion) - 1} steps")
    return texts


def test_the_keyboard_chooses_episodes_and_steps(tab):
    first, second = option_texts()[:2]
    last = first.split()[-2]
    assert chosen(tab) == (first, "0")
    for key, shown in (
        ("ArrowUp", (first, "0")),
        ("ArrowRight", (first, "1")),
        ("ArrowRight", (first, "2")),
        ("ArrowLeft", (first, "1")),
        ("End", (first, last)),
        ("Home", (first, "0")),
        ("ArrowDown", (second, "0")),
        ("ArrowUp", (first, "0")),
    ):
        tab.keyboard.press(key)
        assert chosen(tab) == shown, key


def test_an_episode_plays_to_its_end_and_can_be_paused(tab):
    first = option_texts()[0]
    tab.locator("#pace").select_option("16")
    tab.locator("body").press("Space")
    tab.locator("#play", has_text="Play").wait_for()
    assert chosen(tab) == (first, first.split()[-2])

    tab.locator("#pace").select_option("0.5")
    tab.locator("#play").click()
    tab.locator("#clock", has_not_text="step 0 of").wait_for()
    tab.locator("body").press("Space")
    assert tab.locator("#play").inner_text() == "Play"
    clock = tab.locator("#clock").inner_text()
    tab.wait_for_timeout(100)
    assert tab.locator("#clock").inner_text() == clock


def test_the_page_draws_the_car_where_it_was_and_tells_speed_and_steering(tab):
    (episode,) = [each for each in recorded() if f"seed {each.seed} " in option_texts()[0]]
    before = tab.locator("#lot").screenshot()
    tab.keyboard.press("End")
    assert tab.locator("#lot").screenshot() != before
    outputs = tab.locator(".chart output").all_inner_texts()
    speed = float(outputs[2].split()[0].replace("\N{MINUS SIGN}", "-"))
    steering = float(outputs[3].split()[0].replace("\N{MINUS SIGN}", "-"))
    assert speed == pytest.approx(episode.motion[-1, 3], abs=0.06)
    assert steering == pytest.approx(np.degrees(episode.motion[-1, 5]), abs=0.8)
    assert tab.locator("#legend-rays").is_visible()


def test_the_page_fits_a_phone_and_a_hostile_title_is_text(tab):
    assert tab.evaluate("document.scrollingElement.scrollWidth") <= 360
    assert tab.evaluate("window.pwned") is None
    assert tab.locator("h1").inner_text() == HOSTILE
    assert tab.title().startswith(HOSTILE)
