//! `spot_lattice.txt` in memory. `benches/slice.rs` and `benches/spot_contours/` use it.

use std::path::{Path, PathBuf};

use layerd::buildfile::{BodyHeader, Bounds, Caps, Header, Joint, Lattice, Placement, Shares, Strut};
use layerd::slice::MemoryStruts;

/// Header and struts, with points moved by `place`; `None`, and a message, where the file is not there. A convolution has a support of 1.5
/// times the largest radius.
pub(crate) fn lattice(convolution: bool, place: impl Fn([i32; 3]) -> [i32; 3]) -> Option<(Header, MemoryStruts)> {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let directory = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from);
    let Ok(text) = std::fs::read_to_string(directory.join("spot_lattice.txt")) else {
        eprintln!("skipped: spot_lattice.txt is not there");
        return None;
    };
    let mut bounds = Bounds { min: [i32::MAX; 3], max: [i32::MIN; 3] };
    let mut radius_range = [u32::MAX, 0];
    let mut struts = Vec::new();
    for line in text.lines().skip(1) {
        let [x1, y1, z1, x2, y2, z2, r]: [i32; 7] = line
            .split_whitespace()
            .map(|word| (word.parse::<f64>().expect("a number") * 1000.0).round() as i32)
            .collect::<Vec<_>>()
            .try_into()
            .expect("seven numbers");
        let (mut a, mut b) = (place([x1, y1, z1]), place([x2, y2, z2]));
        if a[2] > b[2] {
            std::mem::swap(&mut a, &mut b);
        }
        for axis in 0..3 {
            bounds.min[axis] = bounds.min[axis].min(a[axis].min(b[axis]) - r);
            bounds.max[axis] = bounds.max[axis].max(a[axis].max(b[axis]) + r);
        }
        let radius = r.unsigned_abs();
        radius_range = [radius_range[0].min(radius), radius_range[1].max(radius)];
        struts.push(Strut {
            a,
            b,
            radius_a: radius,
            radius_b: radius,
            caps: Caps::default(),
            shares: Shares::default(),
        });
    }
    let support_um = 1.5 * f64::from(radius_range[1]);
    let lattice = Lattice {
        joint: if convolution { Joint::Convolution { support_um } } else { Joint::Union },
        bounds,
        radius_range,
        strut_count: struts.len() as u64,
        ball_count: 0,
        node_count: 0,
        is_graded: false,
    };
    let header = Header {
        materials: None,
        quantum_um: 1.0,
        bounds,
        bottom_um: f64::from(bounds.min[2]),
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: "spot_lattice.txt".into(),
        bodies: vec![BodyHeader::Lattice(lattice.clone())],
    };
    Some((header, MemoryStruts::new(1.0, lattice, struts, 8192)))
}
