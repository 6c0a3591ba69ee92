//! What things are called: changed, and looked for.

use std::collections::BTreeMap;

use sqlx::types::Json;

use crate::store::sql::{self, QueryAs, Record, Sql, Tx};
use crate::store::{Store, StoreError};
use relume_api::metadata::{MetadataChange, ResourceMetadata};
use relume_api::{ResourceKind, ResourceName, TenantId};

/// Which things of a list are wanted; all where nothing is said.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    /// Only those with this name.
    pub name: Option<String>,
    /// Only those that another system calls so.
    pub external_id: Option<String>,
    /// Only those with all of these labels.
    pub labels: BTreeMap<String, String>,
}

/// A query for the things of a table that a [`Filter`] wants, which is bound first: `$1` to `$3`. `$more` goes on after the condition.
macro_rules! listed {
    ($table:literal, $more:literal) => {
        $crate::store::sql::Sql::each(
            concat!(
                "SELECT * FROM ",
                $table,
                " WHERE ($1 IS NULL OR name = $1) AND ($2 IS NULL OR external_id = $2)
                   AND NOT EXISTS (SELECT 1 FROM json_each($3) AS asked WHERE NOT EXISTS
                       (SELECT 1 FROM json_each(labels) AS own
                        WHERE own.key = asked.key AND own.value = asked.value)) ",
                $more
            ),
            concat!(
                "SELECT * FROM ",
                $table,
                " WHERE ($1 IS NULL OR name = $1) AND ($2 IS NULL OR external_id = $2) AND labels @> $3 ",
                $more
            ),
        )
    };
}
pub(super) use listed;

/// A query that `listed!` made, for this filter; `$4` and further are to be bound.
pub(super) fn filtered<T: Record>(query: Sql, filter: &Filter) -> QueryAs<T> {
    sql::query_as(query).bind(&filter.name).bind(&filter.external_id).bind(Json(&filter.labels))
}

impl Store {
    /// Changes what a thing of a tenant is called; `None` when there is none.
    ///
    /// # Errors
    /// [`StoreError::InvalidMetadata`] when it may not be called so; when the database fails.
    pub async fn change_metadata(
        &self,
        tenant: &TenantId,
        what: &ResourceName,
        change: &MetadataChange,
    ) -> Result<Option<ResourceMetadata>, StoreError> {
        let mut tx = self.write().await?;
        let changed = change_metadata_in_tx(&mut tx, tenant, what, change).await?;
        tx.commit().await?;
        Ok(changed)
    }
}

/// As [`Store::change_metadata`], as part of a transaction.
pub(super) async fn change_metadata_in_tx(
    tx: &mut Tx,
    tenant: &TenantId,
    what: &ResourceName,
    change: &MetadataChange,
) -> Result<Option<ResourceMetadata>, StoreError> {
    for &(select, update) in statements(what.kind) {
        let found: Option<ResourceMetadata> =
            sql::query_as(select).bind(&what.id).bind(tenant).fetch_optional(&mut *tx).await?;
        let Some(metadata) = found.map(|metadata| metadata.changed(change)) else { continue };
        if let Some((field, why)) = metadata.validation_error() {
            return Err(StoreError::InvalidMetadata { field, why });
        }
        let query = sql::query(update).bind(&what.id).bind(&metadata.name).bind(&metadata.external_id);
        query.bind(Json(&metadata.labels)).execute(&mut *tx).await?;
        return Ok(Some(metadata));
    }
    Ok(None)
}

type Statements = &'static [(&'static str, &'static str)];

/// Reads and writes what the thing `$1` (of the tenant `$2`, where it is read) is called, in each place where it may be.
fn statements(kind: ResourceKind) -> Statements {
    macro_rules! of {
        ($table:literal, $id:literal, $condition:literal) => {
            (
                concat!(
                    "SELECT name, external_id, labels FROM ",
                    $table,
                    " WHERE ",
                    $id,
                    " = $1 AND tenant = $2",
                    $condition
                ),
                concat!(
                    "UPDATE ",
                    $table,
                    " SET name = $2, external_id = $3, labels = $4 WHERE ",
                    $id,
                    " = $1"
                ),
            )
        };
        ($table:literal) => {
            of!($table, "id", " AND deleted_ms IS NULL")
        };
    }
    match kind {
        // One that is being made is an upload still.
        ResourceKind::Capture => &[of!("captures"), of!("uploads", "capture_id", "")],
        ResourceKind::Environment => &[of!("environments")],
        ResourceKind::Job => &[of!("jobs")],
        ResourceKind::Model => &[of!("models")],
    }
}
