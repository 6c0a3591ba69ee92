//! `relume explain`: the model card in words.

use std::path::PathBuf;

use serde_json::Value;

use crate::cli::CommandResult;
use crate::formats::model_file;
use crate::scene::Model;

/// Options of `relume explain`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The model file.
    model: PathBuf,
}

pub(super) fn run(args: &Args) -> CommandResult {
    let bytes = std::fs::read(&args.model)?;
    let model = model_file::decode(&bytes)?;
    for line in explain(&model, bytes.len()) {
        println!("{line}");
    }
    Ok(())
}

/// A string, or JSON as it stands.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn explain(model: &Model, bytes: usize) -> Vec<String> {
    let (g, card) = (&model.gaussians, &model.card);
    let said = |key: &str| card.get(key).filter(|v| !v.is_null()).map_or("unknown".to_owned(), plain);
    let floats = model_file::floats_a_gaussian(model);
    let mut out = vec![
        format!("{} Gaussians of {floats} floats each, {:.1} kB in all", g.len(), bytes as f64 / 1e3),
        format!(
            "{} albedo prototypes; visibility {:?} of degree {}; radiance of degree {}; indirect light {:?}",
            g.prototypes(),
            model.shading.visibility,
            g.visibility_order(),
            g.radiance_order(),
            model.shading.indirect
        ),
        format!("environment of {} x {} texels", model.env_width, model.env_height),
        format!(
            "trained by relume {} on engine {} for {} steps on {} photographs",
            said("relume_version"),
            said("engine"),
            said("steps"),
            said("photographs")
        ),
    ];
    out.push(match card.get("training_seconds").and_then(Value::as_f64) {
        Some(seconds) => format!("training took {seconds:.0} s"),
        None => "the training time is not in the card".to_owned(),
    });
    let decisions = findings(card);
    let mode = card.pointer("/complexity/mode").map_or("unknown".to_owned(), plain);
    out.push(format!("\ncomplexity {mode}: {} decisions", decisions.len()));
    out.extend(decisions.into_iter().map(|d| format!("  {d}")));
    out.push("\nconfiguration".to_owned());
    for (key, value) in card.get("config").and_then(Value::as_object).into_iter().flatten() {
        out.push(format!("  {key}: {}", plain(value)));
    }
    out
}

/// The card's decisions, a sentence each.
pub(super) fn findings(card: &Value) -> Vec<String> {
    let all = card.pointer("/complexity/findings").and_then(Value::as_array);
    all.into_iter().flatten().map(sentence).collect()
}

fn sentence(finding: &Value) -> String {
    let said = |key: &str| finding.get(key).map_or(String::new(), plain);
    let (setting, step, was, is) = (said("setting"), said("step"), said("was"), said("is"));
    if finding.get("forced").and_then(Value::as_bool) == Some(true) {
        return format!("{setting}: {is}, as was asked for (step {step})");
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

    #[test]
    fn a_decision_is_told_with_its_evidence() {
        let card = serde_json::json!({"complexity": {"mode": "auto", "findings": [
            {"setting": "visibility", "step": 9, "was": "degree 4", "is": "off", "forced": false,
             "evidence": {"ao_error_off": 0.01}},
            {"setting": "radiance", "step": 9, "was": "degree 1", "is": "degree 1", "forced": true, "evidence": {}},
        ]}});
        let told = findings(&card);
        assert_eq!(told[0], "visibility: degree 4 -> off at step 9; ao error off 0.01");
        assert_eq!(told[1], "radiance: degree 1, as was asked for (step 9)");
        assert!(findings(&Value::Null).is_empty(), "a card without decisions has none");
    }
}
