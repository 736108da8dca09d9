"""ins_report: figures and tables out of result bags."""

import argparse
import sys
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

from ins_nav.errors import for_people
from ins_nav.report.comparison import compare
from ins_nav.report.series import ReportError, Track, read_reference, read_result
from ins_nav.report.table import rows_of, table


@for_people("ins_report")
def main(argv: Sequence[str] | None = None) -> int | None:
    """The command line."""
    args = _parser().parse_args(argv)
    names = _names(args.results)
    results = [read_result(path, name) for path, name in zip(args.results, names, strict=True)]
    reference = _reference(args.results, args.reference, args.reference_topic)
    for track in [*results, *([reference] if reference else [])]:
        if track.damage:
            print(f"ins_report: {track.damage}", file=sys.stderr)
    comparisons = [compare(result, reference) for result in results] if reference else []
    if args.table or args.output is None:
        print(f"against {reference.name}:" if reference else "no reference: --reference BAG gives one")
        pairs = zip_longest(results, comparisons)
        print(table({result.name: rows_of(result, comparison) for result, comparison in pairs}))
        for result in results:
            if (summary := result.diagnostics.get("summary", "navigating")) != "navigating":
                print(f"{result.name}, at the end: {summary}")
    if args.output is not None:
        from ins_nav.report import figures  # loading matplotlib takes longer than a table

        figures.save(figures.figure(results, reference, comparisons), args.output)
        print(args.output)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ins_report",
        description="Figures and tables out of result bags: of ins_process, or of live topics recorded.",
    )
    parser.add_argument("results", nargs="+", type=Path, metavar="RESULT", help="bag with /fix, /imu/data, /odometry")
    parser.add_argument(
        "--reference", type=Path, metavar="BAG", help="bag with the reference (default: the result bags themselves)"
    )
    parser.add_argument(
        "--reference-topic",
        metavar="TOPIC",
        help="NavSatFix topic to compare with, and imu, velocity or odometry beside it "
        "(default: the first in the bag of truth/fix, reference/fix, gnss/fix)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FIGURE", help="figure to write: .png, .pdf, .svg")
    parser.add_argument("--table", action="store_true", help="print the table (the default without -o)")
    return parser


def _names(paths: Sequence[Path]) -> list[str]:
    """The last parts of the paths, as many as distinguish them."""
    if len(set(paths)) < len(paths):
        raise ReportError(f"the same bag is given twice: {' '.join(map(str, paths))}")
    parts = [path.resolve().parts for path in paths]
    count = 1
    while len({p[-count:] for p in parts}) < len(parts) and count < max(map(len, parts)):
        count += 1
    return ["/".join(p[-count:]) for p in parts]


def _reference(results: Sequence[Path], given: Path | None, topic: str | None) -> Track | None:
    """The reference of the given bag, an error without one; else that of the first result bag with one."""
    if given is not None:
        reference = read_reference(given, topic)
        if reference is None:
            raise ReportError(f"{given}: has none of truth/fix, reference/fix, gnss/fix; give a --reference-topic")
        return reference
    for path in results:
        reference = read_reference(path, topic)
        if reference is not None:
            return reference
    return None
