"""README and the pages of docs/: their links lead somewhere, their commands and examples run."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.marks import slow_but
from support.runs import ROOT
from support.store_factory import make_store

from parking_exp.tuning.search import Search

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
EXTENDING = ROOT / "docs" / "extending.md"
FENCE = re.compile(r"^```(\w*)(?: title=\"([^\"]+)\")?\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")

# One process for all commands: each is given to the entry point of its script, as a command line is. A training prints
# its plan, except where all of it is cheap; of the others Hydra prints the config.
RUN_COMMANDS = """
import contextlib, importlib, io, json, sys, tomllib, traceback

root, commands = sys.argv[1], json.loads(sys.argv[2])
sys.path[:0] = [root, "."]
with open(f"{root}/pyproject.toml", "rb") as file:
    entry_points = tomllib.load(file)["project"]["scripts"]
done = {}
for command, arguments in commands.items():
    module, function = entry_points[f"parking-{arguments[0]}"].split(":")
    sys.argv, output, code = arguments, io.StringIO(), 0
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            getattr(importlib.import_module(module), function)()
        except SystemExit as left:
            code = left.code or 0
        except BaseException:
            code = traceback.format_exc()
    done[command] = code, output.getvalue()
print("\\n" + json.dumps(done))
"""


def names(pages):
    return [str(page.relative_to(ROOT)) for page in pages]


def blocks(page, language):
    """Fenced blocks of a page: (title, text)."""
    return [(title, text) for found, title, text in FENCE.findall(page.read_text()) if found == language]


def commands(*pages):
    """What pages say to type at one of our scripts, without what goes before it, such as `time`."""
    lines = [line for page in pages for _, text in blocks(page, "sh") for line in text.replace("\\\n", "").split("\n")]
    found = (match[1] for line in lines if (match := re.search(r"python scripts/(.*)", line)))
    return list(dict.fromkeys(shlex.join(shlex.split(typed, comments=True)) for typed in found))


COMMANDS = [
    command
    for command in commands(
        *(page for page in PAGES if page != EXTENDING)
    )  # its commands need the files of its examples
    if not command.startswith("benchmark.py")  # measures at once
]


def arguments(command):
    """A command's name and its arguments, with what makes it cheap."""
    script, *typed = shlex.split(command)
    name = script.removesuffix(".py")
    shows = "--cfg" in typed or "--help" in typed
    cheap = [] if shows else ["dry_run=true"] if name in ("train", "tune") else ["--cfg", "job"]
    if "hydra/launcher=slurm" in typed:
        cheap.append("hydra.launcher.executor=local")  # a cluster's commands are missing elsewhere
    return [name, *(argument for argument in cheap if argument not in typed), *typed]


def anchors(page):
    """Ids of a page's headings."""
    text = FENCE.sub("", page.read_text())
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def run_commands(typed, cwd, root=ROOT):
    """Run command lines of a checkout in one process: {command: (exit status, output)}."""
    script = [sys.executable, "-c", RUN_COMMANDS, str(root), json.dumps(typed)]
    environment = {**os.environ, "PYTHONPATH": str(cwd)}
    done = subprocess.run(script, cwd=cwd, env=environment, check=False, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.rsplit("\n", 2)[-2])


@pytest.fixture(scope="module")
def done(request, tmp_path_factory):
    """What became of the commands that are tested now."""
    tested = {item.callspec.params.get("command") for item in request.session.items if hasattr(item, "callspec")}
    typed = {command: arguments(command) for command in COMMANDS if command in tested}
    folder = tmp_path_factory.mktemp("commands")
    for path in re.findall(r"experiment=(\S+\.yaml)", "\n".join(COMMANDS)):  # what a search would have left
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text("# @package _global_\nexperiment_name: tuned\n")
    return run_commands(typed, folder)


def test_the_readme_has_at_most_180_lines():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 180


@pytest.mark.parametrize("name", names(PAGES))
def test_no_line_is_longer_than_120_characters(name):
    lines = (ROOT / name).read_text().splitlines()
    assert [number for number, line in enumerate(lines, 1) if len(line) > 120] == []


