use super::*;
use relume_scene::IndirectForm;

#[test]
fn overrides_change_only_the_given_settings() {
    let overrides = TrainOverrides { iterations: Some(7), ..Default::default() };
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    assert_eq!(TrainConfig { iterations: 1_500, ..config }, TrainConfig::preset(Preset::Draft));
}

#[test]
fn only_settings_given_by_the_caller_are_forced() {
    let forced = |o: TrainOverrides| TrainConfig::new(Preset::Draft, &o).unwrap().forced;
    assert_eq!(
        forced(TrainOverrides { visibility_order: Some(3), ..Default::default() }),
        [ComplexitySetting::Visibility]
    );
    let shading =
        forced(TrainOverrides { shading: Some(ShadingOptions::default().into()), ..Default::default() });
    assert_eq!(shading, [ComplexitySetting::Visibility, ComplexitySetting::Indirect]);
    assert!(forced(TrainOverrides { iterations: Some(9), ..Default::default() }).is_empty());
}

#[test]
fn forced_settings_keep_the_order_of_stored_files() {
    let overrides = TrainOverrides {
        prototypes: Some(4),
        bounces: Some(1),
        sheen: Some(true),
        shading: Some(ShadingOptions::default().into()),
        ..Default::default()
    };
    let forced = TrainConfig::new(Preset::Draft, &overrides).unwrap().forced;
    let json = serde_json::to_value(forced).unwrap();
    assert_eq!(json, serde_json::json!(["visibility", "indirect", "sheen", "prototypes"]));
}

