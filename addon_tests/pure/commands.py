"""The `xihe` command in this process: its exit code and what it said, and whether that is how a mistake is refused."""

import contextlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from xihe_blender.cli.main import main

ROOT = Path(__file__).resolve().parents[2]


def xihe_here(*arguments):
    """Run `xihe`; in_blender/xihe_process.py has the same in a process of its own, which has to load Blender again."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err, contextlib.ExitStack() as stack:
        for descriptor, file, redirect in ((1, out, contextlib.redirect_stdout), (2, err, contextlib.redirect_stderr)):
            kept = os.dup(descriptor)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, descriptor)
            os.dup2(file.fileno(), descriptor)
            stack.enter_context(redirect(stack.enter_context(os.fdopen(descriptor, "w", closefd=False))))
        code = main([str(argument) for argument in arguments])
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        texts = [(file.seek(0), file.read())[1] for file in (out, err)]
    return subprocess.CompletedProcess(arguments, code, *texts)


def fresh_python(code, *arguments, check=True):
    """What came of `code` in a Python of its own, in which warnings are errors."""
    command = [sys.executable, "-W", "error", "-c", code, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=check)


def assert_refused(done, *words, after_progress=False):
    """Exit 2, nothing on stdout, and one line on stderr with `words` in it; `after_progress`, the last that is none."""
    lines = done.stderr.splitlines()
    if after_progress:
        lines = [line for line in lines if not re.match(r" *\d+%  ", line)]
    assert (done.returncode, done.stdout, len(lines)) == (2, "", 1), done.stderr
    assert lines[0].startswith("xihe: ")
    for word in words:
        assert word in lines[0], lines[0]
