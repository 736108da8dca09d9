"""The registry: every aid of a file in the folder."""

import importlib
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import ins_nav.aiding
from ins_nav.aiding.base import AidParameters
from ins_nav.aiding.parameters import configuration, table
from ins_nav.aiding.registry import aid_classes, aid_rows, by_topic, calibration_names, create_aids
from ins_nav.recordings.bags import message

AID = """
    from dataclasses import dataclass

    from ins_nav.aiding.base import Aid, AidParameters, Reading
    from ins_nav.config.declaration import parameter


    @dataclass(frozen=True)
    class OtherParameters(AidParameters):
        more: float = parameter(1.0, "one more", low=0.0)


    class Other(Aid[OtherParameters]):
        NAME, TOPIC, MESSAGE_TYPES, TEXT, PARAMETERS = "other", "other", ("std_msgs/msg/Bool",), "", OtherParameters

        def read(self, message):
            return Reading((1.0,), (), 0)

        def measure(self, solution, own, observation):
            return None
"""


def test_every_aid_is_declared_whole() -> None:
    for kind in aid_classes():
        assert kind.TEXT and kind.__doc__ and issubclass(kind.PARAMETERS, AidParameters)
        assert all(message(name) is not None for name in kind.MESSAGE_TYPES)  # known types
        assert set(kind.CALIBRATION) <= {row.name for row in kind.rows({})}
        assert (kind.CALIBRATED == 0) == (kind.CALIBRATION == ())
    names = [row.name for row in table()]
    assert len(names) == len(set(names))


def test_aids_by_name_and_topic() -> None:
    aids = create_aids(configuration({"range.beacons": "a, b"}).values)
    assert len(by_topic(aids)) == len(aids)
    assert {"gnss", "log", "range/a", "beacon/b/fix"} <= aids.keys()
    assert {"gnss/fix", "log", "range/a", "beacon/b/fix"} <= by_topic(aids).keys()
    assert "log.scale" in calibration_names()


def test_a_file_is_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "other_aid.py").write_text(textwrap.dedent(AID))
    monkeypatch.setattr(ins_nav.aiding, "__path__", [*ins_nav.aiding.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    aid_classes.cache_clear()
    try:
        assert "other.more" in {row.name for row in aid_rows({})}
        assert create_aids(configuration({"other.more": 2.0}).values)["other"].parameters.more == 2.0
    finally:
        sys.modules.pop("ins_nav.aiding.other_aid")
        aid_classes.cache_clear()


def test_the_registry_imports_aids_at_the_first_call() -> None:
    code = "import sys, ins_nav.aiding.registry; sys.exit('ins_nav.aiding.gnss' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
