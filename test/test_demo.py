"""The demo, over real DDS, in its short form."""

import os
import subprocess
import sys
from pathlib import Path

from ros_harness import needs_ros

import ins_nav

ROOT = Path(ins_nav.__file__).parents[1]


@needs_ros
def test_demo_loses_no_sample_and_draws_its_figure(tmp_path):
    # 8 times real time: 13 s; the node's queue holds 1.25 s of it, for a loaded machine
    command = [sys.executable, ROOT / "demo" / "run.py", "--quick", "--rate", "8", "-o", tmp_path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    demo = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert demo.returncode == 0, demo.stderr
    assert "20000 / 20000 / 20000" in demo.stdout
    assert (tmp_path / "demo.png").stat().st_size > 10_000
