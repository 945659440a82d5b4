"""Where SIGPIPE is not ignored, as inside Blender, a server or a helper that has gone is an OSError like elsewhere."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGPIPE"), reason="on Windows, which has no such signal")

AS_IN_BLENDER = "import signal; signal.signal(signal.SIGPIPE, signal.SIG_DFL)\n"

SERVER_CLOSED = """
import socket
from xihenet.edge.connection import Patience, PatientConnection, TryAgain
listening = socket.create_server(("127.0.0.1", 0))
connection = PatientConnection(f"http://127.0.0.1:{listening.getsockname()[1]}", Patience())
connection._connection = connection._new_connection()
connection._connection.connect()
listening.accept()[0].close()
try:
    connection.ask("POST", "/", bytes(100_000), {})
except TryAgain as again:
    print(again)
"""

PIPE_CLOSED = """
import os
from xihenet.broken_pipes import broken_pipes_raise
read, write = os.pipe()
os.close(read)
for _ in range(2):
    try:
        with broken_pipes_raise():
            os.write(write, b"x")
    except BrokenPipeError as error:
        print(error)
print("and goes on")
os.write(write, b"x")
"""


def ended(code):
    done = subprocess.run([sys.executable, "-c", AS_IN_BLENDER + code], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.splitlines()


def test_a_server_that_closed_the_connection_is_asked_again():
    code, (said,) = ended(SERVER_CLOSED)
    assert code == 0 and said.startswith(("BrokenPipeError", "ConnectionResetError"))


def test_a_closed_pipe_raises_inside_the_block_alone():
    code, said = ended(PIPE_CLOSED)
    assert said == ["[Errno 32] Broken pipe", "[Errno 32] Broken pipe", "and goes on"]
    assert code == -signal.SIGPIPE
