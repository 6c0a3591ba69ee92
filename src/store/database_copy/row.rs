//! A row of any table, for transfer between two databases.

use serde_json::Value as Json;
use sqlx::Row;
use sqlx::postgres::PgRow;
use sqlx::sqlite::SqliteRow;

use crate::store::database_copy::tables::ColumnType;
use crate::store::sql::Query;

/// The value of a column; `None` is NULL.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum ColumnValue {
    Text(Option<String>),
    Int(Option<i64>),
    Real(Option<f64>),
    Json(Option<Json>),
    Bytes(Option<Vec<u8>>),
    Bool(Option<bool>),
}

impl ColumnValue {
    /// Whether two values are equal, independent of the number format of a database in JSON.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Json(Some(a)), Self::Json(Some(b))) => is_same_json(a, b),
            (a, b) => a == b,
        }
    }

    /// Binds the value as the next parameter of a statement.
    pub(super) fn bound(&self, query: Query) -> Query {
        match self {
            Self::Text(value) => query.bind(value),
            Self::Int(value) => query.bind(value),
            Self::Real(value) => query.bind(value),
            Self::Json(value) => query.bind(value),
            Self::Bytes(value) => query.bind(value),
            Self::Bool(value) => query.bind(value),
        }
    }
}

fn is_same_json(a: &Json, b: &Json) -> bool {
    match (a, b) {
        (Json::Number(a), Json::Number(b)) => a == b || a.as_f64() == b.as_f64(),
        (Json::Array(a), Json::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same_json(a, b))
        }
        (Json::Object(a), Json::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| is_same_json(a, b)))
        }
        (a, b) => a == b,
    }
}

/// Reads the columns of a row with the types of its table.
pub(super) trait ReadColumns {
    /// The value of the column with this index.
    fn field(&self, column: usize, kind: ColumnType) -> Result<ColumnValue, sqlx::Error>;

    /// The values of all columns.
    fn fields(&self, columns: &[(&str, ColumnType)]) -> Result<Vec<ColumnValue>, sqlx::Error> {
        columns.iter().enumerate().map(|(column, (_, kind))| self.field(column, *kind)).collect()
    }
}

macro_rules! fields_of {
    ($($row:ty),+) => {$(
        impl ReadColumns for $row {
            fn field(&self, column: usize, kind: ColumnType) -> Result<ColumnValue, sqlx::Error> {
                Ok(match kind {
                    ColumnType::Text => ColumnValue::Text(self.try_get(column)?),
                    ColumnType::Int => ColumnValue::Int(self.try_get(column)?),
                    ColumnType::Real => ColumnValue::Real(self.try_get(column)?),
                    ColumnType::Json => ColumnValue::Json(self.try_get(column)?),
                    ColumnType::Bytes => ColumnValue::Bytes(self.try_get(column)?),
                    ColumnType::Bool => ColumnValue::Bool(self.try_get(column)?),
                })
            }
        }
    )+};
}
fields_of!(SqliteRow, PgRow);

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn json_fields_compare_numbers_by_value() {
        let field = |value: Json| ColumnValue::Json(Some(value));
        let a = field(json!({ "a": [1e16, 0.1], "b": null }));
        assert!(a.is_same(&field(json!({ "b": null, "a": [10_000_000_000_000_000_u64, 0.1] }))));
        for other in [json!({ "a": [1e16, 0.2], "b": null }), json!({ "a": [1e16, 0.1] }), json!(null)] {
            assert!(!a.is_same(&field(other)));
        }
        assert!(
            !a.is_same(&ColumnValue::Json(None))
                && !ColumnValue::Int(Some(1)).is_same(&ColumnValue::Int(Some(2)))
        );
    }
}
