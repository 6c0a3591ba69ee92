//! Weights as tools of Fusion: a `Loader` for each part, and `Custom` tools that multiply and add them.

use std::fmt::Write as _;

use crate::cli::weights::{PartWeight, PartWeights, one_line};
use relume_capture::formats::exr_matrix::ALPHA;

/// A channel name that no file has.
const NONE: &str = "SomethingThatWontMatchHopefully";

/// Tools that can be pasted into the flow of Fusion, or saved as a `.setting` file.
pub(super) fn tools(weights: &PartWeights) -> String {
    let mut out = "{\n\tTools = ordered() {\n".to_owned();
    loader(&mut out, &weights.matrix, ALPHA, [NONE, NONE, NONE, "A"], 0);
    for (index, PartWeight { part, rgb }) in weights.parts.iter().enumerate() {
        let channels = ["R", "G", "B"].map(|suffix| format!("{part}.{suffix}"));
        let [red, green, blue] = channels.each_ref().map(String::as_str);
        loader(&mut out, &weights.matrix, part, [red, green, blue, NONE], index + 1);
        // The first sum takes its alpha from the coverage, and every other one from the sum before it.
        let before = match index.checked_sub(1).and_then(|before| weights.parts.get(before)) {
            None => format!("Part_{ALPHA}"),
            Some(before) => format!("Sum_{}", before.part),
        };
        let _ = write!(
            out,
            "\t\tSum_{part} = Custom {{\n\t\t\tInputs = {{\n\
             \t\t\t\tImage1 = Input {{ SourceOp = \"Part_{part}\", Source = \"Output\" }},\n\
             \t\t\t\tImage2 = Input {{ SourceOp = \"{before}\", Source = \"Output\" }},\n"
        );
        for ((channel, letter), weight) in [("Red", 'r'), ("Green", 'g'), ("Blue", 'b')].into_iter().zip(rgb)
        {
            let sum = if index == 0 { String::new() } else { format!("+{letter}2") };
            let _ = writeln!(
                out,
                "\t\t\t\t{channel}Expression = Input {{ Value = \"{letter}1*{weight}{sum}\" }},"
            );
        }
        let _ = write!(
            out,
            "\t\t\t\tAlphaExpression = Input {{ Value = \"a2\" }}\n\t\t\t}},\n\
             \t\t\tViewInfo = OperatorInfo {{ Pos = {{ 220, {} }} }}\n\t\t}},\n",
            33 * (index + 1)
        );
    }
    out + "\t}\n}\n"
}

/// Adds a `Loader` of a part with its red, green, blue and alpha channel.
fn loader(out: &mut String, file: &str, part: &str, channels: [&str; 4], row: usize) {
    let _ = write!(
        out,
        "\t\tPart_{part} = Loader {{\n\
         \t\t\tClips = {{ Clip {{ ID = \"Clip1\", Filename = \"{}\", FormatID = \"OpenEXRFormat\", StartFrame = -1, LengthSetManually = true, TrimIn = 0, TrimOut = 0, ExtendFirst = 0, ExtendLast = 0, Loop = 0, AspectMode = 0, Depth = 0, TimeCode = 0, GlobalStart = 0, GlobalEnd = 0 }} }},\n\
         \t\t\tInputs = {{\n\t\t\t\t[\"Clip1.OpenEXRFormat.Part\"] = Input {{ Value = FuID {{ \"{part}\" }} }},\n",
        quoted(file)
    );
    for (channel, name) in ["Red", "Green", "Blue", "Alpha"].into_iter().zip(channels) {
        let _ = writeln!(
            out,
            "\t\t\t\t[\"Clip1.OpenEXRFormat.{channel}Name\"] = Input {{ Value = FuID {{ \"{name}\" }} }},"
        );
    }
    let _ =
        write!(out, "\t\t\t}},\n\t\t\tViewInfo = OperatorInfo {{ Pos = {{ 0, {} }} }}\n\t\t}},\n", 33 * row);
}

/// `path` inside quotes of Lua.
fn quoted(path: &str) -> String {
    one_line(path).replace('\\', "\\\\").replace('"', "\\\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights(matrix: &str) -> PartWeights {
        let part = |k: usize| PartWeight { part: format!("lobe{k:03}"), rgb: [0.5 * k as f32, 1.0, 1e-7] };
        PartWeights {
            matrix: matrix.to_owned(),
            environment: "sky.hdr".to_owned(),
            rotation_deg: 0.0,
            exposure_ev: 0.0,
            parts: (0..3).map(part).collect(),
        }
    }

    #[test]
    fn the_tools_of_fusion_add_every_part_once() {
        let text = tools(&weights("shots\\a \"1\".exr"));
        assert_eq!((text.matches(" = Loader {").count(), text.matches(" = Custom {").count()), (4, 3));
        for part in ["alpha", "lobe000", "lobe001", "lobe002"] {
            assert_eq!(text.matches(&format!("SourceOp = \"Part_{part}\"")).count(), 1, "{part}");
        }
        for sum in ["lobe000", "lobe001"] {
            assert_eq!(text.matches(&format!("SourceOp = \"Sum_{sum}\"")).count(), 1, "{sum}");
        }
        assert!(!text.contains("SourceOp = \"Sum_lobe002\""), "the result");
        assert!(text.contains("BlueExpression = Input { Value = \"b1*0.0000001\" }"), "{text}");
        assert!(text.contains("RedExpression = Input { Value = \"r1*0.5+r2\" }"), "{text}");
        assert!(text.contains("Filename = \"shots\\\\a \\\"1\\\".exr\""), "{text}");
        assert_eq!(text.matches('{').count(), text.matches('}').count());
    }
}
