"""A Redis of the tests' own, on a free port of this machine, that can be killed and started again."""

import signal
import subprocess
import time

from addon_tests.pure.edge_servers import free_port


class RedisServer:
    """Keeps an append-only file in `folder`. A machine without redis-server fails the tests: none are skipped."""

    def __init__(self, folder):
        self.port = free_port()
        self.folder, self.url, self._process = folder, f"redis://127.0.0.1:{self.port}/0", None

    def start(self):
        options = {"port": self.port, "bind": "127.0.0.1", "dir": self.folder, "appendonly": "yes", "save": ""}
        command = ["redis-server", *(word for name, value in options.items() for word in (f"--{name}", str(value)))]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        until = time.monotonic() + 20
        while not self._answers():
            assert self._process.poll() is None and time.monotonic() < until, "redis-server did not start"
            time.sleep(0.02)
        return self

    def kill(self):
        self._process.kill()
        self._process.wait()

    def hang(self):
        """Until it is woken it takes connections and answers none."""
        self._process.send_signal(signal.SIGSTOP)

    def wake(self):
        self._process.send_signal(signal.SIGCONT)

    def client(self):
        import redis

        return redis.Redis(port=self.port)

    def _answers(self):
        import redis

        try:
            with self.client() as client:
                return client.ping()
        except redis.ConnectionError:
            return False

    def __enter__(self):
        return self.start()

    def __exit__(self, *_):
        self.kill()
