"""Receives webhooks and accepts only messages with a valid signature of Standard Webhooks."""

import base64
import hashlib
import hmac
import json
import queue
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

# The maximum age of a message and difference of the clocks, seconds. An older message may be a replay.
TOLERANCE = 300
LONGEST_MESSAGE = 2**20


def is_genuine(secret, headers, body, now):
    """Whether `body` was signed with `secret` (`whsec_...`), at most TOLERANCE seconds from `now`."""
    identifier, sent_at = headers.get("webhook-id", ""), headers.get("webhook-timestamp", "")
    if not sent_at.isdigit() or abs(now - int(sent_at)) > TOLERANCE:
        return False
    signed = f"{identifier}.{sent_at}.".encode() + body
    secret_bytes = base64.b64decode(secret[len("whsec_") :])
    wanted = "v1," + base64.b64encode(hmac.new(secret_bytes, signed, hashlib.sha256).digest()).decode()
    # The header has several signatures during a rotation of the secret.
    return any(hmac.compare_digest(wanted.encode(), one.encode()) for one in headers.get("webhook-signature", "").split())


class Receiver:
    """Listens at `HOST:PORT` (port 0: any free port) until its `with` block ends."""

    def __init__(self, listen):
        host, _, port = listen.rpartition(":")
        self.secret = None
        self.messages = queue.Queue()
        self.http = ThreadingHTTPServer((host, int(port)), self.handler())
        self.url = f"http://{host}:{self.http.server_port}/"

    def handler(self):
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            # Timeout for reading from a sender, seconds.
            timeout = 30

            def do_POST(self):
                length = int(self.headers.get("Content-Length") or 0)
                body = self.rfile.read(length) if length <= LONGEST_MESSAGE else b""
                secret = receiver.secret
                believed = secret is not None and is_genuine(secret, self.headers, body, time.time())
                if believed:
                    receiver.messages.put(json.loads(body))
                self.send_response(204 if believed else 401)
                self.end_headers()

            def log_message(self, *_):
                pass

        return Handler

    def wait_for(self, job, patience, meanwhile, every=10):
        """The message about the end of `job`, or None after `patience` seconds. Calls `meanwhile` every `every` seconds without a message.
        Skips messages about other jobs; a message may arrive twice."""
        end = time.monotonic() + patience
        while (left := end - time.monotonic()) > 0:
            try:
                message = self.messages.get(timeout=min(every, left))
            except queue.Empty:
                meanwhile()
                continue
            if message["data"]["job"]["id"] == job:
                return message
        return None

    def __enter__(self):
        threading.Thread(target=self.http.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.http.shutdown()
        self.http.server_close()
