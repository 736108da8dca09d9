"""Generated files: fresh, readable, and with every parameter."""

from pathlib import Path

import pytest
import yaml

from ins_nav.aiding.parameters import table
from ins_nav.aiding.registry import aid_classes
from ins_nav.cli import generate
from ins_nav.config.parameters import Parameter
from ins_nav.errors import InsNavError

SOURCES = Path(__file__).resolve().parents[2]


def test_generated_files_are_fresh() -> None:
    assert generate.stale(SOURCES) == [], "run `make generate`"


def test_every_parameter_is_in_the_page_and_every_topic_in_the_readme() -> None:
    page, readme = ((SOURCES / name).read_text(encoding="utf-8") for name in ("doc/parameters.md", "README.md"))
    for row in table():
        assert f"| `{row.name}` |" in page
    for kind in aid_classes():
        assert f"| `{kind.TOPIC}` |" in readme


def test_ros_reads_the_parameter_file() -> None:
    rows = [
        Parameter("a.way", "x", "which way", choices=("x", "y")),
        Parameter("a.arm", [0.0, 1e-4, 2.0], "where, m"),
        Parameter("b", "", "a text that is long enough " * 6),
    ]
    text = generate.parameter_file(rows)
    assert yaml.safe_load(text) == {"/**": {"ros__parameters": {"a": {"way": "x", "arm": [0.0, 1e-4, 2.0]}, "b": ""}}}
    assert "# which way; x or y\n" in text and max(map(len, text.splitlines())) <= 120


def test_stale_files_are_named_and_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "doc").mkdir()
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- generated: topics of aids -->\nold\n<!-- end -->\nafter\n")
    monkeypatch.chdir(tmp_path)
    assert generate.main(["--check"]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "README.md: stale"
    assert generate.main([]) == 0 and generate.main(["--check"]) == 0
    text = readme.read_text()
    assert text.startswith("before\n") and text.endswith("\nafter\n") and "old" not in text


def test_text_without_markers_is_refused() -> None:
    with pytest.raises(InsNavError, match="no lines <!-- generated: x -->"):
        generate.with_table("text", "x", "table")
