//! Metadata of resources: name, external identifier and labels.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize};

/// Maximum number of labels of a resource.
pub const MAX_LABELS: usize = 16;
const MAX_TEXT_CHARS: usize = 200;
const MAX_LABEL_CHARS: usize = 63;
/// Error text for a text for which [`has_control`] is true.
pub(super) const NO_CONTROL: &str = "must not contain control characters, such as line breaks";

/// Name, external identifier and labels of a resource.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::FromRow))]
#[schema(as = Marks)]
pub struct ResourceMetadata {
    /// Display name, 1 to 200 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(min_length = 1, max_length = 200)]
    pub name: Option<String>,
    /// Identifier in another system, 1 to 200 characters without control characters. Several resources may
    /// have the same one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(min_length = 1, max_length = 200)]
    pub external_id: Option<String>,
    /// Labels, at most 16. Keys and values have 1 to 63 characters of A-Z, a-z, 0-9, `.`, `_`, `-` and `/`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    #[cfg_attr(feature = "sqlx", sqlx(json))]
    pub labels: BTreeMap<String, String>,
}

impl ResourceMetadata {
    /// The first invalid field and the reason.
    pub fn validation_error(&self) -> Option<(&'static str, String)> {
        for (field, text) in [("name", &self.name), ("external_id", &self.external_id)] {
            if text.as_ref().is_some_and(|text| !(1..=MAX_TEXT_CHARS).contains(&text.chars().count())) {
                return Some((field, format!("must have 1 to {MAX_TEXT_CHARS} characters")));
            }
            if text.as_deref().is_some_and(has_control) {
                return Some((field, NO_CONTROL.to_owned()));
            }
        }
        if self.labels.len() > MAX_LABELS {
            return Some((
                "labels",
                format!("must have at most {MAX_LABELS} entries, would have {}", self.labels.len()),
            ));
        }
        let odd = self.labels.iter().flat_map(|(key, value)| [key, value]).find(|text| !is_label(text))?;
        let rule = format!("must have 1 to {MAX_LABEL_CHARS} characters of A-Z, a-z, 0-9, ., _, - and /");
        Some(("labels", format!("keys and values {rule}, got {odd:?}")))
    }

    /// The metadata after a change.
    #[must_use]
    pub fn changed(mut self, change: &MetadataChange) -> Self {
        if let Some(name) = &change.name {
            self.name.clone_from(name);
        }
        if let Some(external_id) = &change.external_id {
            self.external_id.clone_from(external_id);
        }
        if change.labels == Some(None) {
            self.labels.clear();
        }
        for (key, value) in change.labels.iter().flatten().flatten() {
            match value {
                Some(value) => self.labels.insert(key.clone(), value.clone()),
                None => self.labels.remove(key),
            };
        }
        self
    }
}

/// Parses labels of a query: `key:value`, separated by commas.
///
/// # Errors
/// The reason why the text is invalid.
pub fn parse_labels(text: &str) -> Result<BTreeMap<String, String>, String> {
    let mut labels = BTreeMap::new();
    for pair in text.split(',') {
        let (key, value) = pair.split_once(':').ok_or_else(|| format!("must be key:value, got {pair:?}"))?;
        if labels.insert(key.to_owned(), value.to_owned()).is_some() {
            return Err(format!("contains {key:?} twice"));
        }
    }
    Ok(labels)
}

/// True if the text has control characters, such as line breaks.
pub(super) fn has_control(text: &str) -> bool {
    text.chars().any(char::is_control)
}

fn is_label(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '/');
    (1..=MAX_LABEL_CHARS).contains(&text.len()) && text.chars().all(plain)
}

/// A change of name, external identifier and labels as a JSON merge patch (RFC 7396). Omitted fields are
/// unchanged; null clears a field.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = MarksChange)]
pub struct MetadataChange {
    /// Display name, 1 to 200 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 200)]
    pub name: Option<Option<String>>,
    /// Identifier in another system, 1 to 200 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 200)]
    pub external_id: Option<Option<String>>,
    /// Labels to set. Omitted labels are unchanged; null removes a label. null instead of the object removes
    /// all labels.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[schema(value_type = Option<BTreeMap<String, Option<String>>>)]
    pub labels: Option<Option<BTreeMap<String, Option<String>>>>,
}

