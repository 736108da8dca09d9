"""ins_simulate: a recording with known truth, from a named scenario."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ins_nav.config.parameters import parse_assignment
from ins_nav.errors import InsNavError, for_people
from ins_nav.simulation.parameters import SHARED, Parameter
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import SCENARIOS, simulate


@for_people("ins_simulate")
def main(argv: Sequence[str] | None = None) -> int | None:
    """The command line."""
    args = _parser().parse_args(argv)
    if args.list:
        print(_listing())
        return 0
    if args.scenario is None:
        raise InsNavError("no scenario given; `ins_simulate --list` shows them")
    if args.output is None:
        raise InsNavError("no bag to write given; add -o BAG")
    if args.output.exists() and not args.overwrite:  # before the simulation, which takes time
        raise InsNavError(f"{args.output}: exists already; choose another name or add --overwrite")
    simulation = simulate(args.scenario, args.seed, **dict(map(parse_assignment, args.param)))
    messages = write_bag(simulation, args.output, args.overwrite, progress=True)
    size = sum(file.stat().st_size for file in args.output.iterdir())
    samples, p = len(simulation.stamps_ns), simulation.parameters
    print(
        f"{args.output}: {args.scenario}, seed {args.seed}, {samples / p['rate']:g} s, "
        f"{samples} IMU samples at {p['rate']:g} Hz, {messages} messages, {size / 1e6:.1f} MB"
    )
    for topic, fixes in simulation.aids.items():
        if topic.startswith("truth/") and len(fixes.stamps_ns):
            place = f"{math.degrees(fixes.lat[0]):.7f}°, {math.degrees(fixes.lon[0]):.7f}°, {fixes.height[0]:.2f} m"
            print(f"{topic} at first: {place}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ins_simulate", allow_abbrev=False, description="Simulate a scenario and write a bag with its truth."
    )
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="name of a scenario, see --list")
    parser.add_argument("-o", "--output", type=Path, metavar="BAG", help="folder of the bag to write")
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws (default: %(default)s)")
    parser.add_argument(
        "--param", action="append", default=[], metavar="NAME:=VALUE", help="set a parameter; may be repeated"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing bag")
    parser.add_argument("--list", action="store_true", help="show the scenarios and their parameters")
    return parser


def _listing() -> str:
    lines = []
    for name, scenario in SCENARIOS.items():
        lines.append(f"{name}: {scenario.text}")
        lines += [_line(n, p) for n, p in scenario.parameters.items() if p is not SHARED.get(n)]
        lines.append("")
    lines.append("every scenario, with these defaults unless given otherwise above:")
    lines += [_line(n, p) for n, p in SHARED.items()]
    return "\n".join(lines)


def _line(name: str, parameter: Parameter) -> str:
    default: Any = parameter.default
    if name.startswith("imu.") and not parameter.choices:
        shown = "preset"
    elif isinstance(default, tuple):
        shown = "[" + ", ".join(f"{number:g}" for number in default) + "]"
    else:
        shown = (default or "none") if isinstance(default, str) else f"{default:g}"
    choices = f" ({', '.join(parameter.choices)})" if parameter.choices else ""
    return f"  {name:<54} {shown:>12} {parameter.unit:<8} {parameter.text}{choices}"
