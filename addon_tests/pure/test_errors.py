"""What is said of a disk that is full or a file that cannot be written."""

import errno
import os

from xihe_blender.errors import format_disk_error


def test_a_full_disk_is_named_with_its_file_and_the_fix():
    words = os.strerror(errno.ENOSPC)
    assert format_disk_error(OSError(errno.ENOSPC, words, "room.npz")) == f"room.npz: {words}; free some space"
    assert format_disk_error(OSError(errno.EIO, "Input/output error")) == "Input/output error; fix that"
    assert format_disk_error(OSError("no picture: look at the disk")) == "no picture: look at the disk"
