//! Metadata of resources: the query of uploads, the changes by `PATCH`, and the filters of lists.

use std::collections::BTreeMap;

use serde::Deserialize;
use utoipa::IntoParams;

use crate::server::app::AppState;
use crate::server::listing::PageQuery;
use crate::server::problem::Problem;
use crate::store::{Filter, StoreError};
use relume_api::metadata::{MetadataChange, ResourceMetadata, parse_labels};
use relume_api::{ResourceKind, ResourceName, TenantId};

/// Metadata of an upload.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MetadataQuery {
    /// Display name, 1 to 200 characters without control characters.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// Identifier in another system, 1 to 200 characters without control characters. Not necessarily unique.
    #[param(min_length = 1, max_length = 200)]
    external_id: Option<String>,
    /// Labels, written `key:value` and separated by commas, at most 16. Keys and values have 1 to 63
    /// characters of A-Z, a-z, 0-9, `.`, `_`, `-` and `/`.
    labels: Option<String>,
}

impl MetadataQuery {
    /// # Errors
    /// 422 that names the parameter.
    pub(super) fn metadata(self) -> Result<ResourceMetadata, Problem> {
        let labels = labels("labels", self.labels.as_deref())?;
        let metadata = ResourceMetadata { name: self.name, external_id: self.external_id, labels };
        match metadata.validation_error() {
            Some((field, why)) => Err(Problem::invalid_field(format!("query/{field}"), why)),
            None => Ok(metadata),
        }
    }
}

/// Filter and page of a list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct FilteredPageQuery {
    /// Only items with this name.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// Only items with this external identifier.
    #[param(min_length = 1, max_length = 200)]
    external_id: Option<String>,
    /// Only items with this label, written `key:value`. Several labels are separated by commas; an item must
    /// have all of them.
    #[param(min_length = 3)]
    label: Option<String>,
    /// Maximum number of items, 1 to 200. Omitted: 50.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// Cursor: the `next` of the previous page, or the identifier of an item. The page starts after that
    /// item. Omitted: the first page.
    #[param(min_length = 1)]
    before: Option<String>,
}

impl FilteredPageQuery {
    /// The page request and the filter.
    ///
    /// # Errors
    /// 422, which names the parameter.
    pub(super) fn parts(self) -> Result<(PageQuery, Filter), Problem> {
        let filter = filter(self.name, self.external_id, self.label.as_deref())?;
        Ok((PageQuery { limit: self.limit, before: self.before }, filter))
    }
}

/// The filter of a list.
///
/// # Errors
/// 422, which names the parameter.
pub(super) fn filter(
    name: Option<String>,
    external_id: Option<String>,
    label: Option<&str>,
) -> Result<Filter, Problem> {
    let wanted = ResourceMetadata { name, external_id, labels: labels("label", label)? };
    // A filter with invalid metadata can match nothing, so it is refused.
    if let Some((field, why)) = wanted.validation_error() {
        let parameter = if field == "labels" { "label" } else { field };
        return Err(Problem::invalid_field(format!("query/{parameter}"), why));
    }
    Ok(Filter { name: wanted.name, external_id: wanted.external_id, labels: wanted.labels })
}

fn labels(parameter: &str, text: Option<&str>) -> Result<BTreeMap<String, String>, Problem> {
    let wrong = |why| Problem::invalid_field(format!("query/{parameter}"), why);
    text.map(parse_labels).transpose().map(Option::unwrap_or_default).map_err(wrong)
}

/// Sets the metadata of an upload or of an existing resource to those of the query. Omitted fields are unchanged.
///
/// # Errors
/// 422, which names the parameter, if the result has too many labels. When the database fails.
pub(super) async fn apply_metadata(
    app: &AppState,
    tenant: &TenantId,
    what: ResourceName,
    given: ResourceMetadata,
    before: ResourceMetadata,
) -> Result<ResourceMetadata, Problem> {
    if given == ResourceMetadata::default() {
        return Ok(before);
    }
    let changed = app.store.change_metadata(tenant, &what, &given.into()).await.map_err(refused)?;
    Ok(changed.unwrap_or(before))
}

/// The problem for metadata in a query that the store refused.
pub(super) fn refused(error: StoreError) -> Problem {
    match error {
        StoreError::InvalidMetadata { field, why } => Problem::invalid_field(format!("query/{field}"), why),
        error => error.into(),
    }
}

/// Changes the metadata of a resource.
///
/// # Errors
/// 404 if the resource does not exist, 422 if the metadata are invalid.
pub(super) async fn change(
    app: &AppState,
    tenant: &TenantId,
    kind: ResourceKind,
    id: &str,
    change: &MetadataChange,
) -> Result<(), Problem> {
    let what = ResourceName::new(kind, id.to_owned());
    let changed = app.store.change_metadata(tenant, &what, change).await?;
    changed.map(drop).ok_or_else(|| Problem::not_found(kind.name(), id))
}
