//! The errors of the store. Each variant can be handled differently by callers.

use std::error::Error;
use std::io::ErrorKind;

use relume_api::ResourceName;

/// Why a store operation failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The disk, a quota or a file-size limit is exhausted. Nothing was published.
    #[error("storage is full")]
    Full,
    /// The free disk space is too small to work.
    #[error("the disk does not have space for {bytes} more bytes")]
    NoDiskSpace {
        /// Required space, bytes.
        bytes: u64,
    },
    /// The storage limit of the server is reached.
    #[error("the storage limit is {limit} bytes: {taken} are stored and {asked} more were requested")]
    StorageLimitExceeded {
        /// The limit, bytes.
        limit: u64,
        /// Stored bytes.
        taken: u64,
        /// Additionally requested bytes.
        asked: u64,
    },
    /// A body is larger than its limit.
    #[error("the body is larger than {limit} bytes")]
    TooLarge {
        /// The limit, bytes.
        limit: u64,
    },
    /// The transfer was interrupted or malformed. The message is that of the transport.
    #[error("the body could not be read: {0}")]
    Body(String),
    /// No artifact has this key.
    #[error("{0} does not exist")]
    Missing(String),
    /// The bytes of an artifact differ from those that were stored.
    #[error("{0} is damaged: its bytes are not those that were stored")]
    Damaged(String),
    /// Another process holds the lock of the data directory.
    #[error("the data directory {0} is in use by another server")]
    Locked(String),
    /// A tenant has reached its limit of jobs.
    #[error("at most {most} jobs can be queued or running at once")]
    JobQuotaExceeded {
        /// The limit.
        most: u32,
    },
    /// A tenant has reached its limit of stored bytes.
    #[error(
        "the storage limit of the tenant is {most} bytes: {taken} are stored and {asked} more were requested"
    )]
    ByteQuotaExceeded {
        /// The limit, bytes.
        most: u64,
        /// Stored bytes.
        taken: u64,
        /// Additionally requested bytes.
        asked: u64,
    },
    /// A tenant has reached its limit of unfinished uploads.
    #[error(
        "at most {most} uploads can be open at once; complete some and create captures of them, or delete some"
    )]
    UploadQuotaExceeded {
        /// The limit.
        most: u32,
    },
    /// A tenant has reached its limit of queued and running exports.
    #[error("at most {most} exports can be queued or running at once; wait for some, or delete some")]
    ExportQuotaExceeded {
        /// The limit.
        most: u32,
    },
    /// The bytes of a chunk do not match its checksum.
    #[error("the chunk does not match its checksum")]
    ChecksumMismatch,
    /// A resource of the request was deleted in the meantime.
    #[error("{0} was deleted")]
    Deleted(ResourceName),
    /// Metadata of a resource are invalid.
    #[error("{field}: {why}")]
    InvalidMetadata {
        /// The invalid field.
        field: &'static str,
        /// The reason.
        why: String,
    },
    /// A tenant has reached its limit of webhooks.
    #[error("a tenant can have at most {most} webhooks")]
    TooManyWebhooks {
        /// The limit.
        most: i64,
    },
    /// The key of the caller was revoked in the meantime.
    #[error("the key was revoked")]
    KeyRevoked,
    /// The idempotency key was used with another request.
    #[error("the idempotency key was used with a different request")]
    IdempotencyKeyReused,
    /// The data directory has artifacts but no database.
    #[error(
        "{0} has stored files but no database: relume.db was moved, removed or not mounted; put it back, restore a backup, or use another data directory"
    )]
    DatabaseMissing(String),
    /// The data directory has artifacts, but its database is empty or has no tables.
    #[error(
        "{0} has stored files but its database is empty: it was truncated or replaced; put the previous database back, restore a backup, or use another data directory"
    )]
    DatabaseEmpty(String),
    /// The data directory has artifacts that are older than its database, which names none.
    #[error(
        "{0} has stored files that are older than its database, which names none of them: they belong to another database; put that database back, restore a backup, or move the folder artifacts away"
    )]
    ForeignArtifacts(String),
    /// The data directory has no database.
    #[error("{0} has no database relume.db: it is not a data directory")]
    NoDatabase(String),
    /// A folder to be created exists and is not empty.
    #[error("{0} is not empty: name a folder that does not exist yet")]
    NotEmpty(String),
    /// A folder is not a backup.
    #[error("{path} is not a backup: {why}")]
    NoBackup {
        /// The folder.
        path: String,
        /// The reason.
        why: String,
    },
    /// The database was written by a newer version of the program.
    #[error(
        "the database was written by a newer version of relume (schema {found}; this version supports {known}): start the newer version, or restore the backup from before the update"
    )]
    NewerDatabase {
        /// The schema of the database.
        found: i64,
        /// The newest schema that this version supports.
        known: i64,
    },
    /// The running server has an older version than this program.
    #[error(
        "the running server has an older version (schema {found}; this version supports {known}): use the relume program of that version, or stop the server first"
    )]
    OlderServer {
        /// The schema of its database.
        found: i64,
        /// The newest schema that this version supports.
        known: i64,
    },
    /// The SQLite database file is damaged.
    #[error("the database relume.db is damaged ({0}): restore a backup")]
    DatabaseDamaged(String),
    /// The destination of a database copy has rows.
    #[error("the destination database is not empty: its table {0} has rows")]
    DatabaseNotEmpty(&'static str),
    /// A copied row differs from the original.
    #[error("row {row} of table {table} differs after the copy: nothing was copied")]
    CopyDiffers {
        /// The table.
        table: &'static str,
        /// Index of the row, in the order of copying.
        row: usize,
    },
    /// Another server uses the database.
    #[error("the database is in use by another server")]
    DatabaseLocked,
    /// The database server cannot be reached.
    #[error("the database cannot be reached: {0}")]
    DatabaseUnreachable(String),
    /// The object store cannot be reached, or refuses access.
    #[error("the object store cannot be used: {0}")]
    ArtifactsUnreachable(String),
    /// The database failed.
    #[error("database: {0}")]
    Database(sqlx::Error),
    /// The schema could not be migrated.
    #[error("migration: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// The artifact store failed.
    #[error("artifacts: {0}")]
    Artifacts(object_store::Error),
    /// A file operation failed.
    #[error("file: {0}")]
    File(std::io::Error),
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        // 13 is SQLITE_FULL. 778 is SQLITE_IOERR_WRITE, which SQLite returns for EFBIG and EDQUOT. 4874 is SQLITE_IOERR_SHMSIZE,
        // for a new connection on a full disk.
        let code = error.as_database_error().and_then(|e| e.code());
        match code.as_deref() {
            Some("13" | "778" | "4874") => Self::Full,
            // disk_full of PostgreSQL.
            Some("53100") => Self::Full,
            // SQLITE_CORRUPT and SQLITE_NOTADB.
            Some("11" | "26") => Self::DatabaseDamaged(error.to_string()),
            // PostgreSQL closes or refuses connections while it stops, starts or fails over.
            Some("57P01" | "57P02" | "57P03" | "55000" | "08000" | "08003" | "08006") => {
                Self::DatabaseUnreachable(error.to_string())
            }
            _ if matches!(error, sqlx::Error::Io(_) | sqlx::Error::PoolTimedOut) => {
                Self::DatabaseUnreachable(error.to_string())
            }
            _ => Self::Database(error),
        }
    }
}

