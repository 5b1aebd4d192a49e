"""What long commands say on standard error, and how a command ends."""

import argparse
import io

import pytest

from dronepose import _progress
from dronepose._progress import Progress, duration
from dronepose.commands._running import GOES_ON, run


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """The time, which goes on when it is told."""
    now = [100.0]
    monkeypatch.setattr(_progress.time, "monotonic", lambda: now[0])
    return now


def test_durations():
    assert duration(59.4) == "59 s"
    assert duration(59.6) == "1 min 0 s"
    assert duration(7325) == "2 h 2 min"


def test_progress_in_a_file(clock):
    stream = io.StringIO()
    progress = Progress("rows", stream)
    for done, now in ((40, 100.0), (41, 101.9), (50, 105.0), (60, 110.0), (100, 116.0)):
        clock[0] = now
        progress(done, 100)
    progress.close()
    # What was done at the first call is of an earlier run.
    assert stream.getvalue().splitlines() == [
        "50/100 rows, 2.0 a second, 25 s left",
        "100/100 rows, 3.8 a second, 0 s left",
    ]


def test_progress_on_a_terminal(clock):
    stream = Terminal()
    progress = Progress("frames", stream)
    for done, now in ((0, 100.0), (300, 103.0), (301, 103.1), (400, 104.0)):
        clock[0] = now
        progress(done)
    progress.close()
    progress.close()
    assert stream.getvalue() == ("\r300 frames, 100.0 a second\r400 frames, 100.0 a second\n")


def test_what_is_quick_or_quiet_says_nothing(clock):
    stream = Terminal()
    for quiet, seconds in ((False, 1.0), (True, 9.0)):
        progress = Progress("rows", stream, quiet=quiet)
        progress(0, 2)
        clock[0] += seconds
        progress(2, 2)
        progress.close()
    assert stream.getvalue() == ""


def test_ends_of_a_command(capsys):
    parser = argparse.ArgumentParser(prog="x")
    parser.add_argument("--fail")

    def work(args):
        errors = {"value": ValueError("bad"), "type": TypeError("odd"), "stop": KeyboardInterrupt()}
        if args.fail:
            raise errors[args.fail]
        return 3

    assert run(parser, [], work) == 3
    assert run(parser, ["--help"], work) == 0
    assert run(parser, ["--none"], work) == 2
    capsys.readouterr()
    assert run(parser, ["--fail", "value"], work) == 1
    assert capsys.readouterr().err == "error: bad\n"
    with pytest.raises(TypeError):  # a fault of ours is not an input that was refused
        run(parser, ["--fail", "type"], work)
    assert run(parser, ["--fail", "type"], work, also=(TypeError,)) == 1
    capsys.readouterr()
    assert run(parser, ["--fail", "stop"], work) == 130
    assert capsys.readouterr().err == "stopped; nothing was written\n"
    parser.set_defaults(stopped=GOES_ON)
    assert run(parser, ["--fail", "stop"], work) == 130
    assert capsys.readouterr().err == "stopped; the same command goes on\n"
