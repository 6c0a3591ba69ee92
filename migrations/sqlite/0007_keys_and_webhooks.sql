-- The key that made a key, if one did: what it made ends with it.
ALTER TABLE keys ADD COLUMN made_by TEXT REFERENCES keys (id);

CREATE INDEX keys_made_by ON keys (made_by) WHERE made_by IS NOT NULL;

-- Whom the server tells of the ends of a tenant's jobs. The secret signs, so it is kept as it is; events are a JSON list.
CREATE TABLE webhooks (
    id                    TEXT PRIMARY KEY,
    tenant                TEXT NOT NULL,
    url                   TEXT NOT NULL,
    events                TEXT NOT NULL,
    name                  TEXT,
    secret                BLOB NOT NULL,
    made_by               TEXT,
    created_ms            INTEGER NOT NULL,
    enabled               INTEGER NOT NULL,
    failing_since_ms      INTEGER,
    switched_off_ms       INTEGER,
    switched_off_because  TEXT
) STRICT;

CREATE INDEX webhooks_of_tenant ON webhooks (tenant, created_ms DESC, id DESC);

-- What they are told. Attempts are a JSON list; `due_ms` says when a pending message is tried next.
CREATE TABLE deliveries (
    seq         INTEGER PRIMARY KEY AUTOINCREMENT,
    id          TEXT NOT NULL UNIQUE,
    webhook_id  TEXT NOT NULL REFERENCES webhooks (id),
    event       TEXT NOT NULL,
    job_id      TEXT NOT NULL,
    payload     TEXT NOT NULL,
    created_ms  INTEGER NOT NULL,
    state       TEXT NOT NULL CHECK (state IN ('pending', 'delivered', 'failed')),
    due_ms      INTEGER NOT NULL,
    tries       INTEGER NOT NULL DEFAULT 0,
    attempts    TEXT NOT NULL DEFAULT '[]'
) STRICT;

CREATE INDEX deliveries_due ON deliveries (webhook_id, due_ms, seq) WHERE state = 'pending';
CREATE INDEX deliveries_of_webhook ON deliveries (webhook_id, seq);
CREATE INDEX deliveries_by_age ON deliveries (created_ms);
