"""Driving a job: to its end, with progress, and to a clean stop."""

import fcntl
import io
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
import unicodedata

import pytest

from xihe_blender.cli.progress import progress_line
from xihe_blender.jobs import Progress, TimeLeft, interrupted_between_steps, run_blocking, timed


def count_to(total, log=None, action=None):
    """A job of `total` steps that notes its steps and its end in `log` and does `action` at the second."""
    log = [] if log is None else log
    try:
        for done in range(total):
            yield Progress(done, total, f"step {done}")
            log.append(done)
            if done == 1 and action is not None:
                action()
        return "result"
    finally:
        log.append("closed")


def press_ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)


def test_a_job_is_driven_to_its_end_and_gives_its_result():
    log = []
    assert run_blocking(count_to(3, log)) == "result"
    assert log == [0, 1, 2, "closed"]


def test_a_job_without_a_step_gives_its_result():
    assert run_blocking(count_to(0)) == "result"


def test_every_progress_is_shown_with_the_time_since_the_start():
    shown = []
    run_blocking(count_to(3), lambda progress, elapsed_s: shown.append((progress, elapsed_s)))
    assert [progress.done for progress, _ in shown] == [0, 1, 2]
    times = [elapsed_s for _, elapsed_s in shown]
    assert times == sorted(times) and times[0] >= 0


def test_the_seconds_of_a_job_are_those_in_which_it_works_and_not_those_in_which_its_window_waits(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: sum(now))

    def job():
        for done in range(3):
            now.append(1.0)
            yield Progress(done, 3, "working")
        now.append(1.0)
        return "result"

    assert run_blocking(timed(job()), lambda *_: now.append(100.0)) == ("result", 4.0)


def seconds_left(*steps):
    """After each of the (progress, seconds since the start)."""
    time_left = TimeLeft()
    return [time_left.after(progress, elapsed_s) for progress, elapsed_s in steps]


def test_the_time_left_follows_from_the_pace_without_the_first_step():
    steps = [(Progress(done, 6, ""), elapsed_s) for done, elapsed_s in enumerate((0, 30, 40, 42, 46))]
    assert seconds_left(*steps) == [None, None, 40, 18, 8], "the middle of 10, 2 and 4 s"


def test_stages_to_come_go_at_the_pace_of_the_last_one_and_carry_as_much_set_up():
    def at(done, capture, compare):
        left = {"capture": capture, "compare": compare} if capture else {"compare": compare}
        return Progress(done, 10, "", left)

    steps = [
        (Progress(0, 1, "surveying"), 0),
        (at(0, 4, 6), 50),
        (at(1, 3, 6), 60),
        (at(2, 2, 6), 62),
        (at(4, 0, 6), 66),
    ]
    # A capture takes 2 s, the first 8 s more; then comparing is measured.
    assert seconds_left(*steps, (at(7, 0, 3), 96), (at(9, 0, 1), 100)) == [None, None, None, 24, 20, 30, 2]


def test_jobs_that_follow_each_other_have_paces_of_their_own():
    captures = [(Progress(done, 0.03, "", {"capture": 0.03 - done}), 100 * done) for done in (0, 0.01, 0.02)]
    reading = [(Progress(done, 3, "reading"), 4 + done) for done in range(3)]
    probes = [(Progress(0, 3, "probe", {"probes": 3}), 8), (Progress(0, 59, "place"), 9)]
    assert seconds_left(*captures, *reading, *probes) == [None, None, pytest.approx(1), None, None, 1, None, None]


def test_what_is_told_within_a_unit_does_not_shorten_it():
    steps = [(0, "a", 0), (1, "b", 10), (1, "b: row 1", 40), (1, "b: row 2", 70), (2, "c", 70), (2, "c: row", 130)]
    assert seconds_left(*((Progress(done, 4, doing), at_s) for done, doing, at_s in steps))[-2:] == [120, 120]


def test_what_is_told_again_within_the_first_unit_does_not_shorten_it():
    captures = [(Progress(done, 5, "", {"captures": 2 - done, "probes": 3}), done) for done in (0, 1)]
    pictures = [(Progress(2, 5, "", {"probes": 3}), 2 + k) for k in range(10)]
    assert seconds_left(*captures, *pictures, (Progress(3, 5, "", {"probes": 2}), 12))[-1] == 20


def test_a_log_says_nothing_twice():
    stream = io.StringIO()
    show = progress_line(stream)
    for done in (0, 0, 1, 1, 2):
        show(Progress(done, 2, f"place {done}"), done)
    assert [line.split("  ")[-1].split(",")[0] for line in stream.getvalue().splitlines()] == [
        "place 0",
        "place 1",
        "place 2",
    ]


