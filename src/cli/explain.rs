//! `relume explain`: prints the model card as text.

use std::path::PathBuf;

use serde_json::Value;

use crate::cli::args::name_of;
use crate::cli::error::CommandResult;
use crate::cli::input;
use relume_capture::formats::model_file;
use relume_scene::{Model, VisibilityForm};

/// Options of `relume explain`.
#[derive(Debug, clap::Args)]
pub(super) struct ExplainArgs {
    /// The model file.
    model: PathBuf,
}

pub(super) fn run(args: &ExplainArgs) -> CommandResult {
    let model = input::read_model(&args.model)?;
    for line in explain(&model, std::fs::metadata(&args.model)?.len()) {
        println!("{line}");
    }
    Ok(())
}

/// The text of a string, or the JSON of any other value.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn explain(model: &Model, bytes: u64) -> Vec<String> {
    let (g, card) = (&model.gaussians, &model.card);
    let text = |key: &str| card.get(key).filter(|v| !v.is_null()).map_or("unknown".to_owned(), plain);
    let floats = model_file::floats_a_gaussian(model);
    let mut out = vec![
        format!("{} Gaussians of {floats} floats each, {:.1} kB in total", g.len(), bytes as f64 / 1e3),
        shading(model),
        format!("environment of {} x {} texels", model.env_width, model.env_height),
    ];
    if let Some(from) = card.pointer("/imported/from") {
        let what = if model.has_materials() { "materials" } else { "colour alone" };
        out.push(format!("imported from {}: {what}", plain(from)));
        return out;
    }
    out.extend([
        format!(
            "trained by relume {} on engine {} for {} steps on {} photographs",
            text("relume_version"),
            text("engine"),
            text("steps"),
            text("photographs")
        ),
        match card.get("training_seconds").and_then(Value::as_f64) {
            Some(seconds) => format!("training took {seconds:.0} s"),
            None => "the training time is not in the card".to_owned(),
        },
    ]);
    out.extend(light(card));
    out.extend(chart(card));
    out.extend(exposures(card));
    out.extend(crop(card));
    let decisions = findings(card);
    let mode = card.pointer("/complexity/mode").map_or("unknown".to_owned(), plain);
    out.push(format!("\ncomplexity {mode}: {} decisions{}", decisions.len(), saving(card)));
    out.extend(decisions.into_iter().map(|d| format!("  {d}")));
    out.push("\nconfiguration".to_owned());
    for (key, value) in card.get("config").and_then(Value::as_object).into_iter().flatten() {
        out.push(format!("  {key}: {}", plain(value)));
    }
    out
}

/// The size of the Gaussians beside their size with all parts; empty without a difference, and for older models.
fn saving(card: &Value) -> String {
    let bytes = |name: &str| card.pointer(name).and_then(Value::as_f64);
    match (bytes("/complexity/bytes"), bytes("/complexity/bytes_full")) {
        (Some(now), Some(full)) if now > 0.0 && full > now => {
            format!(", {:.2} MB instead of {:.2} MB with all parts", now / 1e6, full / 1e6)
        }
        _ => String::new(),
    }
}

/// The albedo prototypes and the form of the shading, with the names of the API.
fn shading(model: &Model) -> String {
    let (g, options) = (&model.gaussians, &model.shading);
    let visibility = match options.visibility {
        VisibilityForm::Off => name_of(VisibilityForm::Off),
        form => format!("{}, SH degree {}", name_of(form), g.visibility_degree()),
    };
    format!(
        "{} albedo prototypes; visibility: {visibility}; radiance: SH degree {}; indirect light: {}",
        g.prototypes(),
        g.radiance_degree(),
        name_of(options.indirect)
    )
}

/// The numbers of a list, with two decimals.
fn numbers(list: Option<&Value>) -> String {
    let numbers = list.and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_f64);
    numbers.map(|v| format!("{v:.2}")).collect::<Vec<_>>().join(", ")
}

