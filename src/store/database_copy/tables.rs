//! The tables of a database, in an order in which rows can be inserted: no table refers to a later one.

/// The type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColumnType {
    Text,
    /// A 64-bit integer.
    Int,
    Real,
    /// Text in SQLite, `JSONB` in PostgreSQL.
    Json,
    Bytes,
    /// 0 or 1 in SQLite, `BOOLEAN` in PostgreSQL.
    Bool,
}

/// A table. Its rows are copied in the order of `order`, which is unique for each row.
#[derive(Debug)]
pub(super) struct TableSpec {
    pub(super) name: &'static str,
    pub(super) order: &'static str,
    pub(super) columns: &'static [(&'static str, ColumnType)],
    /// Whether the database numbers the rows by a column `seq`.
    pub(super) is_numbered: bool,
}

macro_rules! table {
    ($name:literal by $order:literal $(numbered $numbered:literal)?: $($kind:ident $($column:ident)+),+) => {
        TableSpec {
            name: $name,
            order: $order,
            columns: &[$($((stringify!($column), ColumnType::$kind)),+),+],
            is_numbered: false $(|| $numbered)?,
        }
    };
}

/// All tables.
pub(super) const TABLES: &[TableSpec] = &[
    table!("keys" by "created_ms, id":
        Text id name tenant secret_sha256 made_by, Json scopes, Int created_ms expires_ms last_used_ms revoked_ms),
    table!("captures" by "id":
        Text id tenant sha256 made_of artifact name external_id, Json report labels, Int bytes created_ms deleted_ms swept_ms),
    table!("environments" by "id":
        Text id tenant sha256 artifact name external_id, Json warnings labels,
        Int bytes width height created_ms deleted_ms),
    table!("jobs" by "created_ms, id":
        Text id tenant capture_id retry_of preset device state lease_token message checkpoint checkpoint_sha256 model_id
            error_code error_detail name external_id worker traceparent,
        Json overrides quality_gate figures labels requires,
        Int priority turn created_ms started_ms finished_ms attempts idle_attempts lease_until_ms step total gaussians
            checkpoint_step model_deleted_ms deleted_ms swept_ms,
        Real loss psnr eta_seconds),
    table!("models" by "id":
        Text id tenant job_id capture_id name external_id, Json card labels, Int gaussians created_ms deleted_ms),
    table!("model_files" by "model_id, name":
        Text model_id name content_type sha256 artifact, Int bytes),
    table!("events" by "seq" numbered true: Int seq at_ms, Text job_id kind data),
    table!("idempotency" by "tenant, key": Text tenant key fingerprint response, Int created_ms),
    table!("uploads" by "id":
        Text id tenant metadata capture_id sha256 name external_id, Json problem labels,
        Int length received created_ms expires_ms interrupted_validations),
    table!("webhooks" by "id":
        Text id tenant url name made_by switched_off_because, Json events, Bytes secret former_secret, Bool enabled,
        Int former_until_ms created_ms failing_since_ms switched_off_ms),
    table!("deliveries" by "seq" numbered true:
        Int seq created_ms due_ms tries, Text id webhook_id event job_id payload state, Json attempts),
    table!("workers" by "id":
        Text id server name device version, Json labels, Bool has_gpu draining, Int started_ms seen_ms),
    table!("exports" by "id":
        Text id tenant model_id kind state file_name content_type artifact sha256 error_code error_detail, Json request,
        Int done total work_bytes bytes created_ms started_ms finished_ms deleted_ms),
];