#[test]
fn values_out_of_range_are_refused_by_field() {
    let refused = |o: TrainOverrides| TrainConfig::new(Preset::Draft, &o).unwrap_err();
    let none = refused(TrainOverrides { iterations: Some(0), ..Default::default() });
    assert_eq!((none.field.as_str(), none.reason.as_str()), ("iterations", "0 is outside 1 to 1000000"));
    let share = refused(TrainOverrides { warm_up: Some(f32::NAN), ..Default::default() });
    assert_eq!(share.to_string(), "warm_up: NaN is outside 0 to 1");
    let rates = LearningRates { mean: f32::INFINITY, ..Default::default() };
    let rate = refused(TrainOverrides { rates: Some(rates.into()), ..Default::default() });
    assert_eq!(rate.to_string(), "rates.mean: must be 0 to 1000");
    let shading = |json: &str| refused(serde_json::from_str(json).unwrap()).to_string();
    assert_eq!(shading(r#"{"shading": {"low_pass": -5}}"#), "shading.low_pass: must be 0 to 100 px^2");
    assert_eq!(shading(r#"{"shading": {"low_pass": 1e39}}"#), "shading.low_pass: must be 0 to 100 px^2");
    let reach = "shading.occluder_reach: must be above 0 and finite";
    for wrong in ["-1", "0", "1e39"] {
        assert_eq!(shading(&format!(r#"{{"shading": {{"occluder_reach": {wrong}}}}}"#)), reach);
    }
    let unknown = serde_json::from_str::<TrainOverrides>(r#"{"iterration": 5}"#).unwrap_err();
    assert!(unknown.to_string().contains("iterration"));
}

#[test]
fn documented_ranges_match_the_checked_ranges() {
    let ranges: Vec<_> =
        declared().into_iter().filter_map(|(name, _, text, range)| Some((name, text, range?))).collect();
    assert_eq!(ranges.len(), 17);
    for (name, documentation, range) in ranges {
        let plain = documentation.replace(',', "");
        assert!(plain.contains(&format!(" {range}")), "{name}: {documentation:?}, {range:?}");
    }
}

#[test]
fn config_round_trips_and_older_files_get_default_settings() {
    let overrides: TrainOverrides =
        serde_json::from_str(r#"{"seed": 3, "light": {"environment": "studio"}, "bounces": 1}"#).unwrap();
    let config = TrainConfig::new(Preset::High, &overrides).unwrap();
    let mut json = serde_json::to_value(&config).unwrap();
    assert_eq!(serde_json::from_value::<TrainConfig>(json.clone()).unwrap(), config);
    let newer = [
        "albedo_rounds",
        "metalness",
        "sheen",
        "complexity",
        "forced",
        "light",
        "light_rotations",
        "turntable_capture",
    ];
    newer.iter().for_each(|name| drop(json.as_object_mut().unwrap().remove(*name)));
    let old: TrainConfig = serde_json::from_value(json.clone()).unwrap();
    assert_eq!((old.albedo_rounds, old.metalness, old.sheen, old.light_rotations), (0, true, true, true));
    assert_eq!((old.complexity, old.forced, old.light), (Complexity::Full, Vec::new(), None));
    assert_eq!(
        old.turntable_capture, config.turntable_capture,
        "its checkpoints resume with the settings of their caller"
    );
    json.as_object_mut().unwrap().remove("seed");
    assert!(serde_json::from_value::<TrainConfig>(json).is_err(), "the control: every file has a seed");
}

#[test]
fn estimated_light_colour_is_kept_until_the_second_restart() {
    let config = TrainConfig::preset(Preset::Draft);
    let first = config.warm_up_steps();
    let is_round = |step: &u32| config.is_albedo_round(*step);
    let second = (first..config.iterations).filter(is_round).nth(1).unwrap();
    let tolerance = |config: &TrainConfig, step: u32| {
        config.light_colour_tolerance(step as f32 / config.iterations as f32)
    };
    assert_eq!(tolerance(&config, first), 0.0);
    assert_eq!(tolerance(&config, second - 2), 0.0);
    assert!(tolerance(&config, second + 2) > 0.1);
    let stated = TrainConfig { white_balance: "daylight".parse().unwrap(), ..config };
    assert_eq!(tolerance(&stated, second + 2), 0.0, "a stated colour is kept to the end");
}

#[test]
fn radiance_weight_is_higher_without_masks() {
    let config = TrainConfig::preset(Preset::Draft);
    assert_eq!(config.radiance_weight(true), config.weights.radiance);
    assert!(config.radiance_weight(false) > config.weights.radiance);
}

#[test]
fn restarts_come_at_odd_tenths_of_the_material_steps() {
    let config = TrainConfig { albedo_rounds: 3, ..TrainConfig::preset(Preset::Draft) };
    let steps: Vec<u32> = (0..config.iterations).filter(|s| config.is_albedo_round(*s)).collect();
    assert_eq!(steps, [375 + 112, 375 + 337, 375 + 562]);
    let none = TrainConfig { albedo_rounds: 0, ..config };
    assert!(!(0..none.iterations).any(|s| none.is_albedo_round(s)), "the control");
}

/// The configuration of `method`, with the method's name taken off it.
fn of_method(method: Method, overrides: TrainOverrides) -> TrainConfig {
    let overrides = TrainOverrides { method: Some(method), ..overrides };
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    assert_eq!(config.method, method);
    TrainConfig { method: Method::Relume, ..config }
}

#[test]
fn methods_have_distinct_configs_and_relume_is_the_default() {
    let ours = TrainConfig::preset(Preset::Draft);
    assert_eq!(of_method(Method::Relume, TrainOverrides::default()), ours);
    let mut seen = Vec::new();
    for method in Method::ALL {
        let config = of_method(method, TrainOverrides::default());
        assert!(!seen.contains(&config), "{method:?} repeats another");
        assert_eq!(config == ours, method == Method::Relume, "{method:?}");
        assert_eq!(config.warm_up < 1.0, method != Method::Splatting, "{method:?}");
        let learns_indirect = config.shading.indirect == IndirectForm::Learned;
        assert!(
            !learns_indirect || config.labels != LabelSource::Probes,
            "{method:?}: nothing would train it"
        );
        seen.push(config);
    }
}

#[test]
fn caller_settings_override_the_method() {
    let caller = TrainOverrides { prototypes: Some(5), seed: Some(3), ..Default::default() };
    let config = of_method(Method::GaussianShader, caller);
    assert_eq!((config.prototypes, config.seed, config.bounces), (5, 3, 0));
    let alone = of_method(Method::GaussianShader, TrainOverrides::default());
    assert_eq!(alone.prototypes, 1, "the control");
    let forced = [
        ComplexitySetting::Visibility,
        ComplexitySetting::Indirect,
        ComplexitySetting::Sheen,
        ComplexitySetting::Prototypes,
    ];
    assert_eq!(alone.forced, forced);
}

#[test]
fn files_without_a_method_mean_relume() {
    let json = serde_json::to_value(TrainConfig::preset(Preset::Draft)).unwrap();
    assert!(json.get("method").is_none());
    assert_eq!(serde_json::from_value::<TrainConfig>(json).unwrap().method, Method::Relume);
    let other = TrainOverrides { method: Some(Method::GsIr), ..Default::default() };
    let json = serde_json::to_value(TrainConfig::new(Preset::Draft, &other).unwrap()).unwrap();
    assert_eq!(json["method"], "gs-ir", "the control");
    let unknown = serde_json::from_str::<TrainOverrides>(r#"{"method": "nerf"}"#).unwrap_err();
    assert!(unknown.to_string().contains("gaussian-shader"), "{unknown}");
}

#[test]
fn partial_group_overrides_keep_the_method_settings() {
    let read = |json: &str| serde_json::from_str::<TrainOverrides>(json).unwrap();
    let weights = |json: &str| TrainConfig::new(Preset::Draft, &read(json)).unwrap().weights;
    let ours = LossWeights::default();
    let alone = weights(r#"{"method": "3dgs"}"#);
    assert_eq!((alone.depth_normal, alone.flatness), (0.0, 0.0));
    let changed = weights(r#"{"method": "3dgs", "weights": {"smoothness": 0.02}}"#);
    assert_eq!(changed, LossWeights { smoothness: 0.02, ..alone });
    let own = weights(r#"{"weights": {"smoothness": 0.02}}"#);
    assert_eq!(own, LossWeights { smoothness: 0.02, ..ours }, "the control: our method has these terms");
    let shading = |json: &str| TrainConfig::new(Preset::Draft, &read(json)).unwrap().shading;
    let article = shading(r#"{"method": "article"}"#);
    let changed = shading(r#"{"method": "article", "shading": {"low_pass": 0.1}}"#);
    assert_eq!(changed, ShadingOptions { low_pass: 0.1, ..article });
    assert_ne!(article, ShadingOptions::default(), "the control");
}

#[test]
fn complete_groups_of_stored_jobs_are_read() {
    let whole = serde_json::to_value(LossWeights { l1: 0.5, ..Default::default() }).unwrap();
    let overrides: TrainOverrides = serde_json::from_value(serde_json::json!({ "weights": whole })).unwrap();
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    assert_eq!(config.weights, LossWeights { l1: 0.5, ..Default::default() });
}

#[test]
fn a_time_budget_is_bounded_and_excludes_iterations() {
    let refused = |json: &str| {
        let overrides: TrainOverrides = serde_json::from_str(json).unwrap();
        TrainConfig::new(Preset::Draft, &overrides).map_err(|error| error.to_string())
    };
    for seconds in [29, 604_801] {
        let error = refused(&format!(r#"{{"time_budget_s": {seconds}}}"#)).unwrap_err();
        assert_eq!(error, format!("time_budget_s: {seconds} is outside 30 to 604800"));
    }
    let both = refused(r#"{"time_budget_s": 60, "iterations": 100}"#).unwrap_err();
    assert!(both.starts_with("iterations: must not be combined with time_budget_s"), "{both}");
    let planned =
        refused(r#"{"time_budget_s": 60, "resolution": 200, "until": "novel_view.psnr>=30"}"#).unwrap();
    assert_eq!((planned.time_budget_s, planned.resolution), (Some(60), 200));
    let colour = refused(r#"{"method": "3dgs", "until": "novel_view.psnr>=30"}"#).unwrap_err();
    assert!(colour.starts_with("until: requires materials"), "{colour}");
}

#[test]
fn a_config_without_a_budget_has_no_fields_of_it() {
    let json = serde_json::to_string(&TrainConfig::preset(Preset::Draft)).unwrap();
    assert!(!json.contains("time_budget_s") && !json.contains("\"until\""), "{json}");
    let overrides = serde_json::to_string(&TrainOverrides::default()).unwrap();
    assert!(!overrides.contains("time_budget_s") && !overrides.contains("\"until\""), "{overrides}");
    let given = TrainOverrides { time_budget_s: Some(60), ..Default::default() };
    assert!(serde_json::to_string(&given).unwrap().contains("time_budget_s"), "the control");
}
