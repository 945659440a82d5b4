"""The `xihe` command: here, or in a process of its own, which is `python -m xihe_blender` or another whole Blender.

Run as a module inside that Blender, it marks where the command begins: what Blender says before is not the command's.
"""

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

from xihe_blender.cli.main import main
from xihe_blender.lab.workers.processes import is_whole_blender, module_command

ROOT = Path(__file__).resolve().parents[2]
BEGINS = "---- the command begins ----\n"


def typed(*arguments):
    """What is started; warnings are errors in the command as well."""
    words = [str(argument) for argument in arguments]
    if is_whole_blender():
        return [*module_command("xihe_process"), *words]
    return [sys.executable, "-W", "error", "-m", "xihe_blender", *words]


def said(text):
    """`text` of a process without what a whole Blender said before the command began."""
    return text.partition(BEGINS)[2] if is_whole_blender() else text


def xihe(*arguments, **options):
    """Run the command; its exit code and what it said."""
    done = subprocess.run(typed(*arguments), cwd=ROOT, capture_output=True, text=True, timeout=100, **options)
    return subprocess.CompletedProcess(done.args, done.returncode, said(done.stdout), said(done.stderr))


def xihe_here(*arguments):
    """`xihe` in this process, which need not load Blender again."""
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


def assert_refused(done, *words):
    """Exit 2, nothing on stdout, and one line on stderr after any progress, with `words` in it."""
    lines = [line for line in done.stderr.splitlines() if not re.match(r" *\d+%  ", line)]
    assert (done.returncode, done.stdout, len(lines)) == (2, "", 1), done.stderr
    assert lines[0].startswith("xihe: ")
    for word in words:
        assert word in lines[0], lines[0]


if __name__ == "__main__":
    for stream in (sys.stdout, sys.stderr):
        print(BEGINS, end="", file=stream, flush=True)
    warnings.simplefilter("error")
    sys.exit(main())
