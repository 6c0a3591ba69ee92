"""Records the resources that a run creates on the server and deletes them, however the run ends."""

import signal
import sys
from contextlib import contextmanager


class Made:
    def __init__(self):
        self.paths = []
        self.asked_for_job = False
        self.busy = False
        self.stopped = False
        # A render farm stops a script with SIGTERM; Ctrl-C sends SIGINT.
        for one in (signal.SIGTERM, signal.SIGINT):
            signal.signal(one, self.stop)

    def stop(self, *_):
        self.stopped = True
        if not self.busy:
            sys.exit("stopped")

    @contextmanager
    def noting(self):
        """Yields a function that records a created path. A signal inside the block takes effect at its end, so every created path is recorded."""
        self.busy = True
        try:
            yield self.paths.append
        finally:
            self.busy = False
        if self.stopped:
            sys.exit("stopped")

    def delete(self, server):
        """Deletes all recorded paths, the newest first, because newer resources depend on older ones. Prints each that the server refuses to delete."""
        self.busy = True
        for path in reversed(self.paths):
            server.delete(path)
