"""What goes wrong."""

from __future__ import annotations

from typing import Any


class RelumeError(Exception):
    """The server refused a request.

    `status` is that of HTTP, `kind` the last part of the problem's type (docs/errors.md lists them), `errors` name the fields
    at fault, and `request_id` finds the request in the server's log.
    """

    def __init__(self, status: int, problem: dict[str, Any]) -> None:
        self.status = status
        self.kind = str(problem.get("type", "")).rsplit(":", 1)[-1]
        self.detail = problem.get("detail")
        self.errors: list[dict[str, Any]] = list(problem.get("errors") or [])
        self.request_id = problem.get("request_id")
        fields = "; ".join(f"{e.get('pointer')}: {e.get('detail')}" for e in self.errors)
        told = [str(problem.get("title") or f"HTTP {status}"), fields or self.detail]
        super().__init__(": ".join(part for part in told if part))


class Unreachable(Exception):
    """The server did not answer, however often it was asked."""


class JobFailed(Exception):
    """A job ended without a model that may be used: failed, cancelled, or rejected by its quality gate."""

    def __init__(self, job: dict[str, Any]) -> None:
        self.job = job
        self.state = str(job["state"])
        why = (job.get("error") or {}).get("detail")
        missed = "; ".join(f"{m['figure']} is {m.get('found')}, wanted {m['wanted']}" for m in job.get("missed") or [])
        super().__init__(": ".join(part for part in (f"job {job['id']} {self.state}", why, missed) if part))


class ExportFailed(Exception):
    """An export ended without a file: it failed or was cancelled."""

    def __init__(self, export: dict[str, Any]) -> None:
        self.export = export
        self.state = str(export["state"])
        why = (export.get("error") or {}).get("detail")
        super().__init__(": ".join(part for part in (f"export {export['id']} {self.state}", why) if part))
