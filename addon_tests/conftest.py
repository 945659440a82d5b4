"""What all tests share. Hypothesis does not judge by the clock, since a busy machine is no defect."""

import gc
import os
import sys
import time

import pytest
from hypothesis import settings

import addon_tests.fuzz  # noqa: F401  registers the profile of the search
from addon_tests.hard_case import comes_out, table
from xihenet.child_processes import n_cores

__all__ = ["comes_out"]

EXIT_STATUS = pytest.StashKey[int]()

settings.register_profile("any_machine", deadline=None)
settings.load_profile("any_machine")


def pytest_addoption(parser):
    parser.addoption("--catalogue", action="store_true", help="print the hard cases that ran, and what came of them")
    parser.addoption("--until", type=float, default=float("inf"), help="start no test after this time, in Unix seconds")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """One process more than cores: a tenth of the time of two cores is waits, for servers, time-outs and processes."""
    return None if os.environ.get("PYTEST_XDIST_AUTO_NUM_WORKERS") else n_cores() + 1


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """Without looking for garbage: what is collected stays, and there is a seventh less to wait."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_runtest_setup(item):
    if time.time() > item.config.getoption("until"):
        pytest.skip("the time of the search is up")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    session.config.stash[EXIT_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """The wheel of Blender 4.5 waits for a thread of its own for ever where anything still refers to it at the end."""
    bpy, is_worker = sys.modules.get("bpy"), hasattr(config, "workerinput")
    if getattr(bpy and bpy.app, "module", False) and EXIT_STATUS in config.stash and not is_worker:
        config.get_terminal_writer().flush()
        sys.stderr.flush()
        os._exit(config.stash[EXIT_STATUS])


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("catalogue"):
        reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
        cases = [dict(report.user_properties)["hard_case"] for report in reports if report.user_properties]
        for line in table(cases):
            terminalreporter.write_line(line)
