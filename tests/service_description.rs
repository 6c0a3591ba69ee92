//! The API's description: whole, without dangling references, and the one that is checked in.

use serde_json::Value;

#[test]
fn every_openapi_response_has_a_description() {
    let description = serde_json::to_value(relume::server::openapi()).unwrap();
    let mut answers = 0;
    for (path, item) in description["paths"].as_object().unwrap() {
        for operation in item.as_object().unwrap().values().filter(|o| o.get("responses").is_some()) {
            for (status, answer) in operation["responses"].as_object().unwrap() {
                let words = answer["description"].as_str().unwrap_or_default();
                assert!(!words.is_empty(), "{path} {status}");
                answers += 1;
            }
        }
    }
    assert!(answers > 50);
}

#[test]
fn every_openapi_ref_resolves() {
    let description = serde_json::to_value(relume::server::openapi()).unwrap();
    let text = description.to_string();
    let references: Vec<&str> =
        text.split("\"$ref\":\"#").skip(1).map(|t| t.split('"').next().unwrap()).collect();
    assert!(references.len() > 20);
    for reference in references {
        assert!(description.pointer(reference).is_some(), "{reference} is dangling");
    }
}

#[test]
fn checked_in_openapi_file_matches_the_code() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json");
    let stored: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let generated = serde_json::to_value(relume::server::openapi()).unwrap();
    assert!(stored == generated, "run: cargo run --release -- openapi > openapi/openapi.json");
    let paths = generated["paths"].as_object().unwrap();
    let render = &paths["/v1/models/{id}/render"]["post"]["responses"];
    assert!(render["422"]["content"]["application/problem+json"].is_object(), "{render}");
    assert!(render["200"]["content"]["image/png"].is_object());
    assert!(paths.len() >= 18, "{:?}", paths.keys().collect::<Vec<_>>());
    // What a job may change is spelled out, down to the defaults of what is nested.
    let schemas = &generated["components"]["schemas"];
    let overrides = &schemas["TrainOverrides"];
    assert_eq!(overrides["additionalProperties"], false);
    assert!(overrides["properties"]["light"].to_string().contains("KnownLight"), "{overrides}");
    assert_eq!(schemas["LearningRates"]["properties"]["environment"]["default"], 0.15);
}
