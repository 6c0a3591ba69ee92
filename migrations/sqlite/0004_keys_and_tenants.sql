-- Keys are revoked, not removed. The hash is of the whole key, lower-case hex; scopes are a JSON list.
CREATE TABLE keys (
    id             TEXT PRIMARY KEY,
    name           TEXT NOT NULL,
    tenant         TEXT NOT NULL,
    scopes         TEXT NOT NULL,
    secret_sha256  TEXT NOT NULL,
    created_ms     INTEGER NOT NULL,
    expires_ms     INTEGER,
    last_used_ms   INTEGER,
    revoked_ms     INTEGER
) STRICT;

-- Everything belongs to a tenant; what was there before, to `default`. Files are shared between tenants by their content,
-- rows are not, so that content is unique within a tenant only. SQLite cannot change such a constraint: the tables are made anew.
-- References to them are checked at the end of the transaction.
PRAGMA defer_foreign_keys = ON;

CREATE TABLE former AS SELECT * FROM captures;
DROP TABLE captures;
CREATE TABLE captures (
    id          TEXT PRIMARY KEY,
    tenant      TEXT NOT NULL,
    sha256      TEXT NOT NULL,
    bytes       INTEGER NOT NULL,
    artifact    TEXT NOT NULL,
    report      TEXT NOT NULL,
    created_ms  INTEGER NOT NULL,
    deleted_ms  INTEGER,
    swept_ms    INTEGER,
    UNIQUE (tenant, sha256)
) STRICT;
INSERT INTO captures (id, tenant, sha256, bytes, artifact, report, created_ms, deleted_ms, swept_ms)
    SELECT id, 'default', sha256, bytes, artifact, report, created_ms, deleted_ms, swept_ms FROM former;
DROP TABLE former;

CREATE TABLE former AS SELECT * FROM environments;
DROP TABLE environments;
CREATE TABLE environments (
    id          TEXT PRIMARY KEY,
    tenant      TEXT NOT NULL,
    sha256      TEXT NOT NULL,
    name        TEXT,
    bytes       INTEGER NOT NULL,
    artifact    TEXT NOT NULL,
    width       INTEGER NOT NULL,
    height      INTEGER NOT NULL,
    warnings    TEXT NOT NULL,
    created_ms  INTEGER NOT NULL,
    deleted_ms  INTEGER,
    UNIQUE (tenant, sha256)
) STRICT;
INSERT INTO environments
        (id, tenant, sha256, name, bytes, artifact, width, height, warnings, created_ms, deleted_ms)
    SELECT id, 'default', sha256, name, bytes, artifact, width, height, warnings, created_ms, deleted_ms FROM former;
DROP TABLE former;

CREATE TABLE former AS SELECT * FROM idempotency;
DROP TABLE idempotency;
CREATE TABLE idempotency (
    tenant       TEXT NOT NULL,
    key          TEXT NOT NULL,
    fingerprint  TEXT NOT NULL,
    response     TEXT NOT NULL,
    created_ms   INTEGER NOT NULL,
    PRIMARY KEY (tenant, key)
) STRICT;
INSERT INTO idempotency (tenant, key, fingerprint, response, created_ms)
    SELECT 'default', key, fingerprint, response, created_ms FROM former;
DROP TABLE former;

ALTER TABLE jobs ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
ALTER TABLE models ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';

CREATE INDEX captures_deleted ON captures (id) WHERE deleted_ms IS NOT NULL;
CREATE INDEX environments_deleted ON environments (id) WHERE deleted_ms IS NOT NULL;
CREATE INDEX captures_of_tenant ON captures (tenant, created_ms DESC, id DESC);
CREATE INDEX environments_of_tenant ON environments (tenant, created_ms DESC, id DESC);
CREATE INDEX jobs_of_tenant ON jobs (tenant, created_ms DESC, id DESC);
CREATE INDEX models_of_tenant ON models (tenant, created_ms DESC, id DESC);
