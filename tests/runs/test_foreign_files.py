"""Files that others may have put into an output directory: pipes, links, sparse files."""

import os

import pytest
from support.runs import names_in
from support.tracked_runs import finished_run

from parking_exp.config.paths import default_uri
from parking_exp.errors import ConfigError, UntrustedError
from parking_exp.runs.atomic_files import replacing, write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import (
    MAX_JSON,
    MAX_LARGE,
    MAX_SMALL,
    parse_plain_yaml,
    read_file,
    read_json,
    read_object,
    sha256,
)
from parking_exp.runs.lookup import find_runs, find_runs_below
from parking_exp.runs.run_files import read_config
from parking_exp.runs.run_state import read_state
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import sync_missing

NAMES = [
    "status.json",
    "config.yaml",
    "result.json",
    "beat.json",
    "metrics.jsonl",
    "models",
    "curves.png",
    ".claim",
]


def replace_by_pipe(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


@pytest.mark.parametrize("name", NAMES)
def test_a_pipe_in_place_of_a_file_makes_no_command_wait(tmp_path, name):
    directory = finished_run(tmp_path)
    replace_by_pipe(directory.path / name)
    assert read_state(directory.path).stage in ("done", "pending")
    refusal = f"{name} is neither a file nor a directory; remove it"
    with pytest.raises(UntrustedError, match=refusal), directory.training_lock():
        pass


def test_a_pipe_in_place_of_a_file_is_not_sent(tmp_path):
    directory = finished_run(tmp_path)
    replace_by_pipe(directory.path / "curves.png")
    store = Store(default_uri(tmp_path), tmp_path)
    ((_, problem),) = sync_missing([directory], store)
    assert (
        problem == f"{directory.path / 'curves.png'} is neither a file nor a directory; remove it"
    )


@pytest.mark.parametrize("name", ["status.json", "config.yaml", "models"])
def test_a_link_to_itself_is_refused_in_a_sentence(tmp_path, name):
    directory = finished_run(tmp_path)
    (directory.path / name).unlink(missing_ok=True)
    (directory.path / name).symlink_to(name)
    with pytest.raises(
        UntrustedError, match=f"{name} is a symbolic link that leads nowhere; remove it"
    ):
        directory.check_links()


@pytest.mark.parametrize("depth", [101, 200_000])
def test_yaml_that_is_nested_deeply_is_refused(depth):
    with pytest.raises(ValueError, match=r"^it is nested too deeply$"):
        parse_plain_yaml(b"[" * depth + b"]" * depth)
    assert parse_plain_yaml(b"[" * 100 + b"]" * 100) is not None


@pytest.mark.parametrize(
    ("limit", "name"), [(MAX_JSON, "status.json"), (MAX_SMALL, "config.yaml"), (MAX_LARGE, "x")]
)
def test_no_more_is_read_than_a_file_can_have(tmp_path, limit, name):
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(limit + 1)
    with pytest.raises(OSError, match=f"It has more than {limit:,} bytes"):
        read_file(path, limit)
    assert read_object(path) == {}
    if name == "config.yaml":
        with pytest.raises(
            ConfigError, match=r"config.yaml can't be read: It has more than 1,048,576 bytes$"
        ):
            read_config(tmp_path, tmp_path)


@pytest.mark.slow
def test_files_of_any_size_have_a_hash(tmp_path):
    """The replay buffer of a checkpoint grows with the number of env steps."""
    path = tmp_path / "replay_buffer.npz"
    with path.open("wb") as file:
        file.truncate(MAX_LARGE + 1)
    digest = "b8030a8ab89280935633d8d991da3d9907c0f12e8b6fc3bfc515f4d440872b6e"
    assert sha256(path) == digest


def test_loops_of_links_count_no_run_twice(tmp_path):
    run = tmp_path / "sweep" / "cell" / "seed=0"
    run.mkdir(parents=True)
    (run / "status.json").write_text("{}")
    (tmp_path / "sweep" / "a-loop").symlink_to(".")
    (tmp_path / "sweep" / "b-cell").symlink_to("cell")
    (tmp_path / "again").symlink_to("sweep")
    (tmp_path / "self").symlink_to("self")
    assert find_runs(tmp_path) == [run]
    assert find_runs_below(tmp_path / "sweep") == [run]
    assert find_runs_below(tmp_path) == [run]


def test_the_next_write_removes_what_a_killed_process_left_and_nothing_else(tmp_path):
    process = os.fork()
    if process == 0:  # dies while it writes
        with replacing(tmp_path / "rates.json") as temporary:
            temporary.write_text("half")
            os._exit(0)
    os.waitpid(process, 0)
    assert len([*tmp_path.glob(".tmp-*")]) == 1
    (tmp_path / ".tmp-otherhost-1-rates.json").touch()
    write_json(tmp_path / "rates.json", {})
    assert names_in(tmp_path) == [
        ".tmp-otherhost-1-rates.json",
        "rates.json",
    ]


def test_processes_that_write_into_one_folder_at_once_do_not_disturb_each_other(tmp_path):
    processes = []
    for number in range(4):
        process = os.fork()
        if process == 0:
            try:
                for value in range(300):
                    write_json(tmp_path / f"{number}.json", value)
            except BaseException:
                os._exit(1)
            os._exit(0)
        processes.append(process)
    assert [os.waitpid(process, 0)[1] for process in processes] == [0, 0, 0, 0]
    assert [read_json(tmp_path / f"{number}.json") for number in range(4)] == [299] * 4


def test_a_pipe_in_place_of_a_lock_is_not_held(tmp_path):
    os.mkfifo(tmp_path / ".lock")
    assert not RunDirectory(tmp_path).is_locked
