//! Random and changed bytes cause no panic.

use proptest::prelude::*;
use relume_fixtures::cases_or;

use crate::formats::splat_import::{compressed_ply, decode, splat_records, spz};
use crate::formats::{ply_model, splats};

/// A valid file of each kind.
fn seeds() -> Vec<Vec<u8>> {
    vec![
        ply_model::encode(&splats::tests::example()),
        compressed_ply::tests::example(true),
        splat_records::tests::example(),
        spz::tests::version_2(),
        spz::tests::version_4(),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases_or(300), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_splat_files_cause_no_panic(
        which in 0usize..5,
        changes in prop::collection::vec((any::<usize>(), any::<u8>()), 1..8),
        cut in prop::option::of(any::<usize>()),
    ) {
        let mut bytes = seeds()[which].clone();
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut % bytes.len());
        }
        if let Ok(import) = decode(&bytes) {
            prop_assert!(import.model.check().is_ok() && !import.model.gaussians.is_empty());
        }
    }

    #[test]
    fn random_bytes_after_a_signature_cause_no_panic(
        signature in prop::sample::select(vec![&b""[..], b"ply\n", b"NGSP\x03\0\0\0", b"NGSP\x04\0\0\0", b"\x1f\x8b"]),
        noise in prop::collection::vec(any::<u8>(), 0..2000),
    ) {
        let _ = decode(&[signature, &noise].concat());
    }
}
