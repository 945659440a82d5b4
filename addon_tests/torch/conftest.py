"""These tests need torch, which is an extra: where it is missing they are not collected, and the run says so."""

import importlib.util

import pytest

HAS_TORCH = importlib.util.find_spec("torch") is not None

collect_ignore_glob = [] if HAS_TORCH else ["test_*.py"]


def pytest_terminal_summary(terminalreporter):
    if not HAS_TORCH:
        terminalreporter.write_line("torch is not installed: addon_tests/torch was left out", yellow=True)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Sums in another order would not be the same to the last bit."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
