//! The list of all settings of a training, for the command line and for the reference page.

use std::fmt::Write as _;

use serde_json::Value;

use super::{LearningRateChanges, LossWeightChanges, Preset, ShadingChanges, TrainConfig, declared};

/// A setting as a caller names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Its name, with its group in front: `iterations`, `weights.l1`.
    pub path: String,
    /// The type of its value in Rust.
    pub kind: &'static str,
    /// Its effect, in one or a few sentences.
    pub documentation: String,
    /// The accepted range, if it is a number.
    pub range: Option<String>,
}

impl Setting {
    /// The group, or nothing.
    pub fn group(&self) -> Option<&str> {
        self.path.split_once('.').map(|(group, _)| group)
    }

    /// The flag of `relume train`: `--weights-l1`.
    pub fn flag(&self) -> String {
        self.path.replace(['.', '_'], "-")
    }

    /// Its value in a preset, as JSON.
    fn default_of(&self, preset: Preset) -> Value {
        let config = serde_json::to_value(TrainConfig::preset(preset)).unwrap_or_default();
        let pointer = format!("/{}", self.path.replace('.', "/"));
        config.pointer(&pointer).cloned().unwrap_or_default()
    }

    /// How much time or memory a larger value takes.
    fn cost(&self) -> &'static str {
        match self.path.as_str() {
            "iterations" => "time in proportion",
            "resolution" => "time and memory with its square",
            "max_gaussians" | "initial_gaussians" => "time and memory in proportion, beside the pixels",
            "prototypes" | "visibility_order" | "radiance_order" => "time and size of the model",
            "probe_directions" => "time of each measurement in proportion",
            "probe_every" => "a smaller value takes more time",
            "bounces" => "time of each measurement",
            "environment_rows" => "time of the light with its square",
            "half_resolution" => "a larger value takes less time",
            "warm_up" => "a larger value takes less time",
            "checkpoint_every" => "a smaller value writes more",
            "lights" => "one shadow test a light",
            _ => "none",
        }
    }
}

/// All settings: single ones in the order of their declaration, then the groups `shading`, `weights` and `rates`.
pub fn settings() -> Vec<Setting> {
    let mut all: Vec<Setting> = declared()
        .into_iter()
        .map(|(name, kind, text, range)| Setting {
            path: name.to_owned(),
            kind,
            documentation: text.trim().to_owned(),
            range,
        })
        .collect();
    for (group, fields, range) in [
        ("shading", ShadingChanges::declared(), None),
        ("weights", LossWeightChanges::declared(), Some("0 to 1000")),
        ("rates", LearningRateChanges::declared(), Some("0 to 1000")),
    ] {
        all.extend(fields.into_iter().map(|(name, kind, text)| Setting {
            path: format!("{group}.{name}"),
            kind,
            documentation: text.trim().to_owned(),
            range: range.map(str::to_owned),
        }));
    }
    all
}

/// The reference page of all settings as Markdown.
pub fn settings_page() -> String {
    let mut page = "# Settings of a training\n\n\
        This page is generated from the table of settings; `RELUME_ACCEPT=1 cargo test --release -p relume-spec settings_page` renews it.\n\n\
        Each setting is a flag of `relume train` (`--max-gaussians 20000`), a pair of `--set` (`--set weights.smoothness=0.02`) and a field of\n\
        `overrides` in `POST /v1/jobs` (`{\"weights\": {\"smoothness\": 0.02}}`). Omitted settings have the value of the preset. Fields of a group that\n\
        are omitted are unchanged. Three more fields of `overrides` are no settings: `light`, `light_rotation_per_photo` and `grey_card`\n\
        ([light](light.md)).\n"
        .to_owned();
    let mut last = None;
    for setting in settings() {
        let group = setting.group().unwrap_or("single").to_owned();
        if last.as_ref() != Some(&group) {
            let title = setting.group().unwrap_or("Single settings");
            let _ = write!(
                page,
                "\n## {title}\n\n| setting | type | range | draft | standard | high | effect | cost of a larger value |\n\
                 |---|---|---|---|---|---|---|---|\n"
            );
        }
        last = Some(group);
        let of = |preset| match setting.default_of(preset) {
            Value::Null => "-".to_owned(),
            value => value.to_string().replace('"', ""),
        };
        let [draft, standard, high] = [Preset::Draft, Preset::Standard, Preset::High].map(of);
        let range = setting.range.as_deref().unwrap_or("-");
        let text = setting.documentation.replace('|', "\\|");
        let _ = writeln!(
            page,
            "| `{}` | {} | {range} | {draft} | {standard} | {high} | {text} | {} |",
            setting.path,
            setting.kind,
            setting.cost()
        );
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::TrainOverrides;

    #[test]
    fn settings_page_in_docs_is_current() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/guide/settings.md");
        let page = settings_page();
        if std::env::var_os("RELUME_ACCEPT").is_some() {
            std::fs::write(path, &page).unwrap();
        }
        let stored = std::fs::read_to_string(path).unwrap_or_default();
        assert!(stored == page, "run RELUME_ACCEPT=1 cargo test --release -p relume-spec settings_page");
    }

    #[test]
    fn every_setting_is_read_from_overrides() {
        let all = settings();
        assert!(all.len() > 50, "{}", all.len());
        for setting in all {
            let value = match setting.default_of(Preset::Standard) {
                Value::Null => continue,
                value => value,
            };
            let overrides = match setting.path.split_once('.') {
                Some((group, name)) => serde_json::json!({ group: { name: value } }),
                None => serde_json::json!({ setting.path.clone(): value }),
            };
            let read = serde_json::from_value::<TrainOverrides>(overrides);
            assert!(read.is_ok(), "{}: {}", setting.path, read.unwrap_err());
        }
        let wrong = serde_json::json!({ "weights": { "l3": 1.0 } });
        assert!(serde_json::from_value::<TrainOverrides>(wrong).is_err(), "the control");
    }
}