def test_work_that_was_done_before_makes_no_pace():
    resumed = [
        (Progress(0, 10, "", {"a": 10}), 0),
        (Progress(8, 10, "", {"a": 2}), 0.1),
        (Progress(9, 10, "", {"a": 1}), 5.1),
    ]
    assert seconds_left(*resumed)[-1] == pytest.approx(5)


def press_twice():
    press_ctrl_c()
    press_ctrl_c()
    raise AssertionError("the second one did not stop the step")


class OnPurpose(Exception):
    pass


def fail():
    raise OnPurpose


@pytest.mark.parametrize(
    ("action", "show", "error", "expected"),
    [
        (press_ctrl_c, None, KeyboardInterrupt, [0, 1, "closed"]),
        (press_twice, None, KeyboardInterrupt, [0, 1, "closed"]),
        (None, lambda progress, _: progress.done == 2 and press_ctrl_c(), KeyboardInterrupt, [0, 1, "closed"]),
        (fail, None, OnPurpose, [0, 1, "closed"]),
        (None, lambda progress, _: 1 / progress.done, ZeroDivisionError, ["closed"]),
    ],
    ids=["ctrl c in a step, which ends", "ctrl c twice", "ctrl c while shown", "error in a step", "error while shown"],
)
def test_what_ends_a_job_early_comes_out_as_it_is_and_closes_it(action, show, error, expected):
    log = []
    with pytest.raises(error):
        run_blocking(count_to(5, log, action), *([show] if show else []))
    assert log == expected


def test_ctrl_c_in_the_last_step_does_not_lose_the_result():
    assert run_blocking(count_to(2, action=press_ctrl_c)) == "result"


# In a process of its own, since what goes wrong here waits for ever.
TWICE_AT_ONCE = """
import os, signal, sys
from xihe_blender.jobs import Progress, run_blocking

def job(line):
    seen = [0]
    def press_at_the_line(frame, event, _):
        seen[0] += event == "line"
        if seen[0] == line:
            sys.settrace(None)
            os.kill(os.getpid(), signal.SIGINT)
        return press_at_the_line
    yield Progress(0, 1, "")
    sys.settrace(press_at_the_line)
    os.kill(os.getpid(), signal.SIGINT)
    sys.settrace(None)
    yield Progress(1, 1, "")

for line in range(1, 30):
    try:
        run_blocking(job(line))
    except KeyboardInterrupt:
        print(line)
"""


def test_a_second_ctrl_c_while_the_first_one_is_remembered_ends_the_job_too():
    said = subprocess.run([sys.executable, "-c", TWICE_AT_ONCE], capture_output=True, timeout=60, check=True).stdout
    assert said.split() == [b"%d" % line for line in range(1, 30)]


@pytest.mark.parametrize("action", [None, press_ctrl_c])
def test_the_handler_of_ctrl_c_is_put_back(action):
    before = signal.getsignal(signal.SIGINT)
    try:
        run_blocking(count_to(5, action=action))
    except KeyboardInterrupt:
        assert action is press_ctrl_c
    assert signal.getsignal(signal.SIGINT) is before


def test_off_the_main_thread_a_job_runs_without_handlers():
    results = []
    thread = threading.Thread(target=lambda: results.append(run_blocking(count_to(3))))
    thread.start()
    thread.join()
    assert results == ["result"]


def test_nothing_is_interrupted_that_was_not_asked_to():
    with interrupted_between_steps() as is_interrupted:
        assert not is_interrupted()
        press_ctrl_c()
        assert is_interrupted()


@pytest.mark.parametrize(
    ("name", "shown"), [("Chair", "Chair in frame 1"), ("x" * 200, "xxx..."), ("\u690d" * 50, "\u690d...")]
)
def test_progress_stays_on_one_line_of_a_terminal(monkeypatch, name, shown):
    monkeypatch.setenv("TERM", "xterm")
    lines = shown_on_terminal(f"measuring the light at {name} in frame 1")
    assert len(lines) == 1 and shown in lines[0]
    wiped, line = lines[0].rsplit("\r", 1)
    assert wiped == "\r" + 79 * " "  # No escape sequence, which not every console of Windows takes.
    columns = sum(1 + (unicodedata.east_asian_width(sign) == "W") for sign in line)
    assert columns < 80 and (columns > 76 or name == "Chair")


def test_a_terminal_that_cannot_go_back_gets_a_line_each(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    assert shown_on_terminal("capturing frame 1") == ["  0%  capturing frame 1"]
    assert shown_on_terminal("at a\nbreak") == ["  0%  at a break"]


def shown_on_terminal(doing):
    """Lines that a terminal of 80 columns is sent for the beginning of a job."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with os.fdopen(master, "rb") as screen, os.fdopen(slave, "w", encoding="utf-8") as stream:
        progress_line(stream)(Progress(0, 1, doing), 0.0)
        return os.read(screen.fileno(), 10_000).decode().rstrip("\r\n").split("\r\n")
