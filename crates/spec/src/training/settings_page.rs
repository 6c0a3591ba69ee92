//! Generates docs/guide/settings.md and checks the table of settings.

use std::fmt::Write as _;

use serde_json::Value;

use super::{Preset, Setting, TrainConfig, TrainOverrides, settings};

/// The cost of a larger value in time and memory, for settings that have one.
const COSTS: &[(&str, &str)] = &[
    ("iterations", "time in proportion"),
    ("resolution", "time and memory with its square"),
    ("max_gaussians", "time and memory in proportion, beside the pixels"),
    ("initial_gaussians", "time and memory in proportion, beside the pixels"),
    ("prototypes", "time and size of the model"),
    ("visibility_order", "time and size of the model"),
    ("radiance_order", "time and size of the model"),
    ("probe_directions", "time of each measurement in proportion"),
    ("probe_every", "a smaller value takes more time"),
    ("bounces", "time of each measurement"),
    ("environment_rows", "time of the light with its square"),
    ("half_resolution", "a larger value takes less time"),
    ("warm_up", "a larger value takes less time"),
    ("checkpoint_every", "a smaller value writes more"),
    ("lights", "one shadow test a light"),
    ("environment_restarts", "a measurement of visibility before each restart"),
    ("shading.shade_at", "`pixel` takes more time"),
];

/// Its value in a preset, as JSON.
fn default_of(setting: &Setting, preset: Preset) -> Value {
    let config = TrainConfig::preset(preset);
    config.value_of(&setting.path).or_else(|| value_in_group(&config, &setting.path)).unwrap_or_default()
}

/// The effect of a larger value on time and memory.
fn cost(setting: &Setting) -> &'static str {
    COSTS.iter().find(|(path, _)| *path == setting.path).map_or("none", |(_, cost)| cost)
}

/// The value of `group.setting`, as JSON.
fn value_in_group(config: &TrainConfig, path: &str) -> Option<Value> {
    let config = serde_json::to_value(config).ok()?;
    config.pointer(&format!("/{}", path.replace('.', "/"))).cloned()
}

/// A default as a reader writes it. JSON numbers are f64, settings f32.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.clone(),
        Value::Number(number) if number.is_f64() => {
            number.as_f64().map_or_else(String::new, |v| (v as f32).to_string())
        }
        other => other.to_string(),
    }
}

/// The reference page of all settings as Markdown.
fn settings_page() -> String {
    let mut page = "# Settings of a training\n\n\
        This page is generated from the table of settings; `RELUME_ACCEPT=1 cargo test --release -p relume-spec settings_page` renews it.\n\n\
        Each setting except `light_rotations` is a flag of `relume train` (`--max-gaussians 20000`). Each setting is a pair of `--set` (`--set weights.smoothness=0.02`) and a field of\n\
        `overrides` in `POST /v1/jobs` (`{\"weights\": {\"smoothness\": 0.02}}`). Omitted settings have the value of the preset. Fields of a group that\n\
        are omitted are unchanged. Seven more fields of `overrides` are no settings: `light`, `light_rotation_per_photo`, `light_groups`, `grey_card` and `colour_chart`\n\
        ([light](light.md)), `time_budget_s` and `until` ([training](training.md#time-in-place-of-a-preset)).\n"
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
        let of = |preset| shown(&default_of(&setting, preset));
        let [draft, standard, high] = [Preset::Draft, Preset::Standard, Preset::High].map(of);
        let range = setting.range.as_deref().unwrap_or("-");
        let text = setting.documentation.replace('|', "\\|");
        let _ = writeln!(
            page,
            "| `{}` | {} | {range} | {draft} | {standard} | {high} | {text} | {} |",
            setting.path,
            setting.kind,
            cost(&setting)
        );
    }
    page
}

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

/// A value of `setting` other than its default.
fn another(setting: &Setting) -> Value {
    match (setting.path.as_str(), default_of(setting, Preset::Standard)) {
        ("labels", _) => "both".into(),
        ("white_balance", _) => "neutral".into(),
        ("crop", _) => "auto".into(),
        ("complexity", _) => "full".into(),
        ("turntable_capture", _) => "yes".into(),
        ("up", _) => "-y".into(),
        ("lights", _) => 1.into(),
        ("method", _) => "3dgs".into(),
        ("shading.visibility" | "shading.indirect", _) => "off".into(),
        ("shading.diffuse", _) => "ambient_occlusion".into(),
        ("shading.shade_at", _) => "pixel".into(),
        ("shading.normal", _) => "free".into(),
        ("shading.occluder_reach", _) => 1.5.into(),
        (_, Value::Bool(value)) => (!value).into(),
        (_, Value::Number(value)) if value.is_f64() => (0.37 * value.as_f64().unwrap() + 0.0123).into(),
        (_, Value::Number(value)) => (value.as_u64().unwrap() + 1).into(),
        (path, other) => panic!("{path}: {other}"),
    }
}

#[test]
fn every_override_changes_the_configuration() {
    let all = settings();
    assert!(all.len() > 50, "{}", all.len());
    for setting in all {
        let value = another(&setting);
        let overrides = match setting.path.split_once('.') {
            Some((group, name)) => serde_json::json!({ group: { name: value } }),
            None => serde_json::json!({ setting.path.clone(): value }),
        };
        let overrides = serde_json::from_value::<TrainOverrides>(overrides).expect(&setting.path);
        let config = TrainConfig::new(Preset::Standard, &overrides).expect(&setting.path);
        let found = config.value_of(&setting.path).or_else(|| value_in_group(&config, &setting.path));
        assert_eq!(found.as_ref().map(shown), Some(shown(&value)), "{}", setting.path);
        assert_ne!(found, Some(default_of(&setting, Preset::Standard)), "{}", setting.path);
    }
    let wrong = serde_json::json!({ "weights": { "l3": 1.0 } });
    assert!(serde_json::from_value::<TrainOverrides>(wrong).is_err(), "the control");
}

#[test]
fn every_cost_belongs_to_a_setting() {
    let all = settings();
    for (path, _) in COSTS {
        assert!(all.iter().any(|setting| setting.path == *path), "{path}");
    }
}
