//! Lights on the command line.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

use relume_capture::formats::environment;
use relume_capture::{BUILTIN, Capture, builtin};
use relume_scene::{EnvMap, Illumination, Model};
use relume_spec::training::TrainConfig;

/// A built-in map, or the contents of a `.hdr` or `.exr` file. The error lists the allowed names; `others` are additional names
/// that the caller accepts.
pub(super) fn named_light(name: &str, others: &str) -> Result<EnvMap, String> {
    if let Some(map) = builtin(name) {
        return Ok(map);
    }
    let bytes = std::fs::read(name).map_err(|error| {
        format!("{name}: {error}; expected a file, {others}or one of {}", BUILTIN.join(", "))
    })?;
    let loaded = environment::decode(&bytes).map_err(|error| format!("{name}: {error}"))?;
    for warning in &loaded.warnings {
        eprintln!("warning: {name}: {warning}");
    }
    Ok(loaded.map)
}

/// The light with a name: `recovered`, `recovered:GROUP`, or as [`named_light`].
pub(super) fn illumination(name: &str, model: &Model) -> Result<Illumination, String> {
    match model.named_recovered_light(name) {
        Some(light) => light,
        None => Ok(named_light(name, "recovered ")?.into()),
    }
}

/// Reads rotations of the light per photograph, degrees, from a JSON object.
pub(super) fn read_rotations(file: &Path) -> Result<BTreeMap<String, f64>, String> {
    let named = |error: &dyn Display| format!("{}: {error}", file.display());
    let text = std::fs::read(file).map_err(|error| named(&error))?;
    serde_json::from_slice(&text).map_err(|error| named(&error))
}

/// Sets the measured light of `capture`, if `config` names one.
pub(super) fn illuminate(capture: &mut Capture, config: &TrainConfig) -> Result<(), String> {
    if let Some(known) = &config.light {
        relume_train::illuminate(known, capture, named_light(&known.environment, "")?);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};
    use relume_spec::training::{Preset, TrainOverrides};

    fn measured_light(overrides: &str) -> Result<Option<EnvMap>, String> {
        let overrides: TrainOverrides = serde_json::from_str(overrides).unwrap();
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        let options =
            SyntheticOptions { size: 4, train_views: 3, test_views: 0, paths: 4, ..Default::default() };
        let mut capture = synthetic(&options).unwrap();
        illuminate(&mut capture, &config).map(|()| capture.measured_light)
    }

    #[test]
    fn capture_light_is_the_one_named_in_the_settings() {
        assert_eq!(measured_light(r#"{"light": {"environment": "studio"}}"#), Ok(builtin("studio")));
        assert_eq!(measured_light("{}"), Ok(None));
        let missing = measured_light(r#"{"light": {"environment": "no/such.hdr"}}"#).unwrap_err();
        assert!(missing.starts_with("no/such.hdr: "), "{missing}");
    }
}
