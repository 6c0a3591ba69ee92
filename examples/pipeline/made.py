"""What a run made on the server, so that nothing of it stays there, however the run ends."""

import signal
import sys
from contextlib import contextmanager


class Made:
    def __init__(self):
        self.paths = []
        self.asked_for_job = False
        self.busy = False
        self.stopped = False
        # SIGTERM is how a farm's manager stops a script, SIGINT is Ctrl-C.
        for one in (signal.SIGTERM, signal.SIGINT):
            signal.signal(one, self.stop)

    def stop(self, *_):
        self.stopped = True
        if not self.busy:
            sys.exit("stopped")

    @contextmanager
    def noting(self):
        """Gives a function that notes what is made. A stop waits until that is done: what was asked for is known, then."""
        self.busy = True
        try:
            yield self.paths.append
        finally:
            self.busy = False
        if self.stopped:
            sys.exit("stopped")

    def delete(self, server):
        """Deletes everything, the newest first: what needs a thing goes before it. What others need stays, and is named."""
        self.busy = True
        for path in reversed(self.paths):
            server.delete(path)
