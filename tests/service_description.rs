//! The API description: complete, without dangling references, and equal to the checked-in file.

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
    // The settings that a job can change are described, including the defaults of nested fields.
    let schemas = &generated["components"]["schemas"];
    let overrides = &schemas["TrainOverrides"];
    assert_eq!(overrides["additionalProperties"], false);
    assert!(overrides["properties"]["light"].to_string().contains("KnownLight"), "{overrides}");
    assert_eq!(schemas["LearningRates"]["properties"]["environment"]["default"], 0.15);
}

/// Every text of the description that a reader sees, with the path to it.
fn texts(value: &serde_json::Value, at: &str, found: &mut Vec<(String, String)>) {
    match value {
        serde_json::Value::Object(fields) => {
            for (key, value) in fields {
                match value.as_str().filter(|_| key == "description" || key == "summary") {
                    Some(text) => found.push((format!("{at}/{key}"), text.to_owned())),
                    None => texts(value, &format!("{at}/{key}"), found),
                }
            }
        }
        serde_json::Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                texts(item, &format!("{at}/{i}"), found);
            }
        }
        _ => {}
    }
}

/// A part of a text that only readers of the source code understand.
fn source_reference(text: &str) -> Option<&'static str> {
    ["[`", "Eq. ", "docs/", "crates/", "src/", "::"].into_iter().find(|part| text.contains(part))
}

#[test]
fn openapi_texts_do_not_refer_to_source_code() {
    let description = serde_json::to_value(relume::server::openapi()).unwrap();
    let mut found = Vec::new();
    texts(&description, "", &mut found);
    assert!(found.len() > 500, "{}", found.len());
    let wrong: Vec<_> = found.iter().filter_map(|(at, text)| Some((at, source_reference(text)?))).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert_eq!(source_reference("as [`Camera`] says"), Some("[`"), "the control");
    assert_eq!(source_reference("Width, pixels."), None);
}

#[test]
fn openapi_tags_and_operations_are_described() {
    let description = serde_json::to_value(relume::server::openapi()).unwrap();
    let tags: Vec<&str> =
        description["tags"].as_array().unwrap().iter().map(|t| t["name"].as_str().unwrap()).collect();
    assert!(description["tags"].as_array().unwrap().iter().all(|tag| tag["description"].is_string()));
    for (path, methods) in description["paths"].as_object().unwrap() {
        for (method, operation) in
            methods.as_object().unwrap().iter().filter(|(_, o)| o["operationId"].is_string())
        {
            let summary = operation["summary"].as_str().unwrap_or_default();
            assert!((1..=80).contains(&summary.len()), "{method} {path}: {summary:?}");
            for tag in operation["tags"].as_array().unwrap() {
                assert!(
                    tags.contains(&tag.as_str().unwrap()),
                    "{method} {path}: tag {tag} has no description"
                );
            }
        }
    }
}
