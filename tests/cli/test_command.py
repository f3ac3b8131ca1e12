"""The command line, as a process of its own."""

import contextlib
import errno
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.marks import slow_but
from support.runs import GROUPS, ROOT, call_script, names_in, options, refusal, run_code, script

from parking_exp.cli import status
from parking_exp.cli.command import _parse, errors_as_sentences

# One process for all command lines; modules that one of them imports stay imported.
IMPORTS = """
import importlib, json, os, sys
sys.path.insert(0, {root!r})
done = []
for name, arguments in json.loads(sys.argv[1]):
    sys.argv = [name, *arguments.split()]
    try:
        importlib.import_module(f"parking_exp.cli.{{name}}").main()
    except SystemExit:
        pass
    heavy = sorted({{"torch", "mlflow", "stable_baselines3", "pandas"}} & set(sys.modules))
    done.append([name, arguments, heavy, os.listdir()])
print(json.dumps(done), file=sys.stderr)
"""
LIGHT = [
    ("train", "--help"),
    ("train", "sead=1"),
    ("train", "n_envs=0"),
    ("train", "tracking.uri=http://me:word@host"),
    ("evaluate", "--help"),
    ("evaluate", "episodes=0"),
    ("evaluate", "total_timesteps=5"),
    ("evaluate", "run=nowhere"),
    ("export", "--help"),
    ("export", "format=onx"),
    ("export", "run=nowhere"),
    ("train", "algorithm=td3,ddpg,sac buffer=her_final,replay dry_run=true"),
]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["sead=1"], "sead: there is no such key; did you mean 'seed'?"),
        (["-m", "seed=0,1", "n_envs=0"], "n_envs=0: "),
        (["algorithm._target_=__main__.X"], "algorithm._target_=__main__.X: "),
        (["--n-envs=0"], "n_envs=0: "),
        (["--cfg"], "--cfg/-c: "),
        (["--cfg", "job", "sead=1"], "sead: "),
        (["--config-dir=/nope", "--dry-run"], "--config-dir=/nope "),
        (["output_dir=s3://bucket/x"], "output_dir: s3://bucket/x is a URI"),
        (["--dry-rum"], "dry_rum: there is no such key; did you mean 'dry_run'?"),
    ],
)
def test_a_bad_command_line_gets_a_sentence_and_leaves_nothing_behind(tmp_path, arguments, named):
    assert refusal("train", *arguments, cwd=tmp_path).startswith(named)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Modules imported by each command line, and files in its directory: {command line: (modules,
    files)}.
    """
    folder = tmp_path_factory.mktemp("light")
    done = run_code(IMPORTS.format(root=str(ROOT)), json.dumps(LIGHT), cwd=folder)
    imports = json.loads(done.stderr.splitlines()[-1])
    return {(name, argument): (heavy, files) for name, argument, heavy, files in imports}


@pytest.mark.parametrize(("name", "argument"), LIGHT)
def test_help_refusals_and_plans_import_nothing_heavy(imported, name, argument):
    assert imported[name, argument] == ([], [])


@pytest.mark.parametrize(
    "name", slow_but(["train"], ["train", "tune", "evaluate", "export", "report", "status"])
)
def test_help_lists_the_options_of_groups_and_examples(name):
    done = call_script(name, "--help", code=0)
    assert f"python scripts/{name}.py" in done.stdout
    assert [line for line in done.stdout.splitlines() if len(line) > 120] == []
    if name == "train":
        for group in GROUPS:
            assert f"{group}: {', '.join(options(group))} " in " ".join(done.stdout.split())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["a=1", "--json", "b=2"], (None, False, ["a=1", "json=true", "b=2"])),
        (["a=1", "--config-dir", ".", "b=2", "-m"], (".", True, ["a=1", "b=2"])),
        (
            ["her_final, n_sampled_goal=8", "-1"],
            (None, False, ["her_final, n_sampled_goal=8", "-1"]),
        ),
    ],
)
def test_flags_may_be_anywhere_between_the_overrides(words, expected):
    given, overrides = _parse(words)
    assert (given.config_dir, given.multirun, overrides) == expected


@pytest.mark.parametrize("name", ["status", "export"])
def test_commands_without_seeds_say_so(name):
    sentence = "seeds: this command has no such key; leave it out"
    assert refusal(name, "seeds=2") == sentence


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc")
def test_places_where_no_file_can_be_made_are_refused_in_a_sentence():
    path = "path=/proc/self/x.safetensors"
    exported = refusal("export", "run=pretrained", "format=safetensors", path)
    problem = "cannot be written: No such file or directory"
    assert exported == f"path: /proc/self/x.safetensors {problem}"
    trained = refusal("train", "experiment=smoke", "output_dir=/proc")
    assert re.fullmatch(rf"output_dir: /proc/\S+ {problem}", trained)


def test_a_disk_error_is_one_sentence(capsys):
    with pytest.raises(SystemExit), errors_as_sentences():
        raise OSError(errno.ENOSPC, "the disk says why", "file")
    assert capsys.readouterr().err == "error: the disk says why: file\n"
    with pytest.raises(FileNotFoundError), errors_as_sentences():
        raise FileNotFoundError(errno.ENOENT, "No such file", "x")


def test_config_dir_adds_options_and_cfg_shows_the_config_and_runs_nothing(tmp_path):
    (tmp_path / "mine" / "env").mkdir(parents=True)
    (tmp_path / "mine" / "env" / "short.yaml").write_text(
        "defaults: [parking]\nname: short\nduration: 0.2\n"
    )
    shown = call_script(
        "train",
        "--config-dir=mine",
        "env=short",
        "--cfg",
        "job",
        "experiment=tutorial",
        cwd=tmp_path,
    )
    assert "name: short\n" in shown.stdout and "total_timesteps: 10000\n" in shown.stdout
    assert names_in(tmp_path) == ["mine"]


@pytest.mark.slow
def test_a_wheel_has_the_commands_and_the_pretrained_agents(installed_wheel):
    """That its commands work is shown by those of the page about extensions."""
    commands = ("evaluate", "export", "report", "status", "train", "tune")
    assert names_in(installed_wheel / "bin") == [f"parking-{name}" for name in commands]
    for name in ("crowded", "default", "parallel", "parked"):
        folder = installed_wheel / "parking_exp" / "pretrained" / name
        assert names_in(folder) == ["README.md", "config.yaml", "policy.safetensors"]


def test_an_editable_install_has_the_console_scripts(tmp_path):
    command = [Path(sys.executable).parent / "parking-train", "sead=1"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.stderr == "error: sead: there is no such key; did you mean 'seed'?\n"


def test_the_help_of_an_installed_command_names_it_and_where_its_keys_are_explained(
    monkeypatch, capsys
):
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/parking-status", "--help"])
    with contextlib.suppress(SystemExit):
        status.main()
    shown = capsys.readouterr().out
    assert "  parking-status experiment=her_ablation watch=true\n" in shown
    assert f"Every key is explained in {ROOT}/conf/status.yaml." in shown
    assert "scripts" not in shown.replace(str(ROOT), "")


@pytest.mark.parametrize("key", ["null: 3", "algorithm:\n  null: 3"])
def test_a_key_that_is_null_is_one_sentence(tmp_path, key):
    (tmp_path / "mine.yaml").write_text(f"# @package _global_\nexperiment_name: mine\n{key}\n")
    assert refusal("train", "experiment=mine.yaml", cwd=tmp_path) == (
        "a config file has a key that is null or not a word; write it in quotes, as 'null'"
    )


def test_a_working_directory_that_was_deleted_is_one_sentence(tmp_path):
    command, keywords = script("status", cwd=tmp_path)
    inside = ["bash", "-c", 'mkdir gone && cd gone && rmdir ../gone && exec "$@"', "bash", *command]
    done = subprocess.run(inside, check=False, capture_output=True, **keywords)
    assert (
        done.stderr
        == "error: the working directory does not exist any more; change to one that does\n"
    )
