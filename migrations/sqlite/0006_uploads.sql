-- Uploads that arrive in pieces. `received` bytes of the file `uploads/<id>` are on disk; what is behind them is of no use.
CREATE TABLE uploads (
    id          TEXT PRIMARY KEY,
    tenant      TEXT NOT NULL,
    length      INTEGER NOT NULL,
    received    INTEGER NOT NULL,
    metadata    TEXT,
    created_ms  INTEGER NOT NULL,
    expires_ms  INTEGER NOT NULL,
    -- The capture that is being made of it, its hash, and why none could be made (JSON).
    capture_id  TEXT UNIQUE,
    sha256      TEXT,
    problem     TEXT,
    CHECK (received BETWEEN 0 AND length)
) STRICT;

CREATE INDEX uploads_of_tenant ON uploads (tenant);
