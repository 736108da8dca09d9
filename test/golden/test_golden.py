"""`ins_process` reproduces the stored digests of five scenarios."""

import pytest
from golden.digest import Digest, differences, from_text, to_text
from golden.replay import SCENARIOS, digest_of, path_of


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_golden_replay(name: str) -> None:
    stored = from_text(path_of(name).read_text())
    computed = from_text(to_text("", digest_of(SCENARIOS[name])))
    found = differences(stored, computed)
    if found:
        shown = found if len(found) <= 24 else [*found[:12], "...", *found[-12:]]
        lines = [f"{name}: {len(found)} differences, stored -> computed:", *shown]
        pytest.fail("\n  ".join([*lines, f'when each is explained: make golden ARGS="{name}"']), pytrace=False)


def test_differences_name_row_value_and_size() -> None:
    columns = ("east", "heading", "s_east", "s_heading")

    def digest(east: str, heading: str, s_east: str, stopped: str) -> Digest:
        return {
            "solution": {"t, s": columns, "20.00": (east, heading, s_east, "0.1")},
            "stopped": {"12.10": (stopped,)},
        }

    stored = digest("10.0000", "359.9995", "0.5", "true")
    assert from_text(to_text("a title", stored)) == stored
    assert not differences(stored, digest("10.0040", "0.0003", "0.504", "true"))  # 0.8 % of each sigma
    assert differences(stored, digest("10.1000", "359.9995", "0.55", "false")) == [
        "solution, 20.00: east 10 -> 10.1 (+0.1, 0.2 sigma)",
        "solution, 20.00: s_east 0.5 -> 0.55 (+0.05, 0.1 of it)",
        "stopped, 12.10: true -> false",
    ]
