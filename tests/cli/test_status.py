"""Tests of the status command: the progress of runs, read from their directories."""

import json
import math
import time

import optuna
import pytest
from support.runs import call_script, refusal, store
from support.searches import SETTINGS

from parking_exp.config.compose import compose_runs
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import read_json
from parking_exp.runs.run_plans import write_plan
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.sweep import plan
from parking_exp.tuning.study import open_storage


def run_dir(output_dir, cell="cell-a", seed=0, **status):
    path = output_dir / "mine" / cell / f"seed={seed}"
    path.mkdir(parents=True)
    (path / "status.json").write_text(
        json.dumps({"total_timesteps": 1000, "label": cell[-1], **status})
    )
    return path


def status(output_dir, *arguments):
    """Run the command in this process."""
    return call_script("status", f"output_dir={output_dir}", *arguments, code=0)


def test_the_stage_follows_from_status_lock_and_heartbeat(tmp_path):
    now = time.time()
    done = run_dir(tmp_path, seed=0, status="done", steps=1000, success_rate=0.9, wall_s=12.0)
    failed = run_dir(tmp_path, seed=1, status="failed", error="ValueError: x", host="there")
    cut_off = run_dir(tmp_path, seed=2, status="running", host="there", started=now)
    running = run_dir(tmp_path, seed=3, status="running", host="here", started=now)
    (cut_off / "checkpoints" / "step=0000000300").mkdir(parents=True)
    RunDirectory(running).heartbeat(step=400, steps_per_s=20.0, doing="train")
    assert (read_state(done).stage, read_state(done).success_rate, read_state(done).wall_s) == (
        "done",
        0.9,
        12.0,
    )
    assert (read_state(failed).stage, read_state(failed).reason) == ("failed", "ValueError: x")
    assert (read_state(cut_off).stage, read_state(cut_off).step) == ("pending", 300)
    assert read_state(running).stage == "pending"  # nobody is at it
    with RunDirectory(running).supervisor_lock():
        state = read_state(running)
        RunDirectory(running).update_status(started=time.time() + 1)
        restarted = read_state(running)
    progress = (state.step, state.steps_per_s, state.left_s, state.host)
    assert (state.stage, *progress) == ("running", 400, 20.0, 30.0, "here")
    assert (restarted.step, restarted.doing) == (
        0,
        "starting",
    )  # the heartbeat is an earlier process's
    assert read_state(tmp_path / "mine" / "cell-b" / "seed=7").stage == "pending"


WRONG = {
    "status": ["done"],
    "label": 7,
    "error": {},
    "killed": "no",
    "total_timesteps": -1,
    "steps": "x",
    "success_rate": 7.5,
    "wall_s": 1e300,
    "cpu_s": True,
    "host": [],
    "pid": "1",
    "started": "now",
    "run_id": 3,
    "tracking_uri": ["a"],
}


def test_a_damaged_status_affects_only_its_run(tmp_path):
    run_dir(tmp_path, "cell-a", 0, status="done", steps=1000, success_rate=0.5, run_id="abc")
    nan = json.dumps({"status": "done", "success_rate": math.nan})
    for number, content in enumerate([json.dumps(WRONG), "{", "[]", "[" * 100_000, nan, "\xff"]):
        path = run_dir(tmp_path, "cell-b", number)
        (path / "status.json").write_bytes(content.encode("latin-1"))
        (path / "beat.json").write_text(
            json.dumps({"time": "x", "step": [], "steps_per_s": {}, "doing": 1})
        )
    shown = status(tmp_path)
    lines = shown.stdout.splitlines()
    assert [line.split() for line in lines[1:4]] == [
        ["a", "1", "50%"],
        ["cell-b", "6"],
        ["all", "1", "6"],
    ]
    assert [line.split()[:3] for line in lines[4:]] == [
        ["damaged", "cell-b", f"seed={n}:"] for n in range(6)
    ]
    plain = json.loads(status(tmp_path, "--json").stdout)
    assert [run["damaged"] for cell in plain["cells"] for run in cell["runs"]] == [
        False,
        *6 * [True],
    ]
    process = RunDirectory(tmp_path / "mine" / "cell-b" / "seed=0")
    with process.supervisor_lock():
        assert (read_state(process.path).stage, read_state(process.path).step) == ("running", 0)
    process.update_status(host="here")
    assert not read_state(process.path).damaged


