-- Files that are made of models in the background. `work_bytes` are those of finished frames in the work folder `exports/<id>` of the
-- data directory; the finished file is the artifact `exports/<id>`. They can be made again, so backups leave them out.
CREATE TABLE exports (
    id            TEXT PRIMARY KEY,
    tenant        TEXT NOT NULL,
    model_id      TEXT NOT NULL,
    kind          TEXT NOT NULL,
    request       TEXT NOT NULL,
    state         TEXT NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    done          INTEGER NOT NULL DEFAULT 0,
    total         INTEGER NOT NULL,
    work_bytes    INTEGER NOT NULL DEFAULT 0,
    file_name     TEXT,
    content_type  TEXT,
    artifact      TEXT,
    bytes         INTEGER,
    sha256        TEXT,
    error_code    TEXT,
    error_detail  TEXT,
    created_ms    INTEGER NOT NULL,
    started_ms    INTEGER,
    finished_ms   INTEGER,
    deleted_ms    INTEGER,
    CHECK (done BETWEEN 0 AND total)
) STRICT;

CREATE INDEX exports_of_tenant ON exports (tenant, created_ms DESC, id DESC);
CREATE INDEX exports_of_model ON exports (model_id);
CREATE INDEX exports_to_do ON exports (created_ms, id) WHERE state IN ('queued', 'running');
CREATE INDEX exports_deleted ON exports (id) WHERE deleted_ms IS NOT NULL;
