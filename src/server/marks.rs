//! What things are called: given with an upload, changed by `PATCH`, looked for in lists. The parts that their routes share.

use std::collections::BTreeMap;

use serde::Deserialize;
use utoipa::IntoParams;

use crate::api::marks::{Marks, MarksChange, parse_labels};
use crate::api::{Problem, ResourceKind, ResourceName, TenantId};
use crate::server::app::Shared;
use crate::server::listing::PageQuery;
use crate::store::{Filter, StoreError};

/// What an upload is called.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MarksQuery {
    /// A name for people, 1 to 200 characters, none of them control characters.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// What another system calls it, 1 to 200 characters, none of them control characters.
    #[param(min_length = 1, max_length = 200)]
    external_id: Option<String>,
    /// Labels: `key:value`, several with commas.
    labels: Option<String>,
}

impl MarksQuery {
    /// # Errors
    /// 422 that names the parameter.
    pub(super) fn marks(self) -> Result<Marks, Problem> {
        let labels = labels("labels", self.labels.as_deref())?;
        let marks = Marks { name: self.name, external_id: self.external_id, labels };
        match marks.fault() {
            Some((field, why)) => Err(Problem::invalid_field(format!("query/{field}"), why)),
            None => Ok(marks),
        }
    }
}

/// Which part of a list, of things that are called so.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MarkedPageQuery {
    /// Only those with this name.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// Only those that another system calls so.
    #[param(min_length = 1, max_length = 200)]
    external_id: Option<String>,
    /// Only those with this label, `key:value`; with several, separated by commas, those that have all.
    #[param(min_length = 3)]
    label: Option<String>,
    /// Most items, 1 to 200; 50 when absent.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// Only what comes after: the `next` of the page before, or the identifier of an item.
    #[param(min_length = 1)]
    before: Option<String>,
}

impl MarkedPageQuery {
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
    let wanted = Marks { name, external_id, labels: labels("label", label)? };
    // Nothing is called what nothing may be called.
    if let Some((field, why)) = wanted.fault() {
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
pub(super) async fn mark(
    app: &Shared,
    tenant: &TenantId,
    what: ResourceName,
    given: Marks,
    before: Marks,
) -> Result<Marks, Problem> {
    if given == Marks::default() {
        return Ok(before);
    }
    let changed = app.store.change_marks(tenant, &what, &given.into()).await.map_err(refused)?;
    Ok(changed.unwrap_or(before))
}

/// The store's refusal to whoever said in the query what a thing is called.
pub(super) fn refused(error: StoreError) -> Problem {
    match error {
        StoreError::BadMarks { field, why } => Problem::invalid_field(format!("query/{field}"), why),
        error => error.into(),
    }
}

/// Changes what a thing is called.
///
/// # Errors
/// 404 when there is none, 422 when it may not be called so.
pub(super) async fn change(
    app: &Shared,
    tenant: &TenantId,
    kind: ResourceKind,
    id: &str,
    change: &MarksChange,
) -> Result<(), Problem> {
    let what = ResourceName::new(kind, id.to_owned());
    let changed = app.store.change_marks(tenant, &what, change).await?;
    changed.map(drop).ok_or_else(|| Problem::not_found(kind.name(), id))
}
