//! Whatever a file holds: it is packed or refused, without a panic.

use proptest::prelude::*;

use crate::pack_bench::Bench;
use crate::ply::WAYS;
use crate::stl::binary;
use crate::{BOX, cuboid, obj, packed, ply, properties};

/// Files to damage: their name and bytes.
fn whole(number: usize) -> (&'static str, Vec<u8>) {
    match number {
        0 => ("a.stl", binary(b"", &cuboid(BOX.0, BOX.1))),
        1 => ("a.obj", obj::boxed().into_bytes()),
        way => ("a.ply", ply::boxed(WAYS[way - 2])),
    }
}

/// What damage writes: bytes that mean something, or any.
fn patch() -> impl Strategy<Value = Vec<u8>> {
    let words =
        ["-1", "4294967296", "/", " ", "\n", "nan", "1e999", "f ", "v ", "vn ", "element ", "uint8", "list ", "\\\n"];
    prop_oneof![
        proptest::sample::select(words.to_vec()).prop_map(|word| word.as_bytes().to_vec()),
        proptest::collection::vec(any::<u8>(), 0..5),
    ]
}

proptest! {
    #![proptest_config(properties::cases(400))]

    #[test]
    fn damaged_files_do_not_panic(
        number in 0..5_usize,
        damage in proptest::collection::vec((any::<proptest::sample::Index>(), 0..6_usize, patch()), 1..4),
    ) {
        let (name, mut bytes) = whole(number);
        for (at, removed, patch) in damage {
            let at = at.index(bytes.len() + 1);
            let end = (at + removed).min(bytes.len());
            bytes.splice(at..end, patch);
        }
        let bench = Bench::new();
        if let Err(error) = packed(&bench, &[bench.file(name, &bytes)]) {
            prop_assert!(error.to_string().contains(name), "{}", error);
        }
    }

    #[test]
    fn random_bytes_do_not_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400), of_ply in any::<bool>()) {
        let bench = Bench::new();
        let bytes = if of_ply { [b"ply\nformat ", &bytes[..]].concat() } else { bytes };
        for name in ["a.stl", "a.obj", "a.ply"] {
            let error = packed(&bench, &[bench.file(name, &bytes)]).expect_err("no mesh");
            prop_assert!(error.to_string().contains(name), "{}", error);
        }
    }
}
