"""The command line, as a process of its own."""

import errno
import json
import re
import subprocess
import sys
from functools import cache

import pytest
from support.marks import slow_but
from support.runs import ROOT, options, run_script, script, type_here

from parking_exp.cli.command import _parse, errors_as_sentences
from parking_exp.config.compose import composed
from parking_exp.config.overrides import quoted

# One process for all command lines: what one of them imports is there in those behind it, too.
IMPORTS = """
import importlib, json, os, sys
sys.path.insert(0, {root!r})
done = []
for name, argument in json.loads(sys.argv[1]):
    sys.argv = [name, argument]
    try:
        importlib.import_module(f"parking_exp.cli.{{name}}").main()
    except SystemExit:
        pass
    heavy = sorted({{"torch", "mlflow", "stable_baselines3", "pandas"}} & set(sys.modules))
    done.append([name, argument, heavy, os.listdir()])
print(json.dumps(done), file=sys.stderr)
"""
LIGHT = [
    ("train", "--help"), ("train", "sead=1"), ("train", "algorithm.gamma=2"),
    ("evaluate", "--help"), ("evaluate", "episodes=0"), ("evaluate", "run=nowhere"),
    ("export", "--help"), ("export", "format=onx"), ("export", "run=nowhere"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sead=1"], "error: sead: there is no such key; did you mean 'seed'?\n"),
        (["env=parkin"], "error: env=parkin: there is no such option; did you mean 'parking'?\n"),
        (["algorithm.gamma=2"], "error: algorithm.gamma=2 is out of range; the closest valid choice is 1.0\n"),
        (["-m", "seed=0,1", "n_envs=0"], "error: n_envs=0 is out of range; the closest valid choice is 1\n"),
        (["seed=[1"], "error: seed=[1: can't be read; write KEY=VALUE, "),
        (
            ["algorithm._target_=__main__.X"],
            "error: algorithm._target_=__main__.X: __main__ is a script, not a module; ",
        ),
        (["seeds=4294967296"], "error: seeds=4294967296 makes 4294967296 runs; a sweep has 100000 at most\n"),
        (["env=null"], "error: env=null: leave it out, or choose from parking, "),
        (["experiment=smoke", "+nonsense=1"], "error: nonsense: there is no such key"),
    ],
)
def test_a_bad_command_line_gets_a_sentence_and_leaves_nothing_behind(tmp_path, arguments, message):
    done = type_here("train", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(message)
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """What command lines have imported, and what then lies in their directory: {command line: (modules, files)}."""
    command = [sys.executable, "-c", IMPORTS.format(root=str(ROOT)), json.dumps(LIGHT)]
    folder = tmp_path_factory.mktemp("light")
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stderr.splitlines()[-1])
    return {(name, argument): (heavy, files) for name, argument, heavy, files in found}


@pytest.mark.parametrize(("name", "argument"), LIGHT)
def test_help_and_refusals_import_nothing_heavy(imported, name, argument):
    assert imported[name, argument] == ([], [])


@cache
def help_of(name):
    return type_here(name, "--help")


def test_help_lists_the_groups_that_the_command_has_with_their_options():
    lines = help_of("train").stdout.splitlines()
    start = lines.index("Groups (group=option)") + 1
    listed = {line.partition(": ")[0]: line.partition(": ")[2] for line in lines[start : lines.index("", start)]}
    launchers = listed.pop("hydra/launcher")
    groups = ("env", "algorithm", "buffer", "budget", "evaluation", "checkpoint", "tracking", "experiment")
    assert listed == {group: ", ".join(options(group)) for group in groups}
    assert launchers.startswith("basic, local, ray, slurm ")


