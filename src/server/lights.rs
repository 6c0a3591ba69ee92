//! Resolves the light of a request: built-in maps, uploaded maps and maps in the request.

use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};

use crate::server::app::AppState;
use crate::server::environments;
use crate::server::problem::Problem;
use crate::store::{StoreError, hex};
use crate::worker::LightSource;
use relume_api::renders::EnvironmentSpec;
use relume_api::{EnvironmentId, TenantId};
use relume_capture::BUILTIN;
use relume_scene::RECOVERED_GROUP;

/// The light of a render request. An uploaded map is not read yet.
pub(super) async fn light(
    app: &AppState,
    tenant: &TenantId,
    spec: &EnvironmentSpec,
) -> Result<LightSource, Problem> {
    check_exposure(spec)?;
    match (&spec.id, &spec.builtin, &spec.inline_base64) {
        (None, None, None) => Ok(LightSource::Recovered),
        (Some(id), None, None) => {
            let found = stored_light(app, tenant, id).await?;
            let missing = || format!("{:?} does not exist", id.as_str());
            found.ok_or_else(|| Problem::invalid_field("/environment/id", missing()))
        }
        (None, Some(name), None) => builtin_light(name).ok_or_else(|| {
            let detail = format!(
                "must be recovered, recovered:GROUP for a light group of the model, or one of {}",
                BUILTIN.join(", ")
            );
            Problem::invalid_field("/environment/builtin", detail)
        }),
        (None, None, Some(text)) => inline_light(app, tenant, text).await,
        _ => Err(Problem::invalid_field(
            "/environment",
            "must have at most one of id, builtin and inline_base64",
        )),
    }
}

/// The light with a name in a query: a built-in map, a recovered light, or an uploaded map.
///
/// # Errors
/// 422, which names `parameter`, if it does not exist.
pub(super) async fn named_light(
    app: &AppState,
    tenant: &TenantId,
    name: &str,
    parameter: &str,
) -> Result<LightSource, Problem> {
    if let Some(light) = builtin_light(name) {
        return Ok(light);
    }
    let stored = stored_light(app, tenant, &EnvironmentId::from(name)).await?;
    stored.ok_or_else(|| Problem::invalid_field(parameter, format!("{name:?} does not exist")))
}

/// An uploaded map of a tenant.
async fn stored_light(
    app: &AppState,
    tenant: &TenantId,
    id: &EnvironmentId,
) -> Result<Option<LightSource>, Problem> {
    let Some(record) = app.store.environment(tenant, id).await? else { return Ok(None) };
    match app.store.artifacts().verify(&record.artifact, &record.sha256).await {
        // The map was deleted in the meantime.
        Err(StoreError::Missing(_)) if app.store.environment(tenant, id).await?.is_none() => return Ok(None),
        sound => sound?,
    }
    let path = app.store.artifacts().local_path(&record.artifact);
    Ok(Some(LightSource::Stored { path, sha256: record.sha256, maps: app.maps.clone() }))
}

/// A built-in map or a recovered light.
fn builtin_light(name: &str) -> Option<LightSource> {
    match name {
        "recovered" => Some(LightSource::Recovered),
        name if let Some(group) = name.strip_prefix(RECOVERED_GROUP) => {
            Some(LightSource::RecoveredGroup(group.to_owned()))
        }
        name if BUILTIN.contains(&name) => Some(LightSource::Builtin(name.to_owned())),
        _ => None,
    }
}

async fn inline_light(app: &AppState, tenant: &TenantId, text: &str) -> Result<LightSource, Problem> {
    let bytes = STANDARD
        .decode(text.trim())
        .map_err(|e| Problem::invalid_field("/environment/inline_base64", format!("is not Base64: {e}")))?;
    let sha256 = hex(&Sha256::digest(&bytes));
    let loaded = environments::decode(app, tenant, bytes).await?;
    Ok(LightSource::Inline { sha256, map: Arc::new(LightSource::downscaled(loaded.map)) })
}

fn check_exposure(spec: &EnvironmentSpec) -> Result<(), Problem> {
    if !(-20.0..=20.0).contains(&spec.exposure_ev) {
        return Err(Problem::invalid_field("/environment/exposure_ev", "must be -20 to 20"));
    }
    if !spec.rotation_deg.is_finite() {
        return Err(Problem::invalid_field("/environment/rotation_deg", "must be finite"));
    }
    Ok(())
}
