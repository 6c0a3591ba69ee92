//! Changes of metadata, and lists filtered by metadata.

use std::collections::BTreeMap;

use sqlx::types::Json;

use crate::store::sql::{self, QueryAs, Record, Sql, Tx};
use crate::store::{Store, StoreError};
use relume_api::metadata::{MetadataChange, ResourceMetadata};
use relume_api::{ResourceKind, ResourceName, TenantId};

/// A filter for lists; empty fields match everything.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    /// Only resources with this name.
    pub name: Option<String>,
    /// Only resources with this external identifier.
    pub external_id: Option<String>,
    /// Only resources with all of these labels.
    pub labels: BTreeMap<String, String>,
}

/// A query for the rows of a table that match a [`Filter`], whose values are bound first: `$1` to `$3`. `$more` continues the
/// condition.
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

/// Binds the filter to a query of `listed!`. The caller binds `$4` and further parameters.
pub(super) fn filtered<T: Record>(query: Sql, filter: &Filter) -> QueryAs<T> {
    sql::query_as(query).bind(&filter.name).bind(&filter.external_id).bind(Json(&filter.labels))
}

impl Store {
    /// Changes the metadata of a resource of a tenant; `None` if it does not exist.
    ///
    /// # Errors
    /// [`StoreError::InvalidMetadata`] if the new metadata are invalid. When the database fails.
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

/// As [`Store::change_metadata`], within a transaction.
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

/// The statements that read and write the metadata of the resource `$1` (of the tenant `$2`, for reading), in each table that can
/// contain it.
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
        // A capture that is being made is still an upload.
        ResourceKind::Capture => &[of!("captures"), of!("uploads", "capture_id", "")],
        ResourceKind::Environment => &[of!("environments")],
        ResourceKind::Job => &[of!("jobs")],
        ResourceKind::Model => &[of!("models")],
    }
}