def test_help_names_groups_keys_and_examples():
    for name, words in {
        "train": [
            "algorithm: ",
            "env: parking, parking_2021",
            "total_timesteps: ",
            "python scripts/train.py experiment=tutorial",
        ],
        "evaluate": [
            "run: latest",
            "episodes: null",
            "python scripts/evaluate.py run=latest video=5 gif=true",
            "episodes=null means 100 scenes, or 20 for a pretrained agent. Every key is explained in conf/evaluate.yaml.",
        ],
        "export": [
            "run: latest",
            "format: onnx",
            "python scripts/export.py run=latest format=torchscript",
            "Every key is explained in conf/export.yaml.",
        ],
    }.items():
        done = help_of(name)
        assert done.returncode == 0
        assert [word for word in words if word not in done.stdout] == []
        assert [line for line in done.stdout.splitlines() if len(line) > 120] == []


INSTEAD = "is not supported here; put options of your own into a directory and pass --config-dir=DIRECTORY"


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("status", ["--jsn"], "--jsn: there is no such flag; did you mean '--json'?"),
        ("report", ["experiment=x", "--quik"], "--quik: there is no such flag; did you mean '--quick'?"),
        ("train", ["--seed=1", "n_envs=0"], "--seed: there is no such flag; write KEY=VALUE, without dashes"),
        ("train", ["--cfg"], "--cfg/-c: expected one argument"),
        ("train", ["--cfg", "job", "-m"], "Only one of --run, --multirun, --cfg, --info and --shell_completion can be specified"),
        ("train", ["--experimental-rerun", "x"], "--experimental-rerun is not supported here; rerun the same command to resume"),
        ("train", ["--config-name=nope"], f"--config-name {INSTEAD}"),
        ("tune", ["--config-path=/nope"], f"--config-path {INSTEAD}"),
        ("train", ["--config-dir=/nope", "--dry-run"], "--config-dir=/nope is not a directory"),
        ("train", ["hydra.launcher=3"], "hydra.launcher=3: hydra.launcher is a group of keys; write hydra.launcher.KEY=VALUE"),
        ("train", ["hydra=1"], "hydra=1: hydra is a group of keys; write hydra.KEY=VALUE"),
        ("status", ["--cfg", "job", "hydra=null"], "hydra=null: hydra is a group of keys; write hydra.KEY=VALUE"),
        ("train", ["--cfg", "job", "sead=1"], "sead: there is no such key; did you mean 'seed'?"),
    ],
)  # fmt: skip
def test_a_flag_that_cannot_be_is_refused_in_a_sentence(name, arguments, message, tmp_path):
    done = type_here(name, *arguments, cwd=tmp_path)
    assert (done.returncode, done.stderr, done.stdout) == (2, f"error: {message}\n", "")


@pytest.mark.parametrize(
    ("flags", "words", "expected"),
    [
        ({"--json": "json=true"}, ["a=1", "--json", "b=2"], ["a=1", "b=2", "json=true"]),
        ({}, ["a=1", "--config-dir", ".", "b=2"], ["a=1", "b=2"]),
        ({}, ["her_final, n_sampled_goal=8", "-1"], ["her_final, n_sampled_goal=8", "-1"]),
    ],
)
def test_flags_stand_anywhere_between_the_words(flags, words, expected):
    assert _parse(words, flags).overrides == expected


@pytest.mark.parametrize("arguments", slow_but([["--help"]], [["--help"], ["--cfg", "all"]]))
def test_what_is_shown_may_be_cut_off_by_a_pipe(arguments):
    command, keywords = script("train", *arguments)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **keywords)
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(60) == 1


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES, errno.EDQUOT])
def test_an_error_of_the_disk_is_a_sentence(number, capsys):
    with pytest.raises(SystemExit), errors_as_sentences():
        raise OSError(number, "the disk says why", "file")
    assert capsys.readouterr().err == "error: the disk says why: file\n"


@pytest.mark.parametrize(
    "error", [FileNotFoundError(errno.ENOENT, "No such file", "x"), OSError("odd"), ConnectionResetError()]
)
def test_another_error_of_the_system_keeps_its_traceback(error):
    with pytest.raises(type(error)), errors_as_sentences():
        raise error