@pytest.mark.parametrize("name", names(PAGES))
def test_relative_links_and_their_anchors_resolve(name):
    page = ROOT / name
    for target in LINK.findall(FENCE.sub("", page.read_text())):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked), target


def test_tests_that_the_threat_model_names_exist():
    text = (ROOT / "docs" / "threat_model.md").read_text()
    for path in re.findall(r"`(tests/\S+\.py)`", text):
        assert (ROOT / path).exists(), path
    tests = "\n".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    for name in re.findall(r"`(test_\w+)\*?`", text):
        assert f"def {name}" in tests, name


def test_every_room_has_a_page_of_the_reference():
    rooms = {path.parent.name for path in (ROOT / "parking_exp").glob("*/__init__.py")}
    pages = {path.stem for path in (ROOT / "docs" / "api").glob("*.md")}
    assert pages - {"index"} == rooms - {"cli"}


@pytest.mark.parametrize("command", slow_but([one for one in COMMANDS if "experiment=her" not in one], COMMANDS))
def test_a_command_can_be_typed(done, command):
    code, output = done[command]
    assert code == 0, output


EXAMPLES = names(page for page in PAGES if any(not title for title, _ in blocks(page, "python")))
EXPENSIVE = ["README.md", "docs/configuration.md", "docs/hindsight.md", "docs/reports.md"]


@pytest.mark.parametrize("name", slow_but([name for name in EXAMPLES if name not in EXPENSIVE], EXAMPLES))
def test_python_examples_run(name, output_dir, tmp_path, monkeypatch):
    if "load(" in (ROOT / name).read_text():
        make_store(output_dir, "her_ablation", {"four": ["buffer.n_sampled_goal=4"]}, seeds=range(1))
    monkeypatch.chdir(tmp_path)
    Path("outputs").symlink_to(output_dir)
    examples = [text for title, text in blocks(ROOT / name, "python") if not title]
    assert examples
    for text in examples:
        exec(compile(text, name, "exec"), {})  # one that breaks raises


def test_the_search_that_tuning_shows_can_be_searched(tmp_path):
    ((title, text),) = blocks(ROOT / "docs" / "tuning.md", "yaml")
    add(tmp_path / title, text)
    search = Search(["search=mine"], str(tmp_path / "my_conf"))
    search.check()
    assert [trial.get("algorithm", "sac") for trial in ({}, *search.request.search.enqueue)] == ["sac", "td3"]


@pytest.fixture(scope="module")
def extended(tmp_path_factory):
    """A copy of the repository with the examples of docs/extending.md in it, and their commands' outcomes."""
    copy = tmp_path_factory.mktemp("extended")
    for part in ("parking_exp", "conf", "scripts"):
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", copy)
    for language in ("python", "yaml"):
        for title, text in blocks(EXTENDING, language):
            add(copy / title, text)
    typed = {command: shlex.split(command.replace(".py", "", 1)) for command in commands(EXTENDING)}
    for command in typed:
        typed[command] += [] if "mine" in command else ["dry_run=true"]  # one run has all of them; of others the plan
    return copy, run_commands(typed, copy, copy)


def add(path, text):
    """Write a block as a new file, or add it to an old one, behind the line that it begins with."""
    path.parent.mkdir(parents=True, exist_ok=True)
    line = text[: text.index("\n") + 1]
    old = path.read_text() if path.exists() else line
    assert line in old
    path.write_text(old.replace(line, text))


@pytest.mark.slow
@pytest.mark.parametrize("command", commands(EXTENDING))
def test_what_extending_shows_runs(extended, command):
    code, output = extended[1][command]
    assert code == 0, output


@pytest.mark.slow
def test_the_examples_of_extending_show_in_what_they_extend(extended):
    outputs = extended[0] / "outputs"
    (result,) = outputs.glob("mine/parking_crowded-fading_sac-her_late-*/seed=0/result.json")
    assert "final/centred_rate" in result.read_text()
    assert "How many seeds" in (outputs / "reports" / "mine" / "index.html").read_text()
