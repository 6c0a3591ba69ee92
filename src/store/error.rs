//! The errors of the store, one for each thing that a caller can do about it.

use std::error::Error;
use std::io::ErrorKind;

use relume_api::ResourceName;

/// Why the store refused.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The disk, a quota or a file-size limit is exhausted. Nothing was published.
    #[error("storage is full")]
    Full,
    /// The disk is too full to work.
    #[error("the disk has no room for {bytes} more bytes")]
    NoDiskSpace {
        /// What is asked for.
        bytes: u64,
    },
    /// No more may be stored.
    #[error("the storage limit is {limit} bytes: {taken} are stored and {asked} more were requested")]
    StorageLimitExceeded {
        /// What may be stored, bytes.
        limit: u64,
        /// What is stored.
        taken: u64,
        /// What was asked for beside it.
        asked: u64,
    },
    /// A body is larger than its limit.
    #[error("the body is larger than {limit} bytes")]
    TooLarge {
        /// The limit, bytes.
        limit: u64,
    },
    /// The transfer was cut off or malformed; the message is the transport's.
    #[error("the body could not be read: {0}")]
    Body(String),
    /// No artifact has that key.
    #[error("{0} does not exist")]
    Missing(String),
    /// The bytes of an artifact are not those that were stored.
    #[error("{0} is damaged: its bytes are not those that were stored")]
    Damaged(String),
    /// Another process owns the data directory.
    #[error("the data directory {0} is in use by another server")]
    Locked(String),
    /// A tenant has as many jobs as it may.
    #[error("at most {most} jobs can be queued or running at once")]
    JobQuotaExceeded {
        /// How many.
        most: u32,
    },
    /// A tenant has as much as it may.
    #[error(
        "the storage limit of the tenant is {most} bytes: {taken} are stored and {asked} more were requested"
    )]
    ByteQuotaExceeded {
        /// How much.
        most: u64,
        /// What there is.
        taken: u64,
        /// What was asked for beside it.
        asked: u64,
    },
    /// A tenant has as many unfinished uploads as it may.
    #[error(
        "at most {most} uploads can be open at once; complete some and create captures of them, or delete some"
    )]
    UploadQuotaExceeded {
        /// How many.
        most: u32,
    },
    /// A tenant has as many exports that wait or run as it may.
    #[error("at most {most} exports can be queued or running at once; wait for some, or delete some")]
    ExportQuotaExceeded {
        /// How many.
        most: u32,
    },
    /// The bytes of a piece are not those that were promised.
    #[error("the checksum is not that of the piece")]
    ChecksumMismatch,
    /// What the request names was deleted meanwhile.
    #[error("{0} was deleted")]
    Deleted(ResourceName),
    /// A thing may not be called so.
    #[error("{field}: {why}")]
    InvalidMetadata {
        /// The field that is wrong.
        field: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// A tenant has as many webhooks as it may.
    #[error("a tenant can have at most {most} webhooks")]
    TooManyWebhooks {
        /// How many.
        most: i64,
    },
    /// The key that asks was revoked meanwhile.
    #[error("the key was revoked")]
    KeyRevoked,
    /// The same idempotency key came with another request.
    #[error("the idempotency key was used with a different request")]
    IdempotencyKeyReused,
    /// There are artifacts and no database.
    #[error(
        "{0} has stored files but no database: relume.db was moved, removed or not mounted; put it back, restore a backup, or use another data directory"
    )]
    DatabaseMissing(String),
    /// There is no database to back up.
    #[error("{0} has no database relume.db: it is no data directory")]
    NoDatabase(String),
    /// A folder that was to be made has something in it.
    #[error("{0} is not empty: name a folder that does not exist yet")]
    NotEmpty(String),
    /// A folder is no backup.
    #[error("{path} is no backup: {why}")]
    NoBackup {
        /// The folder.
        path: String,
        /// What is wrong with it.
        why: String,
    },
    /// The database was written by a newer version.
    #[error(
        "the database was written by a newer version of relume (schema {found}; this version knows {known}): start that version, or restore the backup from before the update"
    )]
    NewerDatabase {
        /// Its schema.
        found: i64,
        /// The newest schema that this version knows.
        known: i64,
    },
    /// A server of an older version runs on the database.
    #[error(
        "the server that runs here is of an older version (schema {found}; this version knows {known}): use its own relume, or stop it first"
    )]
    OlderServer {
        /// The schema of its database.
        found: i64,
        /// The newest schema that this version knows.
        known: i64,
    },
    /// The database file is not what SQLite wrote.
    #[error("the database relume.db is damaged ({0}): restore a backup")]
    DatabaseDamaged(String),
    /// A database that is to take everything of another has rows already.
    #[error("the database that is to be copied to is not empty: its table {0} has rows")]
    DatabaseNotEmpty(&'static str),
    /// A copied row is not what it was copied from.
    #[error("row {row} of table {table} came out otherwise: nothing was copied")]
    CopyDiffers {
        /// The table.
        table: &'static str,
        /// Number of the row, in the order of copying.
        row: usize,
    },
    /// Another server works on the database.
    #[error("the database is in use by another server")]
    DatabaseLocked,
    /// The database server cannot be reached now.
    #[error("the database cannot be reached: {0}")]
    DatabaseUnreachable(String),
    /// The object store of artifacts cannot be reached now, or lets nobody in.
    #[error("the object store of artifacts cannot be used: {0}")]
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
        // 13 is SQLITE_FULL; 778 is SQLITE_IOERR_WRITE, what SQLite makes of EFBIG and EDQUOT; 4874 is SQLITE_IOERR_SHMSIZE, a
        // new connection on a full disk.
        let code = error.as_database_error().and_then(|e| e.code());
        match code.as_deref() {
            Some("13" | "778" | "4874") => Self::Full,
            // PostgreSQL's disk_full.
            Some("53100") => Self::Full,
            // SQLITE_CORRUPT and SQLITE_NOTADB.
            Some("11" | "26") => Self::DatabaseDamaged(error.to_string()),
            // PostgreSQL ends connections, or does not take any yet: it stops, starts, or hands over to another.
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

/// True when any error of the chain says that the disk is full.
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
