//! Choice of the channels of an OpenEXR file that are its colour.
//!
//! A channel `LAYER.R` belongs to a layer; the channels of a part without a layer have bare names. A part may also be
//! named after a layer. RGB is preferred to luminance, whichever part comes first.

use std::collections::BTreeMap;

use exr::meta::header::Header;

use crate::formats::ImageFileError;

/// Names of the layer with the final colour in files with several layers, lower case. Blender writes
/// `ViewLayer.Combined.R`; other renderers and compositors write the others.
const MAIN_LAYERS: [&str; 7] = ["combined", "beauty", "rgba", "rgb", "color", "colour", "main"];
/// Greatest number of channels that an error lists.
const MAX_LISTED: usize = 24;
/// Greatest number of letters of a channel's name in an error.
const MAX_NAME: usize = 40;

/// Places of the colour in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ColourChannels {
    /// Index of the part.
    pub part: usize,
    /// Indices of the channels of red, green and blue in the part; equal for luminance.
    pub rgb: [usize; 3],
    /// Index of the channel of alpha.
    pub alpha: Option<usize>,
}

/// The channels of one layer in one part, by their lower-case suffix.
type LayerChannels = BTreeMap<String, usize>;

/// Part and name of a layer; the name is empty for bare channels.
type LayerKey = (usize, String);

/// Finds the colour in the parts of a file: bare RGB, else the RGB of the only layer that has it or of the layer named
/// as the final colour, else bare luminance `Y`.
///
/// # Errors
/// [`ImageFileError::Unsupported`] lists the channels if there is no colour or several layers could be meant, and names
/// luminance with chroma and CIE XYZ, which are not supported.
pub(super) fn find(headers: &[Header]) -> Result<ColourChannels, ImageFileError> {
    let layers = layers(headers);
    let coloured: Vec<_> = layers.iter().filter_map(|(key, layer)| Some((key, rgb(layer)?))).collect();
    let is_main = |key: &LayerKey| MAIN_LAYERS.contains(&last_name(&full_name(headers, key)).as_str());
    let is_bare = |key: &LayerKey| key.1.is_empty();
    let chosen = coloured
        .iter()
        .find(|(key, _)| is_bare(key) && is_main(key))
        .or_else(|| coloured.iter().find(|(key, _)| is_bare(key)))
        .or_else(|| coloured.iter().find(|(key, _)| is_main(key)))
        .or(if coloured.len() == 1 { coloured.first() } else { None });
    if let Some((key, rgb)) = chosen {
        return Ok(ColourChannels { part: key.0, rgb: *rgb, alpha: layers[*key].get("a").copied() });
    }
    if !coloured.is_empty() {
        let names: Vec<String> =
            coloured.iter().map(|(key, _)| shortened(&full_name(headers, key))).collect();
        return Err(ImageFileError::Unsupported(format!(
            "has several layers of colour ({}); keep one, or name the right one `beauty`",
            listed(&names)
        )));
    }
    luminance(&layers).ok_or_else(|| ImageFileError::Unsupported(without_colour(headers, &layers)))
}

fn layers(headers: &[Header]) -> BTreeMap<LayerKey, LayerChannels> {
    let mut layers: BTreeMap<LayerKey, LayerChannels> = BTreeMap::new();
    for (part, header) in headers.iter().enumerate() {
        for (channel, description) in header.channels.list.iter().enumerate() {
            let name = description.name.to_string();
            let (layer, suffix) = name.rsplit_once('.').unwrap_or(("", name.as_str()));
            let suffix = match suffix.to_ascii_lowercase().as_str() {
                "red" => "r".to_owned(),
                "green" => "g".to_owned(),
                "blue" => "b".to_owned(),
                "alpha" => "a".to_owned(),
                other => other.to_owned(),
            };
            layers.entry((part, layer.to_owned())).or_default().entry(suffix).or_insert(channel);
        }
    }
    layers
}

fn rgb(layer: &LayerChannels) -> Option<[usize; 3]> {
    Some([*layer.get("r")?, *layer.get("g")?, *layer.get("b")?])
}

/// The first bare channel `Y` that stands for luminance alone.
fn luminance(layers: &BTreeMap<LayerKey, LayerChannels>) -> Option<ColourChannels> {
    let is_alone = |layer: &LayerChannels| {
        let has = |name: &str| layer.contains_key(name);
        // A depth Z may stand beside luminance.
        !(has("ry") || has("by") || has("x") && has("z"))
    };
    layers.iter().filter(|((_, name), layer)| name.is_empty() && is_alone(layer)).find_map(|(key, layer)| {
        let y = *layer.get("y")?;
        Some(ColourChannels { part: key.0, rgb: [y; 3], alpha: layer.get("a").copied() })
    })
}

