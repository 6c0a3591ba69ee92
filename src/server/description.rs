//! The description of the API: what handlers do not declare themselves because it is the same for all.

use axum::http::StatusCode;
use utoipa::ToSchema;
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    ComponentsBuilder, ContentBuilder, InfoBuilder, OpenApi, OpenApiBuilder, PathItem, Ref, RefOr, Response,
    ResponseBuilder, Schema,
};

/// A file as a body.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "only its schema is used")]
pub(super) struct File(Vec<u8>);

/// A capture as a form: one archive, or its files one by one.
#[derive(ToSchema)]
#[allow(dead_code, reason = "only its schema is used")]
pub(super) struct ArchiveForm {
    /// A zip, tar or tar.gz.
    #[schema(value_type = Option<String>, format = Binary, nullable = false)]
    archive: Option<Vec<u8>>,
    /// Photographs and what says where they were taken from, each with its path in the capture as its file name, e.g.
    /// `images/1.jpg` and `transforms.json`.
    #[schema(value_type = Option<Vec<String>>, nullable = false)]
    files: Option<Vec<Vec<u8>>>,
}

/// An environment map as a form.
#[derive(ToSchema)]
#[allow(dead_code, reason = "only its schema is used")]
pub(super) struct EnvironmentForm {
    /// A `.hdr` or `.exr`.
    #[schema(value_type = String, format = Binary)]
    environment: Vec<u8>,
}

/// The description without its endpoints.
pub(super) fn preamble() -> OpenApi {
    let info = InfoBuilder::new()
        .title("Relume")
        .version(env!("CARGO_PKG_VERSION"))
        .description(Some(
            "Posed photographs in, relightable 3D Gaussian models and relit frames out. Every error is an RFC 9457 \
             problem (`application/problem+json`) with a stable `type`.",
        ))
        .build();
    let bearer = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
    let components = ComponentsBuilder::new().security_scheme("bearer", bearer).build();
    // A server without keys asks for none, hence the empty alternative.
    let security =
        [SecurityRequirement::new::<_, [&str; 0], &str>("bearer", []), SecurityRequirement::default()];
    OpenApiBuilder::new().info(info).components(Some(components)).security(Some(security)).build()
}

/// Gives every operation the errors that any of them may answer with, under their own media type.
pub(super) fn with_problems(mut api: OpenApi) -> OpenApi {
    for operation in api.paths.paths.values_mut().flat_map(operations) {
        for (status, response) in &mut operation.responses.responses {
            if let RefOr::T(response) = response {
                rename_problem(response);
                describe(status, response);
            }
        }
        let any = ResponseBuilder::new()
            .description("Any other problem, e.g. 401, 413, 500")
            .content(PROBLEM, ContentBuilder::new().schema(Some(problem())).build());
        operation.responses.responses.insert("default".to_owned(), RefOr::T(any.build()));
    }
    api
}

/// Writes default values with the digits that they have in the code: 0.15 is an f32 there, and would have seventeen digits as
/// an f64.
pub(super) fn with_short_defaults(mut api: OpenApi) -> OpenApi {
    let schemas = api.components.iter_mut().flat_map(|components| components.schemas.values_mut());
    for schema in schemas {
        let RefOr::T(Schema::Object(object)) = schema else { continue };
        for field in object.properties.values_mut() {
            if let RefOr::T(Schema::Object(field)) = field
                && let Some(default) = &mut field.default
                && default.is_f64()
            {
                *default = shortest(default);
            }
        }
    }
    api
}

fn shortest(number: &serde_json::Value) -> serde_json::Value {
    let short = number.as_f64().and_then(|v| (v as f32).to_string().parse::<f64>().ok());
    short.map_or_else(|| number.clone(), Into::into)
}

const PROBLEM: &str = "application/problem+json";

fn problem() -> RefOr<Schema> {
    RefOr::Ref(Ref::from_schema_name("Problem"))
}

fn rename_problem(response: &mut Response) {
    let json = response.content.get("application/json");
    let is_problem = matches!(json, Some(RefOr::T(content)) if content.schema == Some(problem()));
    if is_problem && let Some(content) = response.content.shift_remove("application/json") {
        response.content.insert(PROBLEM.to_owned(), content);
    }
}

/// Gives a response without words of its own the meaning of its status.
fn describe(status: &str, response: &mut Response) {
    let known = status.parse().ok().and_then(|code: StatusCode| code.canonical_reason());
    if response.description.is_empty() {
        response.description = known.unwrap_or("Answer").to_owned();
    }
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = &mut Operation> {
    [
        &mut item.get,
        &mut item.head,
        &mut item.options,
        &mut item.post,
        &mut item.put,
        &mut item.patch,
        &mut item.delete,
    ]
    .into_iter()
    .flatten()
}
