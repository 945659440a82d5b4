""".npz files that may be cut short, damaged, or made by anyone: how are they read?

NumPy lets whatever goes wrong inside a file come out as what it is deep down: a broken zip or header, a shape larger
than memory, a member that is encrypted or packed by a method that is not there. Here all of it is one ValueError.
Nothing is unpickled, so no file can run code.
"""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

BROKEN_FILE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RuntimeError,  # encrypted; NotImplementedError, an unknown way of packing, is one
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What NumPy and zipfile were seen to raise, or say that they raise, for files that are none."""


def read_npz(path: Path, names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of the file by name: all, or those of `names` that it has; others are not even unpacked.

    ValueError if it is no sound .npz, OSError if it cannot be read.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files if names is None or name in names}
    except BROKEN_FILE as error:
        raise ValueError(f"not a sound .npz file ({type(error).__name__}: {error})") from None
