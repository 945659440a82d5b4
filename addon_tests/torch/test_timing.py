"""What the frontier does with torch's threads while it measures."""

import pytest
import torch

from xihe_blender.lab.frontier.timing import torch_on_one_thread


def test_torch_has_one_thread_while_computing_is_timed_and_then_as_many_as_before():
    torch.set_num_threads(2)
    with torch_on_one_thread():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2
    with pytest.raises(KeyError), torch_on_one_thread():
        raise KeyError
    assert torch.get_num_threads() == 2
