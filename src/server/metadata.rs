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
    /// The page and what is looked for.
    ///
    /// # Errors
    /// 422 that names the parameter.
    pub(super) fn parts(self) -> Result<(PageQuery, Filter), Problem> {
        let filter = filter(self.name, self.external_id, self.label.as_deref())?;
        Ok((PageQuery { limit: self.limit, before: self.before }, filter))
    }
}

/// What is looked for in a list.
///
/// # Errors
/// 422 that names the parameter.
pub(super) fn filter(
    name: Option<String>,
    external_id: Option<String>,
    label: Option<&str>,
) -> Result<Filter, Problem> {
    let wanted = ResourceMetadata { name, external_id, labels: labels("label", label)? };
    // Nothing is called what nothing may be called.
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

/// Calls an upload what its sender calls it, also one that was there before.
///
/// # Errors
/// 422 that names the parameter when it has too many labels then; when the database fails.
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

/// The store's refusal to whoever said in the query what a thing is called.
pub(super) fn refused(error: StoreError) -> Problem {
    match error {
        StoreError::InvalidMetadata { field, why } => Problem::invalid_field(format!("query/{field}"), why),
        error => error.into(),
    }
}

/// Changes what a thing is called.
///
/// # Errors
/// 404 when there is none, 422 when it may not be called so.
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
