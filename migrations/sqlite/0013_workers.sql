-- Who takes jobs. `server` is the data directory whose server a worker is a thread of; one with a process of its own has none. One that
-- was not seen for a while is taken for dead, and its jobs go back to the queue.
CREATE TABLE workers (
    id          TEXT PRIMARY KEY,
    server      TEXT,
    name        TEXT NOT NULL,
    device      TEXT NOT NULL,
    has_gpu     INTEGER NOT NULL,
    labels      TEXT NOT NULL,
    version     TEXT NOT NULL,
    draining    INTEGER NOT NULL DEFAULT 0,
    started_ms  INTEGER NOT NULL,
    seen_ms     INTEGER NOT NULL
) STRICT;

-- Who works on a job or was the last to, and what it asks of a worker: a list of labels.
ALTER TABLE jobs ADD COLUMN worker TEXT;
ALTER TABLE jobs ADD COLUMN requires TEXT NOT NULL DEFAULT '[]';
CREATE INDEX jobs_of_worker ON jobs (worker) WHERE state IN ('running', 'cancelling');