/// The light of the photographs, according to the card.
fn light(card: &Value) -> Vec<String> {
    let Some(light) = card.get("light") else { return Vec::new() };
    let from = match light.get("colour_from").and_then(Value::as_str) {
        Some("light") => "of the known light",
        Some("white_balance") => "from the given white balance",
        _ => "estimated from how colours change with the view, to about 20 % in blue over red",
    };
    let mut out = vec![format!("light of colour {} at the start, {from}", numbers(light.get("colour")))];
    let around = light.pointer("/surroundings/shown_share").and_then(Value::as_f64);
    out.extend(around.map(|share| {
        format!("the light is that of the surroundings; the photographs show {:.0} % of them", 100.0 * share)
    }));
    let groups =
        light.get("groups").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
    let groups: Vec<&str> = groups.map(|name| if name.is_empty() { "(no group)" } else { name }).collect();
    if let [first, ..] = groups[..] {
        out.push(format!(
            "{} light groups, each with a light: {}; `recovered` is that of {first}",
            groups.len(),
            groups.join(", ")
        ));
    }
    for found in light.get("lights").and_then(Value::as_array).into_iter().flatten() {
        let radius = found.get("radius_deg").and_then(Value::as_f64).unwrap_or_default();
        let evidence = match found.get("sharp_over_soft_shadows").and_then(Value::as_f64) {
            Some(gain) => {
                format!("sharp shadows explain colours {:.0} % better than soft ones", 100.0 * gain)
            }
            None if around.is_some() => "a source that the photographs show".to_owned(),
            None => "in the given environment map".to_owned(),
        };
        let towards = numbers(found.get("direction"));
        out.push(format!("dominant light towards {towards}, radius {radius:.1} degrees; {evidence}"));
    }
    out.extend(card.get("calibration").map(|calibration| {
        if let Some(error) = calibration.get("error") {
            return format!("not calibrated: {}", plain(error));
        }
        let scale = numbers(calibration.get("scale"));
        if let Some(chart) = calibration.get("chart") {
            let number = |path: &str| chart.pointer(path).map_or("unknown".to_owned(), |value| rounded(value, 1));
            return format!(
                "calibrated: albedo multiplied and light divided by {scale}, for {} neutral patches of the colour chart; mean CIEDE2000 of \
                 the albedo in {} patches {} before, {} after",
                number("/neutral_patches"),
                number("/patches"),
                number("/before/mean"),
                number("/after/mean")
            );
        }
        let reflectance = numbers(calibration.get("reflectance"));
        format!("calibrated: albedo multiplied and light divided by {scale}, for a surface of reflectance {reflectance}")
    }));
    out
}

/// A number with at most this many decimals; whole numbers without.
fn rounded(value: &Value, decimals: usize) -> String {
    match value.as_f64() {
        Some(number) if !value.is_u64() => format!("{number:.decimals$}"),
        _ => plain(value),
    }
}

/// The colour chart in the photographs, according to the card.
fn chart(card: &Value) -> Option<String> {
    let chart = card.get("colour_chart").filter(|chart| !chart.is_null())?;
    let at = |path: &str| chart.pointer(path).map_or("unknown".to_owned(), |value| rounded(value, 1));
    Some(format!(
        "the colours of all photographs were corrected with the colour chart in {}: mean CIEDE2000 of {} patches {} with exposure alone, {} \
         with the matrix",
        at("/photo"),
        at("/patches"),
        at("/delta_e_2000/before/mean"),
        at("/delta_e_2000/after/mean")
    ))
}

/// The exposures of the photographs, according to the card.
fn exposures(card: &Value) -> Option<String> {
    let spread = card.pointer("/exposures/spread")?;
    let percent = |key: &str| 100.0 * spread.get(key).and_then(Value::as_f64).unwrap_or_default();
    Some(format!(
        "standard deviation of the exposures {:.0} %, of red over green {:.0} %, of blue over green {:.0} %; the photographs were normalised to the mean",
        percent("green"),
        percent("red_over_green"),
        percent("blue_over_green")
    ))
}

/// The crop of the photographs, according to the card.
fn crop(card: &Value) -> Option<String> {
    let ball = card.pointer("/crop/ball")?;
    let ground = card.pointer("/crop/is_on_ground").and_then(Value::as_bool).unwrap_or_default();
    let part = if ground { "the object on the ground in " } else { "" };
    Some(format!("cropped to {part}the ball (x, y, z, radius) {}", numbers(Some(ball))))
}

/// The decisions in the card, one line each.
pub(super) fn findings(card: &Value) -> Vec<String> {
    let all = card.pointer("/complexity/findings").and_then(Value::as_array);
    all.into_iter().flatten().map(sentence).collect()
}

