"""Accuracy and speed, measured: ``python bench/run.py [SECTION ...]`` prints a markdown table or two a section."""

import argparse
import importlib
import os
import platform
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import ins_nav.cli  # noqa: F401  # one BLAS thread, before numpy
from ins_nav.errors import InsNavError, for_people
from ins_nav.recordings.bags import suggestion

ROOT = Path(__file__).resolve().parents[1]
SECTIONS = {
    "mechanization": "errors after 600 s of motion with a perfect IMU; coning",
    "alignment": "heading on a rocking base, against its sigma and the theoretical bound",
    "zupt": "drifts and azimuth found at stops: the paper's run, noise against the bound, real drives",
    "fine": "fine alignment on a rocking base, against its sigma and the Cramer-Rao bound; free inertial then",
    "underwater": "log, depth gauge, ranges, whole dives: against the sigma and the Cramer-Rao bound; faults",
    "faults": "every fault on a vehicle, a dive and a MEMS car: errors, sigmas, protection levels, reports, recovery",
    "files": "ins_process with every broken kind of state_file, parameter file and bag, a full disk, killed",
    "recordings": "real recordings, by ins_process and live",
    "aided": "real recordings with aids: accuracy, honesty of the sigmas, outages",
    "speed": "cost of a sample in the core, in the navigator, in ins_process",
    "live": "400 Hz over ROS 2: losses, latency, load",
}
_MODULES = {"fine": "fine_alignment", "aided": "aided_recordings", "files": "fault_files"}
"""Modules with another name than their section's."""


@for_people("bench")
def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    args = _parser().parse_args(argv)
    if args.list:
        print("\n".join(f"{name:14}{text}" for name, text in SECTIONS.items()))
        return 0
    # Folders of scripts, not packages: found from the root, by the processes that sections start too
    sys.path[0] = str(ROOT)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    if args.figure is not None:
        importlib.import_module("bench.zupt_figure").draw(args.figure)
        return 0
    print(f"{_machine()}; times are from a machine that others may use too", flush=True)
    for name in args.sections or SECTIONS:
        print(f"\n## {name}: {SECTIONS[name]}", flush=True)
        began = time.monotonic()
        more = {"seeds": args.seeds} if args.seeds and name in ("fine", "underwater", "faults") else {}
        if args.rows and name == "faults":
            more["rows"] = args.rows
        for text in importlib.import_module(f"bench.{_MODULES.get(name, name)}").results(args.data, **more):
            print(f"\n{text}", flush=True)
        print(f"\n({time.monotonic() - began:.0f} s; load now {os.getloadavg()[0]:.1f})", flush=True)
    return 0


def _machine() -> str:
    versions = ", ".join(f"{name} {importlib.import_module(name).__version__}" for name in ("numpy", "numba"))
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.partition(": ")[2] for line in lines if line.startswith("model name")), platform.machine())
    return f"{os.cpu_count()} x {model}, load {os.getloadavg()[0]:.1f}; Python {platform.python_version()}, {versions}"


def _section(name: str) -> str:
    if name not in SECTIONS:
        raise InsNavError(f"no section {name!r}{suggestion(name, SECTIONS)}")
    return name


def _seeds(text: str) -> int:
    count = int(text)
    if not 1 <= count <= 1000:
        raise argparse.ArgumentTypeError(f"{count} is not from 1 to 1000")
    return count


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="bench", description="Measure accuracy and speed.")
    parser.add_argument("sections", nargs="*", type=_section, metavar="SECTION", help="default: all; see --list")
    parser.add_argument("--list", action="store_true", help="name the sections")
    parser.add_argument(
        "--figure", type=Path, metavar="FILE", help="draw what ZUPT-2 does in the paper's run, instead of measuring"
    )
    parser.add_argument(
        "--data", type=Path, default=ROOT.parent / "shared" / "data", metavar="FOLDER", help="of the recordings"
    )
    parser.add_argument("--seeds", type=_seeds, metavar="N", help="of fine (default: 100), underwater (50), faults (1)")
    parser.add_argument(
        "--rows", metavar="PATTERN", help="of faults: those whose names match, * and ? as in file names"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
