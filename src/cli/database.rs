//! Options for a server's database, and `relume db`.

use std::sync::Arc;

use crate::cli::CommandResult;
use crate::jobs::{Clock, DatabaseClock, SystemClock};
use crate::server::ServerConfig;
use crate::store::{self, DatabaseLocation, DatabaseUrl};

/// Options for a server's database.
#[derive(Debug, clap::Args)]
pub(super) struct DatabaseArgs {
    /// A PostgreSQL database for the records of captures, jobs and models, in place of a SQLite file in the data directory:
    /// `postgres://user:password@host:5432/name`. Use the variable RELUME_DATABASE_URL, because other users can read the command
    /// line.
    #[arg(long, env = "RELUME_DATABASE_URL", hide_env_values = true, value_name = "URL")]
    pub(super) database_url: Option<DatabaseUrl>,
}

impl DatabaseArgs {
    /// Sets a server's database and the matching clock.
    pub(super) fn apply(self, config: &mut ServerConfig) {
        if self.database_url.is_some() {
            config.clock = Arc::new(DatabaseClock::new(SystemClock.now_ms()));
        }
        config.database = self.database_url;
    }
}

/// Options of `relume db`.
#[derive(Debug, clap::Args)]
pub(super) struct DbArgs {
    #[command(subcommand)]
    command: DbCommand,
}

#[derive(Debug, clap::Subcommand)]
enum DbCommand {
    /// Copy all records of a database to an empty one and compare every row. Stop the server before the copy; afterwards start it
    /// with the same data directory and the new database.
    Copy(CopyArgs),
}

#[derive(Debug, clap::Args)]
struct CopyArgs {
    /// A data directory, for the SQLite file in it, or `postgres://user:password@host:5432/name`.
    from: DatabaseLocation,
    /// A data directory or `postgres://user:password@host:5432/name`. It must contain no records.
    to: DatabaseLocation,
}

pub(super) fn run(args: &DbArgs) -> CommandResult {
    let DbCommand::Copy(CopyArgs { from, to }) = &args.command;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    for table in runtime.block_on(store::copy_database(from, to))? {
        println!("{:<14} {:>8} rows", table.name, table.rows);
    }
    Ok(())
}