impl From<ResourceMetadata> for MetadataChange {
    /// Sets the given fields and leaves the others unchanged.
    fn from(metadata: ResourceMetadata) -> Self {
        let labels = metadata.labels.into_iter().map(|(key, value)| (key, Some(value))).collect();
        Self {
            name: metadata.name.map(Some),
            external_id: metadata.external_id.map(Some),
            labels: Some(Some(labels)),
        }
    }
}

/// Distinguishes null from an omitted field.
pub(super) fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Option<T>, D::Error> {
    T::deserialize(from).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn change_sets_given_fields_and_null_clears_fields() {
        let change = |text: &str| serde_json::from_str::<MetadataChange>(text).unwrap();
        let first =
            ResourceMetadata::default().changed(&change(r#"{"name": "a", "labels": {"x": "1", "y": "2"}}"#));
        let second =
            first.clone().changed(&change(r#"{"external_id": "e", "labels": {"x": null, "z": "3"}}"#));
        assert_eq!(
            serde_json::to_string(&second).unwrap(),
            r#"{"name":"a","external_id":"e","labels":{"y":"2","z":"3"}}"#
        );
        assert_eq!(second.clone().changed(&MetadataChange::default()), second);
        let third = second
            .changed(&change(r#"{"name": null, "external_id": null, "labels": {"y": null, "z": null}}"#));
        assert_eq!(third, ResourceMetadata::default());
        assert!(first.clone().changed(&change(r#"{"labels": null}"#)).labels.is_empty(), "all of them");
        assert_eq!(ResourceMetadata::default().changed(&first.clone().into()), first);
    }

    #[test]
    fn names_and_external_ids_refuse_control_characters() {
        let called =
            |name: &str| ResourceMetadata { name: Some(name.to_owned()), ..ResourceMetadata::default() };
        for good in ["Löwe, 2. Aufnahme", "頭", "🦁 \u{fe0f}", "a\u{a0}b"] {
            assert_eq!(called(good).validation_error(), None, "{good:?}");
        }
        for odd in ["a\nb", "\0", "tab\t", "\u{1b}[2J", "\u{85}", "\u{7f}"] {
            assert_eq!(called(odd).validation_error().unwrap().0, "name", "{odd:?}");
            let with = ResourceMetadata { external_id: Some(odd.to_owned()), ..ResourceMetadata::default() };
            assert_eq!(with.validation_error().unwrap().0, "external_id", "{odd:?}");
        }
    }

    #[test]
    fn labels_are_limited_in_length_number_and_characters() {
        let with = |labels: &[(&str, &str)]| ResourceMetadata {
            labels: labels.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect(),
            ..ResourceMetadata::default()
        };
        assert_eq!(with(&[("show/shot", "sc-010_v2.1")]).validation_error(), None);
        let long = "a".repeat(64);
        for wrong in
            [("", "a"), ("a", ""), ("a b", "c"), ("a", "b,c"), ("a", "ä"), (&*long, "a"), ("a", &long)]
        {
            assert!(with(&[wrong]).validation_error().is_some(), "{wrong:?}");
        }
        let many = |count: usize| ResourceMetadata {
            labels: (0..count).map(|n| (n.to_string(), "x".to_owned())).collect(),
            ..ResourceMetadata::default()
        };
        assert_eq!((many(16).validation_error(), many(17).validation_error().unwrap().0), (None, "labels"));
        assert_eq!(parse_labels("a:1,b:x").unwrap(), with(&[("a", "1"), ("b", "x")]).labels);
        for wrong in ["", "a", "a:1,", "a:1,a:2"] {
            assert!(parse_labels(wrong).is_err(), "{wrong}");
        }
    }
}