fn sentence(finding: &Value) -> String {
    let text = |key: &str| finding.get(key).map_or(String::new(), plain);
    let (setting, step, was, is) = (text("setting"), text("step"), text("was"), text("is"));
    if finding.get("forced").and_then(Value::as_bool) == Some(true) {
        return format!("{setting}: {is}, as requested (step {step})");
    }
    let change = if was == is { format!("stays {is}") } else { format!("{was} -> {is}") };
    let evidence = finding.get("evidence").and_then(Value::as_object);
    let figures: Vec<String> =
        evidence.into_iter().flatten().map(|(name, v)| format!("{} {v}", name.replace('_', " "))).collect();
    format!("{setting}: {change} at step {step}; {}", figures.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{Gaussians, IndirectForm};

    #[test]
    fn forms_of_shading_have_the_names_of_the_api() {
        let mut model = Model::new(Gaussians::zeroed(2, 1, 4, 1), vec![[0.0; 3]], vec![[0.0; 3]; 2], (2, 1));
        model.shading.visibility = VisibilityForm::Sigmoid;
        model.shading.indirect = IndirectForm::Gathered;
        assert_eq!(
            shading(&model),
            "1 albedo prototypes; visibility: sigmoid, SH degree 4; radiance: SH degree 1; indirect light: gathered"
        );
        (model.shading.visibility, model.shading.indirect) = (VisibilityForm::Off, IndirectForm::Off);
        assert!(shading(&model).contains("visibility: off; radiance"), "{}", shading(&model));
    }

    #[test]
    fn the_light_is_printed_with_its_evidence() {
        let card = serde_json::json!({"light": {
            "colour": [1.0, 1.02, 0.98], "colour_from": "view_dependence",
            "lights": [{"direction": [0.0, 0.6, 0.8], "radius_deg": 0.3, "sharp_over_soft_shadows": 0.35}],
        }});
        let printed = light(&card);
        assert!(printed[0].starts_with("light of colour 1.00, 1.02, 0.98 at the start, estimated"));
        assert_eq!(
            printed[1],
            "dominant light towards 0.00, 0.60, 0.80, radius 0.3 degrees; sharp shadows explain colours 35 % better \
             than soft ones"
        );
        let groups = serde_json::json!({"light": {"groups": ["", "evening"]}});
        assert!(light(&groups)[1].starts_with("2 light groups, each with a light: (no group), evening;"));
        assert!(light(&Value::Null).is_empty(), "cards without light print nothing");
    }

    #[test]
    fn a_colour_chart_is_printed_with_its_errors() {
        let errors = |mean: f64| serde_json::json!({ "mean": mean, "max": 2.0 * mean });
        let card = serde_json::json!({
            "colour_chart": {
                "photo": "a.jpg", "patches": 23, "delta_e_2000": { "before": errors(8.26), "after": errors(1.84) },
            },
            "light": { "colour": [1, 1, 1] },
            "calibration": { "scale": [1.5, 1.25, 1.0], "chart": {
                "neutral_patches": 5, "patches": 20, "before": errors(12.0), "after": errors(3.06),
            }},
        });
        let printed = chart(&card).unwrap();
        assert!(
            printed.contains("chart in a.jpg: mean CIEDE2000 of 23 patches 8.3 with exposure alone, 1.8"),
            "{printed}"
        );
        let calibrated = light(&card).pop().unwrap();
        assert!(calibrated.contains("divided by 1.50, 1.25, 1.00, for 5 neutral patches"), "{calibrated}");
        assert!(calibrated.contains("in 20 patches 12.0 before, 3.1 after"), "{calibrated}");
        assert_eq!(chart(&serde_json::json!({ "colour_chart": null })), None, "the control");
    }

    #[test]
    fn a_crop_is_printed_with_its_bounding_sphere() {
        let printed = |ground: bool| {
            crop(&serde_json::json!({"crop": {"ball": [1.0, -2.0, 0.5, 3.25], "is_on_ground": ground}}))
                .unwrap()
        };
        assert_eq!(printed(false), "cropped to the ball (x, y, z, radius) 1.00, -2.00, 0.50, 3.25");
        assert!(printed(true).contains("the object on the ground in the ball"));
        assert_eq!(crop(&serde_json::json!({"crop": null})), None);
    }

    #[test]
    fn a_decision_is_printed_with_its_evidence() {
        let card = serde_json::json!({"complexity": {"mode": "auto", "findings": [
            {"setting": "visibility", "step": 9, "was": "degree 4", "is": "off", "forced": false,
             "evidence": {"ao_error_off": 0.01}},
            {"setting": "radiance", "step": 9, "was": "degree 1", "is": "degree 1", "forced": true, "evidence": {}},
        ]}});
        let printed = findings(&card);
        assert_eq!(printed[0], "visibility: degree 4 -> off at step 9; ao error off 0.01");
        assert_eq!(printed[1], "radiance: degree 1, as requested (step 9)");
        assert!(findings(&Value::Null).is_empty(), "a card without decisions has none");
        let saved =
            |full: u32| saving(&serde_json::json!({"complexity": {"bytes": 1_500_000, "bytes_full": full}}));
        assert_eq!(saved(2_000_000), ", 1.50 MB instead of 2.00 MB with all parts");
        assert_eq!((saved(1_500_000), saving(&Value::Null)), (String::new(), String::new()), "the controls");
    }
}
