"""A command ends with one line and an exit code, by itself or by a signal."""

import signal

import pytest

from ins_nav.errors import ENDING_SIGNALS, InsNavError, for_people


def test_an_error_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    @for_people("ins_x")
    def main(wrong: bool) -> int | None:
        if wrong:
            raise InsNavError("no such bag")
        return None

    assert main(False) == 0
    assert main(True) == 1
    assert capsys.readouterr().err == "ins_x: no such bag\n"


def test_other_errors_keep_their_traceback() -> None:
    @for_people("ins_x")
    def main() -> int | None:
        raise ValueError("a fault of the program")

    with pytest.raises(ValueError, match="a fault of the program"):
        main()


@pytest.mark.parametrize("number", ENDING_SIGNALS)
def test_the_first_signal_ends_a_command_and_later_ones_are_ignored(number: signal.Signals) -> None:
    closed = []

    @for_people("ins_x")
    def main() -> int | None:
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(number)
            closed.append(True)
        return None

    before = signal.signal(number, signal.SIG_DFL)  # in the background of a shell SIGINT is ignored
    try:
        assert main() == 128 + number
        assert closed
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