def test_control_characters_of_a_foreign_run_are_escaped(tmp_path):
    evil = "x\x1b]0;t\x07\x9b31m\r\x7f\u202e\nfailed   other"
    run_dir(tmp_path, "cell-\x1b[2J", 0, status="failed", error=evil, label=evil, host=evil)
    held = RunDirectory(
        run_dir(tmp_path, "cell-b", 1, status="running", host=evil, started=time.time() - 1)
    )
    with held.supervisor_lock():
        held.heartbeat(step=1, steps_per_s=0.0, doing=evil)
        shown = status(tmp_path)
        plain = status(tmp_path, "--json")
    escaped = r"x\x1b]0;t\x07\x9b31m\r\x7f\u202e\nfailed   other"
    assert all(line.isprintable() for line in shown.stdout.split("\n"))
    assert (
        f"failed   “{escaped}” seed=0: {escaped}   {tmp_path}/mine/cell-\\x1b[2J/seed=0\n"
        in shown.stdout
    )
    assert f"running  b seed=1: 1 of 1000 steps, {escaped}   {escaped}\n" in shown.stdout
    assert plain.stdout.isascii()
    assert "\x7f" not in plain.stdout
    assert {cell["runs"][0]["host"] for cell in json.loads(plain.stdout)["cells"]} == {evil}


def test_status_shows_every_cell_in_a_table_and_as_json(tmp_path):
    run_dir(tmp_path, "cell-a", 0, status="done", success_rate=1.0)
    run_dir(tmp_path, "cell-a", 1, status="done", success_rate=0.5)
    failed = run_dir(tmp_path, "cell-b", 0, status="failed", error="killed by SIGKILL", killed=True)
    (run_dir(tmp_path, "cell-b", 1, status="interrupted") / "checkpoints" / "step=300").mkdir(
        parents=True
    )
    shown = status(tmp_path, "experiment=mine")
    assert [line.split() for line in shown.stdout.splitlines()] == [
        ["cell", "done", "running", "failed", "pending", "success"],
        ["a", "2", "75%"],
        ["b", "1", "1"],
        ["all", "2", "1", "1"],
        ["stopped", "b", "seed=1:", "resumes", "at", "step", "300", "of", "1000"],
        ["failed", "b", "seed=0:", "killed", "by", "SIGKILL", str(failed)],
    ]
    plain = json.loads(status(tmp_path, "--json").stdout)
    assert [plain[stage] for stage in ("done", "running", "failed", "pending")] == [2, 0, 1, 1]
    counted = [(cell["cell"], cell["done"], cell["failed"]) for cell in plain["cells"]]
    assert counted == [("cell-a", 2, 0), ("cell-b", 0, 1)]
    assert plain["cells"][1]["runs"][0]["reason"] == "killed by SIGKILL"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "there are no runs in "),
        (("experiment=mini",), "experiment=mini: it has no runs in "),
        (
            ("experment=mine",),
            "experment: there is no such key; did you mean 'experiment_name'?",
        ),
    ],
)
def test_status_refuses_in_one_sentence(tmp_path, arguments, message):
    if arguments:
        run_dir(tmp_path, status="done")
    assert refusal("status", f"output_dir={tmp_path}", *arguments).startswith(message)


def test_a_running_run_shows_step_rate_time_left_and_host(smoke, tmp_path):
    assert read_json(smoke.path / "beat.json")["step"] == 400  # a training writes them
    run = RunDirectory(run_dir(tmp_path, status="running", host="here", started=time.time() - 1))
    with run.supervisor_lock():
        run.heartbeat(step=400, steps_per_s=20.0, doing="train")
        shown = status(tmp_path).stdout
    assert (
        shown.splitlines()[-1]
        == "running  a seed=0: 400 of 1000 steps, 20 steps/s, 30 s left   here"
    )


def search_in(folder, **stored):
    """Write a search whose study has one trial."""
    study = optuna.create_study(
        study_name=folder.name, storage=open_storage(folder), direction="maximize"
    )
    study.add_trial(optuna.trial.create_trial(value=0.5))
    write_json(folder / "search.json", {"n_trials": 3, "search": SETTINGS, **stored})
    return study