def test_an_output_directory_that_cannot_be_made_gets_a_sentence(tmp_path):
    (tmp_path / "file").touch()
    done = type_here("train", "experiment=smoke", f"output_dir={tmp_path / 'file' / 'outputs'}")
    assert done.returncode == 2
    assert re.match(r"error: output_dir: .* cannot be made: Not a directory$", done.stderr)
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("seed=1", "seed=1"),
        ("run=outputs/a/seed=0", "run='outputs/a/seed=0'"),
        ("output_dir=/my runs/it's", r"output_dir='/my runs/it\'s'"),
        ("output_dir='/my runs'", "output_dir='/my runs'"),
        ("output_dir=/plain", "output_dir=/plain"),
    ],
)
def test_paths_that_hydras_grammar_cannot_read_are_quoted(argument, expected):
    assert quoted(argument) == expected
    assert composed("evaluate", [quoted("run=outputs/a/seed=0")])[0].run == "outputs/a/seed=0"


def test_showing_the_config_runs_nothing(tmp_path):
    done = type_here("train", "--cfg", "job", "experiment=tutorial", cwd=tmp_path)
    assert done.returncode == 0
    assert "total_timesteps: 10000" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_hydras_own_config_dir_adds_options(tmp_path):
    (tmp_path / "mine" / "env").mkdir(parents=True)
    (tmp_path / "mine" / "env" / "short.yaml").write_text("defaults: [parking]\nname: short\nduration: 0.2\n")
    arguments = ("--config-dir", str(tmp_path / "mine"), "env=short")
    done = run_script("train", *arguments, "--cfg", "job", cwd=tmp_path)
    assert "name: short" in done.stdout
    joined = type_here("train", f"--config-dir={tmp_path / 'mine'}", "env=short", "--cfg", "job", cwd=tmp_path)
    assert joined.stdout == done.stdout
    refused = type_here("train", *arguments, "n_envs=0", cwd=tmp_path)
    assert refused.stderr == "error: n_envs=0 is out of range; the closest valid choice is 1\n"


@pytest.mark.slow
def test_a_multirun_runs_every_point(tmp_path):
    done = run_script(
        "train", "-m", "experiment=smoke", "seed=0,1", "total_timesteps=60", "tracking.mlflow=false",
        "evaluation.video_episodes=0", "evaluation.final_n_scenes=3", f"output_dir={tmp_path / 'outputs'}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = sorted(path.parent.name for path in tmp_path.glob("outputs/*/*/*/result.json"))
    assert found == ["seed=0", "seed=1"]


@pytest.mark.slow
def test_a_built_wheel_works_from_any_directory(tmp_path):
    """The wheel carries conf/ inside the package; what it prints shows that it is the wheel's."""
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation",
             "--wheel-dir", str(tmp_path), str(ROOT)]  # fmt: skip
    subprocess.run(build, check=True, capture_output=True, timeout=300)
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    unpack = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site), str(wheel)]
    subprocess.run(unpack, check=True, capture_output=True, timeout=300)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    code = f"import sys; sys.path.insert(0, {str(site)!r}); from parking_exp.cli.train import main; from parking_exp.config.compose import config_dir; print(config_dir()); main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "experiment=smoke", "total_timesteps=60", "evaluation.video_episodes=0", "hydra/launcher=local"],
        check=False, capture_output=True, text=True, cwd=elsewhere, timeout=180,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(site / "parking_exp" / "conf"))
    assert (elsewhere / "outputs" / "mlflow.db").exists()
    assert (site / "hydra_plugins" / "parking_launcher" / "__init__.py").exists()
    assert not (site / "parking_exp" / "plugins").exists()
    for name in ("default", "parked"):
        files = {path.name for path in (site / "parking_exp" / "pretrained" / name).iterdir()}
        assert files == {"README.md", "config.yaml", "policy.safetensors"}
    assert sorted(path.name for path in (site / "bin").iterdir()) == [
        "parking-evaluate",
        "parking-export",
        "parking-report",
        "parking-status",
        "parking-train",
        "parking-tune",
    ]


def test_an_editable_install_has_the_console_scripts(tmp_path):
    from pathlib import Path

    done = subprocess.run(
        [Path(sys.executable).parent / "parking-train", "sead=1"],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.stderr == "error: sead: there is no such key; did you mean 'seed'?\n"
