-- Who takes jobs. `server` is the data directory whose server a worker is a thread of; one with a process of its own has none. One that
-- was not seen for a while is taken for dead, and its jobs go back to the queue.
CREATE TABLE workers (
    id          TEXT COLLATE "C" PRIMARY KEY,
    server      TEXT,
    name        TEXT NOT NULL,
    device      TEXT NOT NULL,
    has_gpu     BOOLEAN NOT NULL,
    labels      JSONB NOT NULL,
    version     TEXT NOT NULL,
    draining    BOOLEAN NOT NULL DEFAULT FALSE,
    started_ms  BIGINT NOT NULL,
    seen_ms     BIGINT NOT NULL
);

-- Who works on a job or was the last to, and what it asks of a worker: a list of labels.
ALTER TABLE jobs ADD COLUMN worker TEXT COLLATE "C";
ALTER TABLE jobs ADD COLUMN requires JSONB NOT NULL DEFAULT '[]';
CREATE INDEX jobs_of_worker ON jobs (worker) WHERE state IN ('running', 'cancelling');
