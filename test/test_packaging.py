"""package.xml, setup.py and the source agree, and colcon builds the executables for `ros2 run`."""

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import setuptools

import ins_nav

ROOT = Path(__file__).resolve().parents[1]
# Modules and projects whose rosdep key is not python3-NAME. Some are requirements of rosbags.
KEYS = {"pyyaml": "python3-yaml"} | dict.fromkeys(("rosbags", "apsw", "backports", "lz4"), "python3-rosbags-pip")
# Optional imports.
OPTIONAL = {"tf2_msgs"}


def manifest() -> ET.Element:
    return ET.parse(ROOT / "package.xml").getroot()


def setup_arguments() -> dict[str, Any]:
    with mock.patch.object(setuptools, "setup") as setup:
        runpy.run_path(str(ROOT / "setup.py"))
    return setup.call_args.kwargs


def entry_points() -> dict[str, str]:
    """Command -> "module:function"."""
    lines = setup_arguments()["entry_points"]["console_scripts"]
    return {name.strip(): target.strip() for name, target in (line.split("=") for line in lines)}


def test_manifest_setup_and_module_agree() -> None:
    root, setup = manifest(), setup_arguments()
    assert root.findtext("name") == setup["name"]
    assert root.findtext("version") == setup["version"] == ins_nav.__version__
    assert root.findtext("license") == setup["license"]
    person = root.find("maintainer")
    assert person is not None
    assert (person.text, person.get("email")) == (setup["maintainer"], setup["maintainer_email"])


def test_manifest_and_setup_require_the_same_projects() -> None:
    from_rosdep = {e.text for e in manifest().iter("exec_depend") if (e.text or "").startswith("python3-")}
    from_pypi = {re.split(r"[^\w.-]", requirement)[0] for requirement in setup_arguments()["install_requires"]}
    assert from_rosdep == {KEYS.get(name, f"python3-{name}") for name in from_pypi}


def test_annotations_are_installed() -> None:
    """PEP 561: without the marker, type checkers ignore the annotations of an installed package."""
    assert "py.typed" in setup_arguments()["package_data"]["ins_nav"]
    assert (ROOT / "ins_nav" / "py.typed").is_file()


@pytest.mark.parametrize("command", sorted(entry_points()))
def test_entry_point_is_defined(command: str) -> None:
    module, function = entry_points()[command].split(":")
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    assert path.is_file(), f"{command}: {path.relative_to(ROOT)} is missing"
    assert function in {n.name for n in ast.parse(path.read_text()).body if isinstance(n, ast.FunctionDef)}
    for package in list(path.relative_to(ROOT).parents)[:-1]:
        assert (ROOT / package / "__init__.py").is_file(), f"{package}/__init__.py is missing: setup.py leaves it out"


def test_every_import_is_declared() -> None:
    declared = {e.text for tag in ("depend", "exec_depend") for e in manifest().iter(tag)}
    missing = set()
    for path in (ROOT / "ins_nav").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            else:
                continue
            for name in {name.split(".")[0] for name in names} - sys.stdlib_module_names - OPTIONAL - {"ins_nav"}:
                if not {name, KEYS.get(name, f"python3-{name}")} & declared:
                    missing.add(f"{path.relative_to(ROOT)}: {name}")
    assert not missing, "not in package.xml"


def test_colcon_builds_a_ros_package(tmp_path: Path) -> None:
    colcon = shutil.which("colcon", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if colcon is None:
        pytest.skip("colcon is not installed")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True
    )
    if listed.returncode != 0:
        pytest.skip("not a git clone")
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            target = tmp_path / "src" / "ins_nav" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)

    def run(*arguments: str) -> str:
        done = subprocess.run([colcon, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "(ros.ament_python)" in run("list")
    run("build")
    prefix = tmp_path / "install" / "ins_nav"
    assert entry_points().keys() <= {path.name for path in (prefix / "lib" / "ins_nav").iterdir()}
    share = prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "ins_nav").is_file()
    for kind in ("config/*.yaml", "launch/*.launch.py"):
        assert {p.name for p in ROOT.glob(kind)} == {p.name for p in (share / "ins_nav").glob(kind)}
