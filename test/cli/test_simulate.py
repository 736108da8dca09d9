"""`ins_simulate`."""

from pathlib import Path

import pytest

from ins_nav.cli.simulate import main
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation.scenarios import SCENARIOS


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    command = ["static", "-o", str(bag), "--seed", "3", "--param", "duration:=2", "--param", "rate:=100"]
    assert main(command) == 0
    assert "static, seed 3, 2 s, 200 IMU samples at 100 Hz" in capsys.readouterr().out
    assert main(command) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert main([*command, "--overwrite", "--param", "imu.gyro_bias_deg_per_hour:=[1, 2, 3e-1]"]) == 0
    with BagReader(bag) as reader:
        assert reader.topics["/imu/data_raw"].count == 200

    assert main(["--list"]) == 0
    listing = capsys.readouterr().out
    for name, scenario in SCENARIOS.items():
        assert f"{name}: {scenario.text}" in listing
        assert all(parameter in listing for parameter in scenario.parameters)

    for wrong, expected in (
        (["-o", str(bag)], "--list"),
        (["static"], "add -o BAG"),
        (["static", "-o", str(tmp_path / "new"), "--param", "duration=2"], "name:=value"),
        (["static", "-o", str(tmp_path / "new"), "--param", "durtion:=2"], "did you mean duration"),
    ):
        assert main(wrong) == 1
        assert expected in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
