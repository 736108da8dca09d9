"""Importing the package has no side effects: nothing heavy is loaded, nothing printed, written or configured."""

import json
import os
import subprocess
import sys
from pathlib import Path

from ins_nav.nodes import commands

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("matplotlib", "numba", "rclpy", "tqdm", "rosbags.typesys.stores.ros2_jazzy")
DRAWS = "ins_nav.report.figures"
"""The one module that needs matplotlib as a whole; `ins_nav.cli.report` imports it when a figure is requested."""
OWN_PROCESS = ("ins_nav.cli", "ins_nav.nodes")
"""Folders of commands: the environment of the process is theirs."""

PROGRAM = """
import importlib, json, os, sys
heavy, loaded, environment = set(sys.argv[1].split()), {}, {}
for name in sys.argv[2:]:
    before = dict(os.environ)
    importlib.import_module(name)
    new = sorted(heavy & sys.modules.keys())
    heavy -= set(new)
    if new:
        loaded[name] = new
    if os.environ != before:
        environment[name] = sorted(os.environ.items() - before.items())
print(json.dumps([loaded, environment]))
"""


def modules_without_ros() -> list[str]:
    """Every module that is imported without rclpy."""
    paths = sorted((ROOT / "ins_nav").rglob("*.py"))
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in paths]
    with_ros = [n for n in names if n.startswith("ins_nav.nodes.") and n != commands.__name__]
    return [name for name in names if name != DRAWS and name not in with_ros]


def test_import_has_no_side_effects(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", "HOME": str(tmp_path)}
    environment.pop("OPENBLAS_NUM_THREADS", None)
    command = [sys.executable, "-W", "error", "-c", PROGRAM, " ".join(HEAVY), *modules_without_ros()]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    *printed, result = done.stdout.splitlines()
    loaded, changed = json.loads(result)
    assert not loaded, "imported at module level; import inside the function that uses it"
    assert not [name for name in changed if name not in OWN_PROCESS], changed
    assert not printed and not done.stderr
    assert not list(tmp_path.iterdir())
