//! The parts of the API description that are common to all handlers.

use axum::http::StatusCode;
use utoipa::ToSchema;
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::tag::TagBuilder;
use utoipa::openapi::{
    ComponentsBuilder, ContentBuilder, InfoBuilder, OpenApi, OpenApiBuilder, PathItem, Ref, RefOr, Response,
    ResponseBuilder, Schema,
};

/// A file as the body.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "only its schema is used")]
pub(super) struct File(Vec<u8>);

/// A capture as a form: either one archive, or single files.
#[derive(ToSchema)]
#[allow(dead_code, reason = "only its schema is used")]
pub(super) struct ArchiveForm {
    /// Archive: zip, tar or tar.gz.
    #[schema(value_type = Option<String>, format = Binary, nullable = false)]
    archive: Option<Vec<u8>>,
    /// Photographs and pose files. The file name of each part is the path of the file in the capture, e.g.
    /// `images/1.jpg` and `transforms.json`.
    #[schema(value_type = Option<Vec<String>>, nullable = false)]
    files: Option<Vec<Vec<u8>>>,
}

/// An environment map as a form.
#[derive(ToSchema)]
#[allow(dead_code, reason = "only its schema is used")]
pub(super) struct EnvironmentForm {
    /// A `.hdr` or `.exr` file.
    #[schema(value_type = String, format = Binary)]
    environment: Vec<u8>,
}

/// The API description without operations.
pub(super) fn preamble() -> OpenApi {
    let info = InfoBuilder::new()
        .title("Relume")
        .version(env!("CARGO_PKG_VERSION"))
        .description(Some(
            "HTTP API of Relume. Relume trains relightable 3D Gaussian models from photographs with camera poses, and \
             renders them under other lights. Every error is an RFC 9457 problem (`application/problem+json`) with a \
             stable `type`. Requests authenticate with `Authorization: Bearer KEY`; a server without keys needs none.",
        ))
        .build();
    let bearer = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
    let components = ComponentsBuilder::new().security_scheme("bearer", bearer).build();
    // A server without keys asks for none, hence the empty alternative.
    let security =
        [SecurityRequirement::new::<_, [&str; 0], &str>("bearer", []), SecurityRequirement::default()];
    OpenApiBuilder::new()
        .info(info)
        .tags(Some(TAGS.map(|(name, text)| TagBuilder::new().name(name).description(Some(text)).build())))
        .components(Some(components))
        .security(Some(security))
        .build()
}

/// Name and description of each tag.
const TAGS: [(&str, &str); 11] = [
    ("captures", "Archives of photographs with camera poses: upload, validation, cameras and photographs."),
    ("uploads", "Resumable uploads of captures (tus 1.0.0)."),
    ("environments", "HDR environment maps, built-in and uploaded."),
    ("jobs", "Trainings: queue, state, events, previews, cancellation and retries."),
    ("models", "Trained models: metadata, files, rendered frames, thumbnails and data for viewers."),
    (
        "exports",
        "Files that the server makes of a model in the background: sequences of frames, Gaussians and meshes.",
    ),
    ("keys", "API keys of tenants and their scopes."),
    ("signed-urls", "URLs that are valid without a key for a limited time."),
    ("webhooks", "Notifications of job events, and their deliveries."),
    ("workers", "Workers, and the protocol between remote workers and the server. For operators."),
    ("operations", "Health, metrics, storage use and the description of the API."),
];

/// Adds the errors that every operation can return, and gives all problems their media type.
pub(super) fn with_problems(mut api: OpenApi) -> OpenApi {
    for operation in api.paths.paths.values_mut().flat_map(operations) {
        for (status, response) in &mut operation.responses.responses {
            if let RefOr::T(response) = response {
                rename_problem(response);
                describe(status, response);
            }
        }
        let any = ResponseBuilder::new()
            .description("Any other error, e.g. 401, 413 or 500")
            .content(PROBLEM, ContentBuilder::new().schema(Some(problem())).build());
        operation.responses.responses.insert("default".to_owned(), RefOr::T(any.build()));
    }
    api
}

/// Writes default values with the digits of the code. An f32 such as 0.15 would have seventeen digits as an
/// f64.
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

/// Gives a response without a description the reason phrase of its status.
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