impl From<object_store::Error> for StoreError {
    fn from(error: object_store::Error) -> Self {
        match error {
            object_store::Error::NotFound { path, .. } => Self::Missing(path),
            error if is_full(&error) => Self::Full,
            error => Self::Artifacts(error),
        }
    }
}

impl From<std::io::Error> for StoreError {
    fn from(error: std::io::Error) -> Self {
        if is_full(&error) { Self::Full } else { Self::File(error) }
    }
}

/// Whether any error of the chain means that the disk is full.
fn is_full(error: &(dyn Error + 'static)) -> bool {
    let mut next = Some(error);
    while let Some(error) = next {
        let kind = error.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        if matches!(kind, Some(ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge)) {
            return true;
        }
        next = error.source();
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrapped(kind: ErrorKind) -> StoreError {
        object_store::Error::Generic { store: "test", source: Box::new(std::io::Error::from(kind)) }.into()
    }

    #[test]
    fn a_full_disk_is_recognised_in_nested_errors() {
        for kind in [ErrorKind::StorageFull, ErrorKind::QuotaExceeded, ErrorKind::FileTooLarge] {
            assert!(matches!(wrapped(kind), StoreError::Full), "{kind:?}");
        }
        assert!(matches!(wrapped(ErrorKind::PermissionDenied), StoreError::Artifacts(_)));
    }
}
