//! Identifiers of materials as Cryptomatte stores them (Friedman and Jones, "Fully automatic ID mattes with support for motion blur and
//! transparency", SIGGRAPH 2015; version 1.2.0 of the specification).

use std::collections::HashSet;

/// Materials of a pixel.
pub(super) const RANKS: usize = 6;

/// Most materials of a model whose frames can name them. Each three of them cost a pass over the Gaussians.
pub(super) const MAX_MATERIALS: usize = 64;

/// Name of the layers without their number, and the start of its hash, which marks the attributes.
const NAME: &str = "CryptoMaterial";

/// Name of a material in the manifest.
fn name(material: usize) -> String {
    format!("material_{material}")
}

/// The identifier of a material as channels of a file have it.
pub(super) fn id(material: usize) -> f32 {
    f32::from_bits(hash_of_float(&name(material)))
}

/// Attributes of a file with these values of the output `cryptomatte`. The manifest has the materials that the frame shows.
pub(super) fn attributes(plane: &[f32]) -> [(&'static str, String); 4] {
    let shown: HashSet<u32> = plane.as_chunks::<2>().0.iter().map(|[id, _]| id.to_bits()).collect();
    let entry = |material: usize| {
        let (name, hash) = (name(material), id(material).to_bits());
        shown.contains(&hash).then(|| format!("\"{name}\":\"{hash:08x}\""))
    };
    let entries: Vec<String> = (0..MAX_MATERIALS).filter_map(entry).collect();
    [
        ("cryptomatte/be359d6/name", NAME.to_owned()),
        ("cryptomatte/be359d6/hash", "MurmurHash3_32".to_owned()),
        ("cryptomatte/be359d6/conversion", "uint32_to_float32".to_owned()),
        ("cryptomatte/be359d6/manifest", format!("{{{}}}", entries.join(","))),
    ]
}

/// The hash of a name, changed in one bit where its float would be denormal, infinite or not a number.
fn hash_of_float(name: &str) -> u32 {
    let hash = murmur3(name.as_bytes());
    match hash >> 23 & 255 {
        0 | 255 => hash ^ 1 << 23,
        _ => hash,
    }
}

/// MurmurHash3 (Appleby), 32 bits, seed 0.
fn murmur3(bytes: &[u8]) -> u32 {
    let mixed = |word: u32| word.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let (words, rest) = bytes.as_chunks::<4>();
    let mut hash = 0u32;
    for word in words {
        hash ^= mixed(u32::from_le_bytes(*word));
        hash = hash.rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    let last = rest.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
    hash ^= mixed(last) ^ bytes.len() as u32;
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_specification() {
        // The floats of the specification are 6.0705627e-17, -4.084619e15, 2.790186e15 and 3.6655762e-11.
        for (name, bits) in
            [("hello", 0x248b_fa47), ("cube", 0xd968_2f08), ("sphere", 0x591e_9a8d), ("plane", 0x2e21_36b8)]
        {
            assert_eq!(hash_of_float(name), bits, "{name}");
        }
        assert_ne!(hash_of_float("planes"), 0x2e21_36b8, "the control");
    }

    #[test]
    fn all_identifiers_are_normal_floats() {
        let is_normal = |hash: u32| f32::from_bits(hash).is_normal();
        assert!((0..4096).all(|i| is_normal(hash_of_float(&name(i)))));
        assert!((0..4096).any(|i| !is_normal(murmur3(name(i).as_bytes()))), "the control");
    }

    #[test]
    fn attributes_are_marked_by_the_hash_of_the_name() {
        let key = format!("{:08x}", murmur3(NAME.as_bytes()));
        let attributes = attributes(&[id(1), 0.75, id(7), 0.25, 0.0, 0.0]);
        assert!(attributes.iter().all(|(name, _)| name.split('/').nth(1) == Some(&key[..7])));
        let manifest: serde_json::Value = serde_json::from_str(&attributes[3].1).unwrap();
        let hash = |material| format!("{:08x}", id(material).to_bits());
        assert_eq!(manifest, serde_json::json!({ "material_1": hash(1), "material_7": hash(7) }));
    }
}
