"""`ins_report`: figure and table, damaged bags, bad input as one line."""

import struct
from pathlib import Path

import numpy as np
import pytest
from report_harness import TRUTH, write, write_bags

from ins_nav.cli.report import main


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bags(tmp_path_factory.mktemp("bags"))


def png_size(path: Path) -> tuple[int, ...]:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n")
    return struct.unpack(">II", content[16:24])


def test_command_writes_figure_and_table(bags, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    arguments = [bags / "result", bags / "plain", "--reference", bags / "truth", "-o", picture, "--table"]
    assert main(list(map(str, arguments))) == 0
    output = capsys.readouterr().out
    assert "against /truth/fix" in output
    assert "+0.5000 (sigma" in output
    assert output.endswith(f"{picture}\n")
    assert png_size(picture) == (1600, 1000)


def test_command_without_a_reference(bags, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    assert main([str(bags / "result"), "-o", str(picture)]) == 0
    assert capsys.readouterr().out == f"{picture}\n"
    assert png_size(picture) == (1600, 1000)


def test_damaged_bag_is_read_as_far_as_it_goes(bags, tmp_path, capsys):
    content = next((bags / "result").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) // 2])
    assert main([str(cut), "--reference", str(bags / "truth")]) == 0
    output = capsys.readouterr()
    assert "is damaged" in output.err
    assert "+0.5000 (sigma" in output.out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["truth"], "truth: is not a result bag, it has no /fix; topics: /truth/fix,"),
        (["reslt"], "no such bag (did you mean"),
        (["result", "result"], "the same bag is given twice"),
        (["result", "--reference", "plain"], "plain: has none of truth/fix, reference/fix, gnss/fix"),
        (["result", "--reference", "truth", "--reference-topic", "truth/fx"], "(did you mean /truth/fix?)"),
        (["result", "--reference", "truth", "--reference-topic", "truth/imu"], "/truth/imu is of type sensor_msgs"),
        (["result", "--reference", "early"], "no time in common with /truth/fix"),
        (["result", "-o", "picture.xyz"], "cannot write the figure"),
        (["result", "-o", "no/such/folder.png"], "cannot write the figure: No such file or directory"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(bags, capsys, monkeypatch, arguments, complaint):
    monkeypatch.chdir(bags)
    if "early" in arguments and not Path("early").exists():
        write(Path("early"), TRUTH, np.arange(0.0, 5.0, 0.5))
    assert main(arguments) == 1
    output = capsys.readouterr().err
    assert output.startswith("ins_report: ")
    assert complaint in output
    assert output.count("\n") == 1
