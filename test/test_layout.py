"""The tests mirror the package, and every folder states its purpose."""

import ast
import configparser
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(path.relative_to(ROOT / "ins_nav") for path in (ROOT / "ins_nav").rglob("*.py"))


@pytest.mark.parametrize("module", [m for m in MODULES if m.name != "__init__.py"], ids=str)
def test_a_module_has_its_test_file(module: Path) -> None:
    expected = Path("test") / module.parent / f"test_{module.name}"
    assert (ROOT / expected).is_file(), f"{expected} is missing"


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_a_module_has_at_most_500_lines(module: Path) -> None:
    assert len((ROOT / "ins_nav" / module).read_text().splitlines()) <= 500


@pytest.mark.parametrize("module", [m for m in MODULES if m.name == "__init__.py"], ids=str)
def test_a_folder_states_its_purpose(module: Path) -> None:
    assert ast.get_docstring(ast.parse((ROOT / "ins_nav" / module).read_text()))


def test_the_readme_shows_the_layers() -> None:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    layers = config["importlinter:contract:layers"]["layers"].split("\n")[1:]
    section = (ROOT / "README.md").read_text().partition("## How it is built")[2].partition("\n## ")[0]
    assert re.findall(r"^    (\w+(?: \| \w+)*)  ", section, re.MULTILINE) == layers