/// The reason why a file has no colour that this reader supports.
fn without_colour(headers: &[Header], layers: &BTreeMap<LayerKey, LayerChannels>) -> String {
    let any_has = |names: &[&str]| layers.values().any(|layer| names.iter().all(|n| layer.contains_key(*n)));
    if any_has(&["y", "ry"]) || any_has(&["y", "by"]) {
        return "stores luminance and chroma (channels Y, RY, BY), which Relume does not read; save it as RGB".into();
    }
    let names = layers.iter().flat_map(|((part, layer), channels)| {
        let place = full_name(headers, &(*part, layer.clone()));
        let list = &headers[*part].channels.list;
        channels.values().map(move |channel| {
            let name = list[*channel].name.to_string();
            let own = name.rsplit('.').next().unwrap_or_default();
            shortened(&if place.is_empty() { own.to_owned() } else { format!("{place}.{own}") })
        })
    });
    let names = listed(&names.collect::<Vec<_>>());
    if any_has(&["x", "y", "z"]) {
        return format!(
            "has channels X, Y, Z (CIE XYZ, or positions) and no R, G, B (found: {names}); save it as RGB"
        );
    }
    format!("has no colour: no layer has channels R, G, B, and there is no luminance Y (found: {names})")
}

/// Name of the part and of the layer, joined by a dot.
fn full_name(headers: &[Header], (part, layer): &LayerKey) -> String {
    let part = headers.get(*part).and_then(|header| header.own_attributes.layer_name.as_ref());
    let part = part.map(ToString::to_string).unwrap_or_default();
    match (part.is_empty(), layer.is_empty()) {
        (true, _) => layer.clone(),
        (_, true) => part,
        _ if *layer == part => part,
        _ => format!("{part}.{layer}"),
    }
}

fn last_name(name: &str) -> String {
    name.rsplit('.').next().unwrap_or_default().to_ascii_lowercase()
}

fn shortened(name: &str) -> String {
    name.chars().take(MAX_NAME).collect()
}

/// The first names, and the number of the others.
fn listed(names: &[String]) -> String {
    let more = names.len().saturating_sub(MAX_LISTED);
    let shown = names[..names.len() - more].join(", ");
    if more == 0 { shown } else { format!("{shown} and {more} more") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{ChannelDescription, SampleType, Text};

    fn part(name: &str, channels: &[&str]) -> Header {
        let mut channels = channels.to_vec();
        channels.sort_unstable();
        let channel = |name: &&str| ChannelDescription::named(Text::from(*name), SampleType::F16);
        let mut header = Header::new(Text::from(name), (2, 1), channels.iter().map(channel).collect());
        if name.is_empty() {
            header.own_attributes.layer_name = None;
        }
        header
    }

    /// Part and names of the channels that are found.
    fn found(parts: &[(&str, &[&str])]) -> Result<(usize, String), String> {
        let headers: Vec<Header> = parts.iter().map(|(name, channels)| part(name, channels)).collect();
        let colour = find(&headers).map_err(|e| e.to_string())?;
        let name = |channel: usize| headers[colour.part].channels.list[channel].name.to_string();
        let channels = colour.rgb.into_iter().chain(colour.alpha).map(name).collect::<Vec<_>>();
        Ok((colour.part, channels.join(" ")))
    }

    fn at(part: usize, channels: &str) -> Result<(usize, String), String> {
        Ok((part, channels.to_owned()))
    }

    #[test]
    fn bare_rgb_is_found_before_layers_and_luminance() {
        assert_eq!(found(&[("", &["R", "G", "B", "A", "albedo.R"])]), at(0, "R G B A"));
        assert_eq!(found(&[("", &["r", "g", "b"])]), at(0, "r g b"));
        assert_eq!(found(&[("mask", &["Y"]), ("light", &["R", "G", "B"])]), at(1, "R G B"));
        assert_eq!(found(&[("depth", &["Z"]), ("mask", &["Y"])]), at(1, "Y Y Y"), "the control: luminance");
        let two: [(&str, &[&str]); 2] = [("albedo", &["R", "G", "B"]), ("beauty", &["R", "G", "B"])];
        assert_eq!(found(&two), at(1, "R G B"), "a part named as the final colour");
        assert_eq!(found(&[two[0], ("other", two[1].1)]), at(0, "R G B"), "the control: the first part");
    }

    #[test]
    fn the_one_layer_of_colour_or_the_final_one_is_found() {
        let beauty = ["sky.R", "sky.G", "sky.B", "sky.A", "depth.Z"];
        assert_eq!(found(&[("", &beauty)]), at(0, "sky.R sky.G sky.B sky.A"));
        let blender =
            ["V.DiffCol.R", "V.DiffCol.G", "V.DiffCol.B", "V.Combined.R", "V.Combined.G", "V.Combined.B"];
        assert_eq!(found(&[("", &blender)]), at(0, "V.Combined.R V.Combined.G V.Combined.B"));
    }

    #[test]
    fn files_without_one_colour_are_refused_with_their_channels() {
        let several = ["a.R", "a.G", "a.B", "b.R", "b.G", "b.B"];
        let refused = |parts: &[(&str, &[&str])]| found(parts).unwrap_err();
        assert!(refused(&[("", &several)]).contains("several layers of colour (a, b)"));
        assert!(refused(&[("data", &["Z", "N.X"])]).contains("found: data.Z, data.N.X"));
        assert!(refused(&[("", &["Y", "RY", "BY"])]).contains("luminance and chroma"));
        assert!(refused(&[("", &["X", "Y", "Z"])]).contains("CIE XYZ"));
        let many: Vec<String> = (0..40).map(|i| format!("c{i:02}.Q{}", "x".repeat(90))).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        let text = refused(&[("", &many)]);
        assert!(text.contains("and 16 more") && text.len() < 1500, "{text}");
    }
}
