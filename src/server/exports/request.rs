//! Parses and checks the body of an export request. Errors name the field.

use serde_json::Value;

use crate::server::app::AppState;
use crate::server::exports::delight;
use crate::server::exports::light::light;
use crate::server::exports::light_matrix::MatrixPlan;
use crate::server::exports::plan::FramesPlan;
use crate::server::extract;
use crate::server::problem::Problem;
use crate::store::ModelRecord;
use relume_api::TenantId;
use relume_api::exports::{NewExport, SplatsExport};
use relume_capture::Up;
use relume_spec::rendering::{ExportedColour, MAX_BAKED_DEGREE};

/// Parses a body according to its `kind`.
///
/// # Errors
/// 422, which names the field.
pub(super) fn read(body: Value) -> Result<NewExport, Problem> {
    match body.get("kind").and_then(Value::as_str) {
        Some("frames") => extract::read(body).map(Box::new).map(NewExport::Frames),
        Some("gltf" | "usd" | "usdz" | "ply") => extract::read(body).map(NewExport::Splats),
        Some("mesh") => extract::read(body).map(NewExport::Mesh),
        Some("light_matrix") => extract::read(body).map(Box::new).map(NewExport::LightMatrix),
        Some("delight") => extract::read(body).map(NewExport::Delight),
        _ => Err(Problem::invalid_field(
            "/kind",
            "must be frames, gltf, usd, usdz, ply, mesh, light_matrix or delight",
        )),
    }
}

/// Checks that an export of a model can be made. Returns its number of steps.
///
/// # Errors
/// 422, which names the field; 409 if the capture that the export needs was deleted.
pub(super) async fn check(
    app: &AppState,
    tenant: &TenantId,
    model: &ModelRecord,
    export: &NewExport,
) -> Result<i64, Problem> {
    match export {
        NewExport::Frames(frames) => {
            // The number of frames does not depend on the world of the model.
            let plan = FramesPlan::of(app, tenant, frames, Up::AUTO).await?;
            Ok(i64::try_from(plan.frames()).unwrap_or(i64::MAX))
        }
        NewExport::Splats(splats) => {
            shown(splats)?;
            if let Some(environment) = &splats.environment {
                light(app, tenant, environment).await?;
            }
            if splats.max_splats == Some(0) {
                return Err(Problem::invalid_field("/max_splats", "must be at least 1"));
            }
            if splats.max_bytes == Some(0) {
                return Err(Problem::invalid_field("/max_bytes", "must be at least 1"));
            }
            if splats.relit_degree as usize > MAX_BAKED_DEGREE {
                return Err(Problem::invalid_field(
                    "/relit_degree",
                    format!("must be 0 to {MAX_BAKED_DEGREE}"),
                ));
            }
            Ok(1)
        }
        NewExport::Mesh(mesh) if !(16..=512).contains(&mesh.cells) => {
            Err(Problem::invalid_field("/cells", "must be 16 to 512"))
        }
        NewExport::Mesh(_) => Ok(1),
        NewExport::LightMatrix(matrix) => {
            let plan = MatrixPlan::of(app, tenant, matrix, Up::AUTO).await?;
            Ok(i64::try_from(plan.cameras()).unwrap_or(i64::MAX))
        }
        NewExport::Delight(spec) => delight::check(app, tenant, model, spec).await,
    }
}

/// The colour to export; `None` if it is not given.
///
/// # Errors
/// 422 for a light that the colour does not use.
pub(super) fn shown(splats: &SplatsExport) -> Result<Option<ExportedColour>, Problem> {
    match (splats.layer, &splats.environment) {
        (layer, None) => Ok(layer),
        (Some(ExportedColour::Relit) | None, Some(_)) => Ok(Some(ExportedColour::Relit)),
        (Some(_), Some(_)) => {
            Err(Problem::invalid_field("/environment", "is allowed only with the layer relit"))
        }
    }
}
