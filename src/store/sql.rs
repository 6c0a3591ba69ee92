//! Statements that run on both databases. Parameters are `$1`, `$2`, ... in both. If the syntax differs, a statement has one text
//! for each database ([`Sql`]).

use sqlx::postgres::{PgArguments, PgRow};
use sqlx::sqlite::{SqliteArguments, SqliteRow};
use sqlx::{
    Arguments, AssertSqlSafe, Encode, FromRow, PgConnection, PgPool, Postgres, SqlSafeStr, SqlStr, Sqlite,
    SqliteConnection, SqlitePool, Transaction, Type,
};
use tokio::sync::OwnedMutexGuard;

/// The text of a statement.
#[derive(Debug, Clone)]
pub(super) struct Sql {
    sqlite: SqlStr,
    postgres: SqlStr,
}

impl Sql {
    /// A separate text for each database.
    pub(super) const fn each(sqlite: &'static str, postgres: &'static str) -> Self {
        Self { sqlite: SqlStr::from_static(sqlite), postgres: SqlStr::from_static(postgres) }
    }

    /// A text that the program composed of its own identifiers.
    pub(super) fn composed(text: String) -> Self {
        let text = AssertSqlSafe(text).into_sql_str();
        Self { sqlite: text.clone(), postgres: text }
    }
}

impl From<&'static str> for Sql {
    fn from(text: &'static str) -> Self {
        Self::each(text, text)
    }
}

/// A transaction. It is rolled back if it is dropped without a commit.
pub(super) enum Tx {
    Sqlite(Transaction<'static, Sqlite>),
    /// With the guard that blocks other write transactions of this process.
    Postgres(Transaction<'static, Postgres>, Option<OwnedMutexGuard<()>>),
}

impl Tx {
    /// Commits the transaction.
    pub(super) async fn commit(self) -> Result<(), sqlx::Error> {
        match self {
            Self::Sqlite(tx) => tx.commit().await,
            Self::Postgres(tx, _until_then) => tx.commit().await,
        }
    }
}

/// Connections for queries.
#[derive(Clone)]
pub(super) enum Pool {
    Sqlite(SqlitePool),
    Postgres(PgPool),
}

impl Pool {
    /// Closes all connections.
    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite(pool) => pool.close().await,
            Self::Postgres(pool) => pool.close().await,
        }
    }
}

/// The pool or transaction on which a statement runs.
pub(super) enum On<'c> {
    SqlitePool(&'c SqlitePool),
    Sqlite(&'c mut SqliteConnection),
    PostgresPool(&'c PgPool),
    Postgres(&'c mut PgConnection),
}

impl<'c> From<&'c mut Tx> for On<'c> {
    fn from(tx: &'c mut Tx) -> Self {
        match tx {
            Tx::Sqlite(tx) => Self::Sqlite(&mut *tx),
            Tx::Postgres(tx, _) => Self::Postgres(&mut *tx),
        }
    }
}

impl<'c> From<&'c Pool> for On<'c> {
    fn from(pool: &'c Pool) -> Self {
        match pool {
            Pool::Sqlite(pool) => Self::SqlitePool(pool),
            Pool::Postgres(pool) => Self::PostgresPool(pool),
        }
    }
}

impl<'c> From<&'c SqlitePool> for On<'c> {
    fn from(pool: &'c SqlitePool) -> Self {
        Self::SqlitePool(pool)
    }
}

/// A value that can be bound in both databases.
pub(super) trait Value<'q>:
    Encode<'q, Sqlite> + Type<Sqlite> + Encode<'q, Postgres> + Type<Postgres>
{
}

impl<'q, T> Value<'q> for T where T: Encode<'q, Sqlite> + Type<Sqlite> + Encode<'q, Postgres> + Type<Postgres> {}

/// A row type that can be read from both databases.
pub(super) trait Record:
    for<'r> FromRow<'r, SqliteRow> + for<'r> FromRow<'r, PgRow> + Send + Unpin
{
}

impl<T> Record for T where T: for<'r> FromRow<'r, SqliteRow> + for<'r> FromRow<'r, PgRow> + Send + Unpin {}

/// A statement and its parameters.
pub(super) struct Query {
    sql: Sql,
    sqlite: SqliteArguments,
    postgres: PgArguments,
    refused: Option<sqlx::Error>,
}

/// A statement whose rows are read as `T`.
pub(super) struct QueryAs<T>(Query, std::marker::PhantomData<fn() -> T>);

/// A statement whose rows have one column, read as `T`.
pub(super) struct QueryScalar<T>(QueryAs<(T,)>);

/// A statement.
pub(super) fn query(sql: impl Into<Sql>) -> Query {
    Query {
        sql: sql.into(),
        sqlite: SqliteArguments::default(),
        postgres: PgArguments::default(),
        refused: None,
    }
}

/// A statement whose rows are read as `T`.
pub(super) fn query_as<T: Record>(sql: impl Into<Sql>) -> QueryAs<T> {
    QueryAs(query(sql), std::marker::PhantomData)
}