@pytest.mark.parametrize(
    ("stored", "attributes", "problem"),
    [
        ({"search": SETTINGS | {"sampler": "gp"}}, {}, "sampler"),
        ({}, {"by_seed": ["x"]}, "the study mine can't be used: "),
    ],
)
def test_a_damaged_search_is_shown_beside_the_runs(tmp_path, stored, attributes, problem):
    folder = run_dir(tmp_path, status="done").parents[1]
    search_in(folder, **stored).add_trial(
        optuna.trial.create_trial(value=0.5, user_attrs=attributes)
    )
    lines = status(tmp_path).stdout.splitlines()
    assert lines[1].split() == ["a", "1"]
    assert lines[-1].startswith("search mine: ")
    assert problem in lines[-1]
    plain = json.loads(status(tmp_path, "--json").stdout)
    assert plain["done"] == 1
    assert problem in plain["searches"][0]["error"]


def test_cells_are_listed_in_the_order_of_the_plan_and_their_seeds_by_number(tmp_path):
    for number, cell in enumerate(["cell-d", "cell-a", "cell-c"]):
        for seed in (10, 2):
            run_dir(tmp_path, cell, seed, status="done", cell_number=number)
    run_dir(tmp_path, "cell-b", 0, status="done")  # not of a plan
    lines = status(tmp_path).stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["cell", "d", "a", "c", "b", "all"]
    plain = json.loads(status(tmp_path, "json=true").stdout)
    assert [cell["cell"] for cell in plain["cells"]] == ["cell-d", "cell-a", "cell-c", "cell-b"]
    assert [run["seed"] for run in plain["cells"][0]["runs"]] == [2, 10]


def test_trials_of_a_search_are_listed_by_their_numbers(tmp_path):
    for number in (10, 9, 0):
        run_dir(tmp_path, f"cell-{number}", 0, status="done", trial=number, label=f"trial {number}")
    lines = status(tmp_path).stdout.splitlines()
    assert [line.split()[1] for line in lines[1:4]] == ["0", "9", "10"]


def test_cells_of_two_plans_with_the_same_label_get_their_folders(tmp_path):
    run_dir(tmp_path, "parking-td3-her_future-0a", 0, status="done", label="td3")
    run_dir(tmp_path, "parking-td3-her_future-1b", 0, status="done", label="td3")
    lines = status(tmp_path).stdout.splitlines()
    first, second = "(parking-td3-her_future-0a)", "(parking-td3-her_future-1b)"
    assert [line.split()[:2] for line in lines[1:3]] == [["td3", first], ["td3", second]]


def planned(output_dir, seed, **status):
    path = run_dir(output_dir, "cell-a", seed, status="pending", **status)
    (path / "config.yaml").touch()
    return path


def test_prune_drops_runs_that_never_began_and_nothing_else(tmp_path):
    dropped = planned(tmp_path, 0)
    began = planned(tmp_path, 1, started=1.0)
    with_data = planned(tmp_path, 2)
    (with_data / "metrics.jsonl").touch()
    held = planned(tmp_path, 3)
    interrupted = run_dir(tmp_path, "cell-a", 4, status="interrupted")
    damaged = run_dir(tmp_path, "cell-a", 5)
    (damaged / "status.json").write_text("{")
    with RunDirectory(held).supervisor_lock():
        done = status(tmp_path, "prune=pending")
    assert done.stderr == f"dropped  {dropped}\n"
    assert set(tmp_path.glob("*/*/*")) == {began, with_data, held, interrupted, damaged}
    assert "a" in done.stdout.split()


def test_prune_of_all_runs_leaves_no_folder_behind(tmp_path):
    for seed in (0, 1):
        planned(tmp_path, seed)
    done = status(tmp_path, "prune=pending")
    assert done.stderr.count("dropped") == 2
    assert list(tmp_path.iterdir()) == []


def test_prune_marks_planned_runs_as_deleted_in_the_store(output_dir):
    (run,) = plan(compose_runs("config", ["experiment=smoke", f"output_dir={output_dir}"]))
    directory = RunDirectory(run.path)
    write_plan(directory, run.config, run.label, None)
    status(output_dir, "sync=true")
    assert [stored.info.run_id for stored in store(output_dir).search_runs(["1"])] == [
        directory.run_id
    ]
    status(output_dir, "prune=pending")
    assert store(output_dir).search_runs(["1"]) == []
    assert not run.path.exists()


def test_prune_takes_one_word(tmp_path):
    sentence = refusal("status", f"output_dir={tmp_path}", "prune=failed")
    assert sentence.startswith("prune='failed'")
