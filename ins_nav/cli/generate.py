"""Files generated from the declarations: config/ins.yaml, doc/parameters.md and tables of README.md.

``python -m ins_nav.cli.generate`` in the folder of the sources writes them; ``--check`` only lists the stale ones.
"""

import argparse
import math
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from ins_nav.aiding.base import Aid
from ins_nav.aiding.parameters import table
from ins_nav.aiding.registry import aid_classes
from ins_nav.config.parameters import Parameter, Value
from ins_nav.errors import InsNavError, for_people

_WIDTH = 120
_BEGIN, _END = "<!-- generated: {} -->", "<!-- end -->"
_YAML_HEAD = """\
# Every parameter of ins_nav with its default. Copy, keep what you change, leave out the rest.
# .nan means: not given. Generated from the declarations: make generate.
/**:
  ros__parameters:
"""
_PAGE_HEAD = """\
# Parameters

Every parameter of the nodes and of `ins_process`. Generated from the declarations: `make generate`.
"""


def parameter_file(rows: Iterable[Parameter]) -> str:
    """ROS 2 parameter YAML with every parameter at its default, its description before it."""
    lines, group = [], ""
    for row in rows:
        head, _, name = row.name.rpartition(".")
        if head and head != group:
            lines.append(f"    {head}:")
        group = head
        indent = "      " if head else "    "
        lines += textwrap.wrap(
            _description(row),
            _WIDTH,
            initial_indent=f"{indent}# ",
            subsequent_indent=f"{indent}# ",
            break_on_hyphens=False,
            break_long_words=False,
        )
        lines.append(f"{indent}{name}: {_yaml(row.default)}")
    return _YAML_HEAD + "\n".join(lines) + "\n"


def parameter_page(rows: Iterable[Parameter]) -> str:
    """Markdown page with a table for each group of parameters."""
    groups: dict[str, list[Parameter]] = {}
    for row in rows:
        groups.setdefault(row.name.rpartition(".")[0], []).append(row)
    tables = []
    for group, members in groups.items():
        cells = [[f"`{row.name}`", _default(row.default), _range(row), _description(row)] for row in members]
        tables.append(f"## {group or 'Others'}\n\n{_markdown(['name', 'default', 'range', 'meaning'], cells)}\n")
    return _PAGE_HEAD + "\n" + "\n".join(tables)


def aid_topics() -> str:
    """Markdown table of the topics of aids."""
    kinds = sorted(aid_classes(), key=lambda kind: kind.TOPIC)
    cells = [[f"`{kind.TOPIC}`", _types(kind.MESSAGE_TYPES), _prefix(kind), kind.TEXT] for kind in kinds]
    return _markdown(["topic", "type", "parameters", "content"], cells)


def with_table(text: str, name: str, content: str) -> str:
    """A text with another table between the markers of that name.

    Raises
    ------
    InsNavError
        There are no such markers.
    """
    begin = _BEGIN.format(name)
    head, found, rest = text.partition(f"{begin}\n")
    _, ends, tail = rest.partition(_END)
    if not (found and ends):
        raise InsNavError(f"no lines {begin} and {_END}: restore them")
    return f"{head}{begin}\n{content}\n{_END}{tail}"


def generated(folder: Path) -> dict[Path, str]:
    """Content of every generated file of a folder with the sources."""
    rows, readme = table(), folder / "README.md"
    return {
        folder / "config" / "ins.yaml": parameter_file(rows),
        folder / "doc" / "parameters.md": parameter_page(rows),
        readme: with_table(readme.read_text(encoding="utf-8"), "topics of aids", aid_topics()),
    }


def stale(folder: Path) -> list[Path]:
    """Generated files that differ from the declarations."""
    files = generated(folder).items()
    return [path for path, text in files if not path.exists() or path.read_text(encoding="utf-8") != text]


@for_people("generate")
def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="generate", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail when a file is stale")
    folder, check = Path.cwd(), parser.parse_args(argv).check
    if not (folder / "README.md").exists():
        raise InsNavError(f"{folder} is not the folder of the sources: change to it")
    found = stale(folder)
    for path in found:
        if not check:
            path.write_text(generated(folder)[path], encoding="utf-8")
        print(f"{path.relative_to(folder)}: {'stale' if check else 'written'}")
    return 1 if check and found else 0


def _prefix(kind: type[Aid[Any]]) -> str:
    return f"`{kind.NAME}.*`" if kind.rows({}) else ""


def _description(row: Parameter) -> str:
    """With the choices where the text does not name them."""
    if all(choice in row.description for choice in row.choices):
        return row.description
    return f"{row.description}; {', '.join(row.choices[:-1])} or {row.choices[-1]}"


def _yaml(value: Value) -> str:
    text: str = yaml.safe_dump(value, default_flow_style=True, width=math.inf)
    return text.removesuffix("\n").removesuffix("\n...")


def _default(value: Value) -> str:
    if isinstance(value, float):
        return "not given" if math.isnan(value) else f"{value:g}"
    if isinstance(value, list):
        return ", ".join(f"{x:g}" for x in value)
    return str(value).lower() if isinstance(value, bool) else f"`{value}`" if value else "empty"


def _range(row: Parameter) -> str:
    if math.isfinite(row.low) and math.isfinite(row.high):
        return f"{row.low:g} to {row.high:g}"
    return f"at least {row.low:g}" if math.isfinite(row.low) else ""


def _types(names: Iterable[str]) -> str:
    return ", ".join(name.replace("/msg/", "/") for name in names)


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