/// A statement whose rows have one column, read as `T`.
pub(super) fn query_scalar<T>(sql: impl Into<Sql>) -> QueryScalar<T>
where
    (T,): Record,
{
    QueryScalar(query_as(sql))
}

/// Runs a query on its database: `$make` is the function of sqlx, `$method` the method to call.
macro_rules! run {
    ($query:expr, $on:expr, $make:path, $method:ident) => {{
        let query: Query = $query;
        if let Some(refused) = query.refused {
            return Err(refused);
        }
        match $on.into() {
            On::SqlitePool(pool) => $make(query.sql.sqlite, query.sqlite).$method(pool).await,
            On::Sqlite(one) => $make(query.sql.sqlite, query.sqlite).$method(one).await,
            On::PostgresPool(pool) => $make(query.sql.postgres, query.postgres).$method(pool).await,
            On::Postgres(one) => $make(query.sql.postgres, query.postgres).$method(one).await,
        }
    }};
}

impl Query {
    /// Binds the next parameter.
    pub(super) fn bind<'q, T: Value<'q>>(mut self, value: T) -> Self {
        let bound = self.sqlite.add(&value).and_then(|()| self.postgres.add(&value));
        if let Err(error) = bound {
            self.refused = Some(sqlx::Error::Encode(error));
        }
        self
    }

    /// All rows, read by the function for the database.
    pub(super) async fn fetch_rows<'c, T>(
        self,
        on: impl Into<On<'c>>,
        of_sqlite: impl Fn(&SqliteRow) -> Result<T, sqlx::Error>,
        of_postgres: impl Fn(&PgRow) -> Result<T, sqlx::Error>,
    ) -> Result<Vec<T>, sqlx::Error> {
        if let Some(refused) = self.refused {
            return Err(refused);
        }
        let sqlite = || sqlx::query_with(self.sql.sqlite, self.sqlite);
        let postgres = || sqlx::query_with(self.sql.postgres, self.postgres);
        match on.into() {
            On::SqlitePool(pool) => sqlite().fetch_all(pool).await?.iter().map(of_sqlite).collect(),
            On::Sqlite(one) => sqlite().fetch_all(one).await?.iter().map(of_sqlite).collect(),
            On::PostgresPool(pool) => postgres().fetch_all(pool).await?.iter().map(of_postgres).collect(),
            On::Postgres(one) => postgres().fetch_all(one).await?.iter().map(of_postgres).collect(),
        }
    }

    /// Executes the statement. Returns the number of changed rows.
    pub(super) async fn execute<'c>(self, on: impl Into<On<'c>>) -> Result<u64, sqlx::Error> {
        if let Some(refused) = self.refused {
            return Err(refused);
        }
        let sqlite = || sqlx::query_with(self.sql.sqlite, self.sqlite);
        let postgres = || sqlx::query_with(self.sql.postgres, self.postgres);
        Ok(match on.into() {
            On::SqlitePool(pool) => sqlite().execute(pool).await?.rows_affected(),
            On::Sqlite(one) => sqlite().execute(one).await?.rows_affected(),
            On::PostgresPool(pool) => postgres().execute(pool).await?.rows_affected(),
            On::Postgres(one) => postgres().execute(one).await?.rows_affected(),
        })
    }
}

impl<T: Record> QueryAs<T> {
    /// Binds the next parameter.
    pub(super) fn bind<'q, V: Value<'q>>(self, value: V) -> Self {
        Self(self.0.bind(value), self.1)
    }

    /// The one row.
    pub(super) async fn fetch_one<'c>(self, on: impl Into<On<'c>>) -> Result<T, sqlx::Error> {
        run!(self.0, on, sqlx::query_as_with, fetch_one)
    }

    /// The row, if there is one.
    pub(super) async fn fetch_optional<'c>(self, on: impl Into<On<'c>>) -> Result<Option<T>, sqlx::Error> {
        run!(self.0, on, sqlx::query_as_with, fetch_optional)
    }

    /// All rows.
    pub(super) async fn fetch_all<'c>(self, on: impl Into<On<'c>>) -> Result<Vec<T>, sqlx::Error> {
        run!(self.0, on, sqlx::query_as_with, fetch_all)
    }
}

impl<T> QueryScalar<T>
where
    (T,): Record,
{
    /// Binds the next parameter.
    pub(super) fn bind<'q, V: Value<'q>>(self, value: V) -> Self {
        Self(self.0.bind(value))
    }

    /// The column of the one row.
    pub(super) async fn fetch_one<'c>(self, on: impl Into<On<'c>>) -> Result<T, sqlx::Error> {
        Ok(self.0.fetch_one(on).await?.0)
    }

    /// The column of the row, if there is one.
    pub(super) async fn fetch_optional<'c>(self, on: impl Into<On<'c>>) -> Result<Option<T>, sqlx::Error> {
        Ok(self.0.fetch_optional(on).await?.map(|(found,)| found))
    }

    /// The column of all rows.
    pub(super) async fn fetch_all<'c>(self, on: impl Into<On<'c>>) -> Result<Vec<T>, sqlx::Error> {
        Ok(self.0.fetch_all(on).await?.into_iter().map(|(found,)| found).collect())
    }
}
