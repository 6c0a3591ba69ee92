//! Every operation of the API, with its subject and its scope.

use relume_api::keys::Scope;

/// The resources that an operation is about.
#[derive(Clone, Copy, PartialEq)]
pub enum About {
    /// No resource of a tenant; no key is needed.
    Everybody,
    /// The whole server, for the operator.
    Server,
    /// A list of one kind of resource.
    List(Kind),
    /// The resource in the path.
    One(Kind),
    /// The storage use.
    Counts,
    /// The body of the request.
    Body,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Capture,
    Environment,
    Export,
    Job,
    Model,
    Key,
    Upload,
    Webhook,
    /// A delivery to a webhook; its identifier consists of both, as in a path.
    Delivery,
}

use About::{Body, Counts, Everybody, List, One, Server};
use Kind::{Capture, Delivery, Environment, Export, Job, Key, Model, Upload, Webhook};
use Scope::{Admin, Metrics, Read, Render, Submit, Work};

/// Every operation, with its subject and the scope that it needs.
const OPERATIONS: &[(&str, &str, About, Scope)] = &[
    ("get", "/healthz", Everybody, Read),
    ("get", "/readyz", Everybody, Read),
    ("get", "/v1/openapi.json", Everybody, Read),
    ("get", "/metrics", Server, Metrics),
    ("get", "/v1/captures", List(Capture), Read),
    ("post", "/v1/captures", Body, Submit),
    ("post", "/v1/captures/validate", Body, Submit),
    ("get", "/v1/captures/{id}", One(Capture), Read),
    ("get", "/v1/captures/{id}/cameras", One(Capture), Read),
    ("get", "/v1/captures/{id}/log", One(Capture), Read),
    ("get", "/v1/captures/{id}/photographs", One(Capture), Read),
    ("get", "/v1/captures/{id}/photographs/{name}", One(Capture), Read),
    ("patch", "/v1/captures/{id}", One(Capture), Submit),
    ("delete", "/v1/captures/{id}", One(Capture), Submit),
    ("get", "/v1/environments", List(Environment), Read),
    ("post", "/v1/environments", Body, Submit),
    ("get", "/v1/environments/{id}", One(Environment), Read),
    ("patch", "/v1/environments/{id}", One(Environment), Submit),
    ("delete", "/v1/environments/{id}", One(Environment), Submit),
    ("get", "/v1/exports", List(Export), Read),
    ("get", "/v1/exports/{id}", One(Export), Read),
    ("delete", "/v1/exports/{id}", One(Export), Render),
    ("get", "/v1/exports/{id}/file", One(Export), Read),
    ("get", "/v1/jobs", List(Job), Read),
    ("post", "/v1/jobs", Body, Submit),
    ("get", "/v1/jobs/{id}", One(Job), Read),
    ("delete", "/v1/jobs/{id}", One(Job), Submit),
    ("patch", "/v1/jobs/{id}", One(Job), Submit),
    ("post", "/v1/jobs/{id}/cancel", One(Job), Submit),
    ("post", "/v1/jobs/{id}/retry", One(Job), Submit),
    ("get", "/v1/jobs/{id}/events", One(Job), Read),
    ("get", "/v1/jobs/{id}/preview", One(Job), Read),
    ("get", "/v1/keys", List(Key), Admin),
    ("post", "/v1/keys", Body, Admin),
    ("get", "/v1/keys/{id}", One(Key), Admin),
    ("post", "/v1/keys/{id}/revoke", One(Key), Admin),
    ("get", "/v1/models", List(Model), Read),
    ("get", "/v1/models/{id}", One(Model), Read),
    ("patch", "/v1/models/{id}", One(Model), Submit),
    ("delete", "/v1/models/{id}", One(Model), Submit),
    ("get", "/v1/models/{id}/materials", One(Model), Read),
    ("get", "/v1/models/{id}/materials/{material}/mask", One(Model), Read),
    ("post", "/v1/models/{id}/next-photographs", One(Model), Render),
    ("put", "/v1/models/{id}/calibration", One(Model), Submit),
    ("delete", "/v1/models/{id}/calibration", One(Model), Submit),
    ("get", "/v1/models/{id}/card", One(Model), Read),
    ("get", "/v1/models/{id}/files/{name}", One(Model), Read),
    ("post", "/v1/models/{id}/exports", One(Model), Render),
    ("post", "/v1/models/{id}/render", One(Model), Render),
    ("get", "/v1/models/{id}/thumbnail", One(Model), Read),
    ("get", "/v1/models/{id}/stream", One(Model), Read),
    ("get", "/v1/models/{id}/light", One(Model), Read),
    ("post", "/v1/signed-urls", Body, Read),
    ("get", "/share/{id}", Everybody, Read),
    ("options", "/v1/uploads", Everybody, Read),
    ("get", "/v1/uploads", List(Upload), Read),
    ("post", "/v1/uploads", Body, Submit),
    ("get", "/v1/uploads/{id}", One(Upload), Submit),
    ("head", "/v1/uploads/{id}", One(Upload), Submit),
    ("patch", "/v1/uploads/{id}", One(Upload), Submit),
    ("post", "/v1/uploads/{id}", One(Upload), Submit),
    ("delete", "/v1/uploads/{id}", One(Upload), Submit),
    ("get", "/v1/usage", Counts, Read),
    ("get", "/v1/webhooks", List(Webhook), Admin),
    ("post", "/v1/webhooks", Body, Admin),
    ("get", "/v1/webhooks/{id}", One(Webhook), Admin),
    ("patch", "/v1/webhooks/{id}", One(Webhook), Admin),
    ("delete", "/v1/webhooks/{id}", One(Webhook), Admin),
    ("post", "/v1/webhooks/{id}/rotate-secret", One(Webhook), Admin),
    ("get", "/v1/webhooks/{id}/deliveries", One(Webhook), Admin),
    ("post", "/v1/webhooks/{id}/deliveries/{delivery}/replay", One(Delivery), Admin),
    ("get", "/v1/workers", Server, Metrics),
    ("get", "/v1/workers/{id}", Server, Metrics),
    ("patch", "/v1/workers/{id}", Server, Admin),
    ("post", "/v1/work/claims", Server, Work),
    ("post", "/v1/work/{job}/heartbeat", Server, Work),
    ("post", "/v1/work/{job}/progress", Server, Work),
    ("post", "/v1/work/{job}/warnings", Server, Work),
    ("post", "/v1/work/{job}/model", Server, Work),
    ("post", "/v1/work/{job}/end", Server, Work),
    ("get", "/v1/work/{job}/capture", Server, Work),
    ("get", "/v1/work/{job}/environments/{environment}", Server, Work),
    ("get", "/v1/work/{job}/checkpoint", Server, Work),
    ("put", "/v1/work/{job}/checkpoints/{step}", Server, Work),
    ("put", "/v1/work/{job}/files/{name}", Server, Work),
];

/// The operations of the description, each with its entry in the table.
pub fn operations() -> Vec<&'static (&'static str, &'static str, About, Scope)> {
    let description = serde_json::to_value(relume::server::openapi()).unwrap();
    let mut found = Vec::new();
    for (path, item) in description["paths"].as_object().unwrap() {
        for (method, _) in item.as_object().unwrap().iter().filter(|(_, o)| o.get("responses").is_some()) {
            let known = OPERATIONS.iter().find(|(m, p, _, _)| (m, p) == (&&**method, &&**path));
            found.push(known.unwrap_or_else(|| panic!("this test does not know how to ask {method} {path}")));
        }
    }
    assert_eq!(found.len(), OPERATIONS.len(), "the description has every operation of the table");
    found
}
