"""Provenance of a run: versions of packages, git commit, CPU, and the command line."""

import platform
import re
import shlex
import subprocess
import sys
import time
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from parking_exp import __version__
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.foreign_files import read_object
from parking_exp.terminal import command_of, is_script

PROVENANCE_FILE = "provenance.json"
STARTED = "started_ms"  # entry of the file
PACKAGES = (
    "torch",
    "stable-baselines3",
    "highway-env",
    "gymnasium",
    "gymnasium-robotics",
    "mujoco",
    "numpy",
    "ompl",
    "hydra-core",
    "mlflow-skinny",
)


def provenance_tags() -> dict[str, str]:
    """Return the tags `version.<package>`, `git_commit`, `git_dirty` and `cpu`, where known."""
    tags = {"version.python": platform.python_version(), "version.parking-exp": __version__}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            tags[f"version.{package}"] = version(package)
    return tags | _git() | {"cpu": _cpu()}


def record_provenance(run_dir: Path) -> None:
    """Write a run's first start time, and the software and machine that train it now."""
    path = run_dir / PROVENANCE_FILE
    started_ms = read_object(path).get(STARTED) or time.time_ns() // 1_000_000
    write_json(path, {STARTED: started_ms, "tags": provenance_tags()})


def command_line() -> str | None:
    """Return the command line of this process, None unless it is a command of this package."""
    started = Path(sys.argv[0])
    if not is_script() and not started.name.startswith("parking-"):  # called from Python
        return None
    name = started.stem.removeprefix("parking-")
    return shlex.join([*command_of(name).split(), *sys.argv[1:]])


def _git() -> dict[str, str]:
    """Return the commit of this package's checkout, and whether tracked files differ from it."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return {}

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.check_output(
            command, stderr=subprocess.DEVNULL, text=True, timeout=10
        ).strip()

    with suppress(OSError, subprocess.SubprocessError):
        changes = git("status", "--porcelain", "--untracked-files=no")
        return {"git_commit": git("rev-parse", "HEAD"), "git_dirty": str(bool(changes)).lower()}
    return {}


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        text = info.read_text(encoding="utf-8", errors="replace")
        name = re.search(r"^model name\s*: *(.+)", text, re.MULTILINE)
        if name is not None:
            return name[1].strip()
    return platform.processor() or platform.machine()
