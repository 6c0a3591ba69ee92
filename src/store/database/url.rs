//! The URL of a database server.

use std::fmt;
use std::str::FromStr;

use sqlx::postgres::PgConnectOptions;
use sqlx::{AssertSqlSafe, Connection, PgConnection};

use crate::store::StoreError;

/// Address and credentials of a PostgreSQL database: `postgres://user:password@host:5432/name`. Missing parts come from `PGHOST`,
/// `PGUSER`, `PGPASSWORD`, `PGPASSFILE` and similar variables. `Debug` does not print the credentials.
#[derive(Clone)]
pub struct DatabaseUrl(pub(super) Box<PgConnectOptions>);

impl FromStr for DatabaseUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if !["postgres://", "postgresql://"].iter().any(|scheme| text.starts_with(scheme)) {
            return Err("must begin with postgres://; without a URL the server uses a SQLite file in its data directory".to_owned());
        }
        let options = PgConnectOptions::from_str(text).map_err(|error| error.to_string())?;
        Ok(Self(Box::new(options.application_name("relume"))))
    }
}

impl DatabaseUrl {
    /// Another database on the same server. It is created if it does not exist.
    ///
    /// # Errors
    /// If the server cannot be reached or refuses the request.
    pub async fn sibling(&self, name: &str) -> Result<Self, StoreError> {
        let mut connection = PgConnection::connect_with(&self.0).await?;
        let query = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM pg_database WHERE datname = $1)");
        if !query.bind(name).fetch_one(&mut connection).await? {
            // A name cannot be a parameter of the statement; quotes in it are doubled.
            let create = format!("CREATE DATABASE \"{}\"", name.replace('"', "\"\""));
            sqlx::raw_sql(AssertSqlSafe(create)).execute(&mut connection).await?;
        }
        connection.close().await?;
        let options: PgConnectOptions = (*self.0).clone();
        Ok(Self(Box::new(options.database(name))))
    }
}

impl fmt::Debug for DatabaseUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "DatabaseUrl(postgres://{}:{}/...)", self.0.get_host(), self.0.get_port())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn database_url_must_be_postgres_and_hides_its_password() {
        for wrong in ["", "sqlite:relume.db", "mysql://localhost/a", "postgres://host:port/a"] {
            assert!(DatabaseUrl::from_str(wrong).is_err(), "{wrong}");
        }
        let url = DatabaseUrl::from_str("postgres://me:hidden@db.example.org:5433/relume").unwrap();
        assert_eq!(format!("{url:?}"), "DatabaseUrl(postgres://db.example.org:5433/...)");
    }
}
