//! Arguments that several commands share.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use relume_spec::rendering::{Quality, Tier};
use relume_spec::training::TrainOverrides;

/// The rendering tier and its sampling.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct QualityArgs {
    /// Rendering tier: `preview`, `standard`, `high` or `monte_carlo`. Default: `standard` for `render`, `high` for `eval`.
    #[arg(long, value_parser = named::<Tier>)]
    pub tier: Option<Tier>,
    /// Directions that the Monte-Carlo tier samples per pixel.
    #[arg(long, default_value_t = Quality::SAMPLES,
          value_parser = clap::value_parser!(u32).range(1..=i64::from(Quality::MAX_SAMPLES)))]
    pub samples: u32,
    /// Seed of the sampled directions.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

impl Default for QualityArgs {
    fn default() -> Self {
        let Quality { samples, seed, .. } = Quality::default();
        Self { tier: None, samples, seed }
    }
}

impl QualityArgs {
    /// The requested quality; `otherwise` is the tier if none was given.
    pub(super) fn quality(self, otherwise: Tier) -> Quality {
        Quality { tier: self.tier.unwrap_or(otherwise), samples: self.samples, seed: self.seed }
    }
}

/// Parses a named value, spelled as in the API.
pub(super) fn named<T: DeserializeOwned>(name: &str) -> Result<T, String> {
    serde_json::from_value(Value::String(name.to_owned())).map_err(|e| e.to_string())
}

/// The name of a value as the API spells it, the inverse of [`named`]. Empty for a value that is not written as a string.
pub(super) fn name_of(value: impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Overrides from flags and `--set key=value` pairs. A key may name a field of a group: `weights.smoothness`. A value that is not
/// JSON is a string. A flag overrides a pair; a later pair overrides an earlier one.
pub(super) fn overrides(flags: &[(&str, Option<Value>)], set: &[String]) -> Result<TrainOverrides, String> {
    let mut fields = Map::new();
    for pair in set {
        let (key, value) = pair.split_once('=').ok_or_else(|| format!("--set {pair}: must be key=value"))?;
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
        insert(&mut fields, key.trim(), value).map_err(|reason| format!("--set {pair}: {reason}"))?;
    }
    for (key, value) in flags {
        if let Some(value) = value {
            fields.insert((*key).to_owned(), value.clone());
        }
    }
    serde_path_to_error::deserialize(Value::Object(fields))
        .map_err(|e| format!("setting {}: {}", e.path(), e.inner()))
}

/// Sets `key`, one name or several names separated by dots, to `value`.
fn insert(fields: &mut Map<String, Value>, key: &str, value: Value) -> Result<(), String> {
    let Some((group, rest)) = key.split_once('.') else {
        fields.insert(key.to_owned(), value);
        return Ok(());
    };
    match fields.entry(group).or_insert_with(|| Value::Object(Map::new())) {
        Value::Object(inner) => insert(inner, rest, value),
        _ => Err(format!("{group} already has a value that is not a group")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_accepts_json_or_strings_and_flags_take_precedence() {
        let set = ["labels=both".to_owned(), "seed=3".to_owned()];
        let overrides = overrides(&[("seed", Some(4.into())), ("resolution", None)], &set).unwrap();
        assert_eq!(overrides.seed, Some(4));
        assert_eq!(overrides.labels, Some(relume_spec::training::LabelSource::Both));
    }

    #[test]
    fn dotted_keys_set_single_fields_of_a_group() {
        let set = ["weights.smoothness=0.02", "weights.l1=0.5", "rates.mean=1e-3"].map(str::to_owned);
        let overrides = overrides(&[], &set).unwrap();
        let weights = overrides.weights.unwrap();
        assert_eq!((weights.smoothness, weights.l1, weights.ssim), (Some(0.02), Some(0.5), None));
        assert_eq!(overrides.rates.unwrap().mean, Some(1e-3));
        for wrong in [&["weights.smoothnes=1"][..], &["seed=3", "seed.x=1"], &["weights.l1.x=1"]] {
            let wrong: Vec<String> = wrong.iter().map(|pair| (*pair).to_owned()).collect();
            let error = super::overrides(&[], &wrong).unwrap_err();
            assert!(error.starts_with("setting weights") || error.starts_with("--set seed.x=1"), "{error}");
        }
    }

    #[test]
    fn names_are_printed_as_they_are_parsed() {
        for name in ["preview", "standard", "high", "monte_carlo"] {
            assert_eq!(name_of(named::<Tier>(name).unwrap()), name);
        }
        assert!(named::<Tier>("MonteCarlo").is_err(), "the control");
    }

    #[test]
    fn an_unknown_key_is_named_in_the_error() {
        let error = overrides(&[], &["speed=11".to_owned()]).unwrap_err();
        assert!(error.contains("speed"), "{error}");
    }
}
