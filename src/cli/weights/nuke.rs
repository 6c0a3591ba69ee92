//! Weights as nodes of Nuke: one `Read`, then for each part `Shuffle` and `Multiply`, and `Merge2` nodes that add them.

use std::fmt::Write as _;

use crate::cli::weights::{PartWeight, PartWeights, one_line};

/// Greatest number of channels of a script of Nuke.
const MOST_CHANNELS: usize = 1023;
/// Channels that every script has: red, green, blue, alpha, depth, forward and backward motion, mask.
const USUAL_CHANNELS: usize = 12;

/// A script that Nuke imports, or pastes from the clipboard, for a matrix with images of this width and height.
///
/// # Errors
/// If the matrix has more channels than Nuke accepts.
pub(super) fn script(weights: &PartWeights, (width, height): (u32, u32)) -> Result<String, String> {
    let most = (MOST_CHANNELS - USUAL_CHANNELS) / 3;
    if weights.parts.len() > most {
        return Err(format!(
            "--format nuke: the matrix has {} parts, and Nuke reads at most {most} layers of three channels; render fewer lobes",
            weights.parts.len()
        ));
    }
    let mut out = String::new();
    let _ = writeln!(
        out,
        "# {} for {}, relume weights",
        one_line(&weights.environment),
        one_line(&weights.matrix)
    );
    for PartWeight { part, .. } in &weights.parts {
        let _ = writeln!(out, "add_layer {{{part} {part}.red {part}.green {part}.blue}}");
    }
    let _ = write!(
        out,
        "Read {{\n inputs 0\n file_type exr\n file \"{}\"\n format \"{width} {height} 0 0 {width} {height} 1 \"\n raw true\n name LightMatrix\n}}\n\
         set LightMatrix [stack 0]\n",
        quoted(&weights.matrix)
    );
    for (index, PartWeight { part, rgb: [r, g, b] }) in weights.parts.iter().enumerate() {
        // The first part also carries the coverage, so that the sum has it once.
        let (again, alpha) = if index == 0 { ("", "alpha2") } else { ("push $LightMatrix\n", "black") };
        let _ = write!(
            out,
            "{again}Shuffle {{\n in {part}\n in2 rgba\n alpha {alpha}\n name Part_{part}\n}}\n\
             Multiply {{\n channels rgb\n value {{{r} {g} {b} 1}}\n name Weight_{part}\n}}\n"
        );
        if index > 0 {
            let _ = write!(out, "Merge2 {{\n inputs 2\n operation plus\n name Sum_{part}\n}}\n");
        }
    }
    Ok(out)
}

/// `path` inside quotes of a script, with forward slashes.
fn quoted(path: &str) -> String {
    let mut out = String::new();
    for c in one_line(path).replace('\\', "/").chars() {
        if matches!(c, '"' | '[' | ']' | '$') {
            out.push('\\');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights(count: usize) -> PartWeights {
        let part = |k: usize| PartWeight { part: format!("lobe{k:03}"), rgb: [0.5 * k as f32, 1.0, 1e-7] };
        PartWeights {
            matrix: "shots/a [1] $x.exr".to_owned(),
            environment: "sky.hdr".to_owned(),
            rotation_deg: 0.0,
            exposure_ev: 0.0,
            parts: (0..count).map(part).collect(),
        }
    }

    const SIZE: (u32, u32) = (640, 480);

    /// The nodes of a script in order, with the number of nodes on the stack after each, as Nuke reads it.
    fn nodes(script: &str) -> Vec<(String, i32)> {
        let (mut stack, mut found, mut inputs) = (0, Vec::new(), 1);
        let mut class = None;
        for line in script.lines() {
            match line {
                _ if line.starts_with("push ") => stack += 1,
                "}" => {
                    stack += 1 - inputs;
                    found.extend(class.take().map(|class| (class, stack)));
                }
                _ if line.ends_with(" {") => (class, inputs) = (Some(line[..line.len() - 2].to_owned()), 1),
                _ if line.starts_with(" inputs ") => inputs = line[8..].parse().unwrap(),
                _ => {}
            }
        }
        found
    }

    #[test]
    fn the_script_adds_every_part_once() {
        let script = script(&weights(3), SIZE).unwrap();
        let found = nodes(&script);
        let classes: Vec<&str> = found.iter().map(|(class, _)| class.as_str()).collect();
        let expected =
            ["Read", "Shuffle", "Multiply", "Shuffle", "Multiply", "Merge2", "Shuffle", "Multiply", "Merge2"];
        assert_eq!(classes, expected);
        assert!(found.iter().all(|(_, stack)| (1..=2).contains(stack)), "{found:?}");
        assert_eq!(found.last().unwrap().1, 1, "one result");
        assert_eq!(script.matches("alpha alpha2").count(), 1);
        assert!(script.contains(" value {0.5 1 0.0000001 1}\n"), "{script}");
        assert!(script.contains("file \"shots/a \\[1\\] \\$x.exr\""), "{script}");
        assert!(script.contains("add_layer {lobe002 lobe002.red lobe002.green lobe002.blue}\n"));
    }

    #[test]
    fn more_layers_than_nuke_reads_are_refused() {
        assert!(script(&weights(337), SIZE).is_ok(), "the control");
        assert!(script(&weights(338), SIZE).unwrap_err().starts_with("--format nuke: "));
    }
}
