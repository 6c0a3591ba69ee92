"""Runs `openjd` with the given arguments and records the status messages that its session parses from the program's output.

At the end it prints the number of progress messages, the last percentage, the last status and the last failure message."""

import sys

from openjd.cli import main
from openjd.cli._run._local_session import _session_manager as manager

understood = []
told = manager.LocalSession._action_callback


def listen(self, session_id, status):
    understood.append(status)
    told(self, session_id, status)


manager.LocalSession._action_callback = listen
try:
    main(sys.argv[1:])
    code = 0
except SystemExit as ended:
    code = ended.code or 0


def last(field):
    return next((value for s in reversed(understood) if (value := getattr(s, field)) is not None), None)


told_progress = sum(status.progress is not None for status in understood)
print(f"understood: {told_progress} times progress, the last {last('progress')}; "
      f"status {last('status_message')!r}; failure {last('fail_message')!r}", flush=True)
sys.exit(code)
