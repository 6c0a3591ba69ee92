-- Times are milliseconds since 1970 UTC. Artifact columns are keys of the object store.

CREATE TABLE captures (
    id          TEXT PRIMARY KEY,
    sha256      TEXT NOT NULL UNIQUE,
    bytes       INTEGER NOT NULL,
    artifact    TEXT NOT NULL,
    report      TEXT NOT NULL,
    created_ms  INTEGER NOT NULL
) STRICT;

CREATE TABLE environments (
    id          TEXT PRIMARY KEY,
    sha256      TEXT NOT NULL UNIQUE,
    name        TEXT,
    bytes       INTEGER NOT NULL,
    artifact    TEXT NOT NULL,
    width       INTEGER NOT NULL,
    height      INTEGER NOT NULL,
    warnings    TEXT NOT NULL,
    created_ms  INTEGER NOT NULL
) STRICT;

CREATE TABLE jobs (
    id               TEXT PRIMARY KEY,
    capture_id       TEXT NOT NULL REFERENCES captures (id),
    retry_of         TEXT REFERENCES jobs (id),
    preset           TEXT NOT NULL,
    overrides        TEXT NOT NULL,
    device           TEXT NOT NULL,
    priority         INTEGER NOT NULL,
    state            TEXT NOT NULL CHECK (state IN
        ('queued', 'running', 'cancelling', 'succeeded', 'failed', 'cancelled')),
    created_ms       INTEGER NOT NULL,
    started_ms       INTEGER,
    finished_ms      INTEGER,
    attempts         INTEGER NOT NULL DEFAULT 0,
    -- Attempts since the last stored checkpoint; what caps a job that only ever crashes.
    idle_attempts    INTEGER NOT NULL DEFAULT 0,
    lease_token      TEXT,
    lease_until_ms   INTEGER,
    step             INTEGER NOT NULL DEFAULT 0,
    total            INTEGER NOT NULL,
    loss             REAL,
    psnr             REAL,
    gaussians        INTEGER,
    eta_seconds      REAL,
    message          TEXT,
    checkpoint       TEXT,
    checkpoint_step  INTEGER,
    model_id         TEXT,
    error_code       TEXT,
    error_detail     TEXT
) STRICT;

CREATE INDEX jobs_queue ON jobs (state, priority DESC, created_ms, id);

-- The last line of defence of a promise the statements keep already.
CREATE TRIGGER jobs_terminal_states_never_change
BEFORE UPDATE OF state ON jobs
WHEN OLD.state IN ('succeeded', 'failed', 'cancelled') AND NEW.state <> OLD.state
BEGIN
    SELECT RAISE (ABORT, 'a terminal job state never changes');
END;

CREATE TABLE events (
    seq     INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id  TEXT NOT NULL REFERENCES jobs (id),
    at_ms   INTEGER NOT NULL,
    kind    TEXT NOT NULL,
    data    TEXT NOT NULL
) STRICT;

CREATE INDEX events_of_job ON events (job_id, seq);

CREATE TABLE models (
    id          TEXT PRIMARY KEY,
    job_id      TEXT NOT NULL UNIQUE REFERENCES jobs (id),
    capture_id  TEXT NOT NULL REFERENCES captures (id),
    gaussians   INTEGER NOT NULL,
    card        TEXT NOT NULL,
    created_ms  INTEGER NOT NULL
) STRICT;

CREATE TABLE model_files (
    model_id      TEXT NOT NULL REFERENCES models (id),
    name          TEXT NOT NULL,
    content_type  TEXT NOT NULL,
    bytes         INTEGER NOT NULL,
    sha256        TEXT NOT NULL,
    artifact      TEXT NOT NULL,
    PRIMARY KEY (model_id, name)
) STRICT;

CREATE TABLE idempotency (
    key          TEXT PRIMARY KEY,
    fingerprint  TEXT NOT NULL,
    response     TEXT NOT NULL,
    created_ms   INTEGER NOT NULL
) STRICT;
