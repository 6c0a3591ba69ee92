//! What people and their programs call things: a name, an identifier of their own, labels.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize};

/// Most labels of a thing.
pub const MOST_LABELS: usize = 16;
const LONGEST_TEXT: usize = 200;
const LONGEST_LABEL: usize = 63;
/// What is said of a text that [`has_control`].
pub(super) const NO_CONTROL: &str = "must have no control characters, such as line breaks";

/// What a thing is called.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::FromRow))]
pub struct Marks {
    /// A name for people, 1 to 200 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 200))]
    pub name: Option<String>,
    /// What another system calls it, 1 to 200 characters, none of them control characters. Several things may have the same.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 200))]
    pub external_id: Option<String>,
    /// At most 16, keys and values of 1 to 63 of A-Z, a-z, 0-9, `.`, `_`, `-` and `/`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    #[cfg_attr(feature = "server", sqlx(json))]
    pub labels: BTreeMap<String, String>,
}

impl Marks {
    /// The field that is wrong and what is wrong with it.
    pub fn fault(&self) -> Option<(&'static str, String)> {
        for (field, text) in [("name", &self.name), ("external_id", &self.external_id)] {
            if text.as_ref().is_some_and(|text| !(1..=LONGEST_TEXT).contains(&text.chars().count())) {
                return Some((field, format!("must have 1 to {LONGEST_TEXT} characters")));
            }
            if text.as_deref().is_some_and(has_control) {
                return Some((field, NO_CONTROL.to_owned()));
            }
        }
        if self.labels.len() > MOST_LABELS {
            return Some((
                "labels",
                format!("must be at most {MOST_LABELS}, would be {}", self.labels.len()),
            ));
        }
        let odd = self.labels.iter().flat_map(|(key, value)| [key, value]).find(|text| !is_label(text))?;
        let rule = format!("must have 1 to {LONGEST_LABEL} of A-Z, a-z, 0-9, ., _, - and /");
        Some(("labels", format!("keys and values {rule}, got {odd:?}")))
    }

    /// As it is after a change.
    #[must_use]
    pub fn changed(mut self, change: &MarksChange) -> Self {
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

/// Labels as a query has them: `key:value`, several with commas.
///
/// # Errors
/// What is wrong with them.
pub fn parse_labels(text: &str) -> Result<BTreeMap<String, String>, String> {
    let mut labels = BTreeMap::new();
    for pair in text.split(',') {
        let (key, value) = pair.split_once(':').ok_or_else(|| format!("must be key:value, got {pair:?}"))?;
        if labels.insert(key.to_owned(), value.to_owned()).is_some() {
            return Err(format!("names {key:?} twice"));
        }
    }
    Ok(labels)
}

/// Whether a text has characters that move a cursor, ring a bell or end a line where it is shown.
pub(super) fn has_control(text: &str) -> bool {
    text.chars().any(char::is_control)
}

fn is_label(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '/');
    (1..=LONGEST_LABEL).contains(&text.len()) && text.chars().all(plain)
}

/// A change of what a thing is called (RFC 7396): what is absent stays, what is null goes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct MarksChange {
    /// A name for people, 1 to 200 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, min_length = 1, max_length = 200))]
    pub name: Option<Option<String>>,
    /// What another system calls it, 1 to 200 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, min_length = 1, max_length = 200))]
    pub external_id: Option<Option<String>>,
    /// Those that are named; null takes one away, or all of them in place of the object.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[cfg_attr(feature = "server", schema(value_type = Option<BTreeMap<String, Option<String>>>))]
    pub labels: Option<Option<BTreeMap<String, Option<String>>>>,
}

impl From<Marks> for MarksChange {
    /// Sets what is there and leaves the rest.
    fn from(marks: Marks) -> Self {
        let labels = marks.labels.into_iter().map(|(key, value)| (key, Some(value))).collect();
        Self {
            name: marks.name.map(Some),
            external_id: marks.external_id.map(Some),
            labels: Some(Some(labels)),
        }
    }
}

/// Tells null from what is absent.
pub(super) fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Option<T>, D::Error> {
    T::deserialize(from).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_sets_what_it_names_and_takes_away_what_is_null() {
        let change = |text: &str| serde_json::from_str::<MarksChange>(text).unwrap();
        let first = Marks::default().changed(&change(r#"{"name": "a", "labels": {"x": "1", "y": "2"}}"#));
        let second =
            first.clone().changed(&change(r#"{"external_id": "e", "labels": {"x": null, "z": "3"}}"#));
        assert_eq!(
            serde_json::to_string(&second).unwrap(),
            r#"{"name":"a","external_id":"e","labels":{"y":"2","z":"3"}}"#
        );
        assert_eq!(second.clone().changed(&MarksChange::default()), second);
        let third = second
            .changed(&change(r#"{"name": null, "external_id": null, "labels": {"y": null, "z": null}}"#));
        assert_eq!(third, Marks::default());
        assert!(first.clone().changed(&change(r#"{"labels": null}"#)).labels.is_empty(), "all of them");
        assert_eq!(Marks::default().changed(&first.clone().into()), first);
    }

    #[test]
    fn names_are_of_one_line() {
        let called = |name: &str| Marks { name: Some(name.to_owned()), ..Marks::default() };
        for good in ["Löwe, 2. Aufnahme", "頭", "🦁 \u{fe0f}", "a\u{a0}b"] {
            assert_eq!(called(good).fault(), None, "{good:?}");
        }
        for odd in ["a\nb", "\0", "tab\t", "\u{1b}[2J", "\u{85}", "\u{7f}"] {
            assert_eq!(called(odd).fault().unwrap().0, "name", "{odd:?}");
            let with = Marks { external_id: Some(odd.to_owned()), ..Marks::default() };
            assert_eq!(with.fault().unwrap().0, "external_id", "{odd:?}");
        }
    }

    #[test]
    fn labels_are_short_and_few() {
        let with = |labels: &[(&str, &str)]| Marks {
            labels: labels.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect(),
            ..Marks::default()
        };
        assert_eq!(with(&[("show/shot", "sc-010_v2.1")]).fault(), None);
        let long = "a".repeat(64);
        for wrong in
            [("", "a"), ("a", ""), ("a b", "c"), ("a", "b,c"), ("a", "ä"), (&*long, "a"), ("a", &long)]
        {
            assert!(with(&[wrong]).fault().is_some(), "{wrong:?}");
        }
        let many = |count: usize| Marks {
            labels: (0..count).map(|n| (n.to_string(), "x".to_owned())).collect(),
            ..Marks::default()
        };
        assert_eq!((many(16).fault(), many(17).fault().unwrap().0), (None, "labels"));
        assert_eq!(parse_labels("a:1,b:x").unwrap(), with(&[("a", "1"), ("b", "x")]).labels);
        for wrong in ["", "a", "a:1,", "a:1,a:2"] {
            assert!(parse_labels(wrong).is_err(), "{wrong}");
        }
    }
}
