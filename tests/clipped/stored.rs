//! Clips in build files that do not make sense.

use layerd::buildfile::{Blend, BodySettings, Keeps, Placement, WriteError, Writer, WriterSettings};

#[test]
fn a_clip_follows_a_lattice() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let lattice = || BodySettings::Lattice { blend: Blend::Union, largest_radius: 9 };
    let clip = || BodySettings::Clip { keeps: Keeps::Inside };
    for bodies in [vec![clip()], vec![BodySettings::Surface, clip()], vec![lattice(), clip(), clip()]] {
        let settings = WriterSettings {
            quantum_um: 1.0,
            placement: Placement::Centred,
            source_digest: [0; 32],
            source_name: String::new(),
            bodies,
        };
        let error = Writer::create(&directory.path().join("no.layerd"), settings).err().expect("is refused");
        assert!(matches!(&error, WriteError::Refused { problem, .. } if problem.contains("is a clip, but")), "{error}");
    }
}
