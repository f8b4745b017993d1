//! How often a mesh is refined, and how far it then is from the limit. `benches/nodes.rs` and `tests/nodes/limit.rs` measure it.

/// How often a control mesh is refined. Each level has four times the triangles of the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Level(u8);

/// Distance of the control mesh from the limit, in radii. Measured: 0.06 on nodes without narrow angles.
const COARSEST_ERROR: f64 = 0.075;

/// What a level leaves of the error. It would be a quarter where all vertices have six neighbours. Beside one with nine, as where three
/// struts meet, Loop's scheme shrinks lengths to 0.57 and distances to a third, and at the tips of fans to 0.38.
const LEFT: f64 = 0.4;

/// Cut, in radii, up to which the error does not depend on it. Beyond it triangles are longer. 4 radii are an angle of 36°.
const SHORT_CUT: f64 = 4.0;

/// As [`COARSEST_ERROR`], if the triangles are drawn as PN triangles.
const CURVED_ERROR: f64 = 0.03;

impl Level {
    /// The control mesh itself.
    pub const COARSEST: Self = Self(0);

    /// The finest level that a tolerance chooses: some 200,000 triangles for 20 struts, 0.005 radii from the limit. Pixels are far larger.
    pub const FINEST_NEEDED: Self = Self(3);

    /// The finest level there is. In tests and measurements it stands for the limit.
    pub const FINEST: Self = Self(5);

    /// Level `steps`, from 0 to 5; none beyond.
    pub fn new(steps: u8) -> Option<Self> {
        (steps <= Self::FINEST.0).then_some(Self(steps))
    }

    /// How often the control mesh is refined, from 0 to 5.
    pub fn steps(self) -> u8 {
        self.0
    }

    /// The coarsest level that comes so close to the limit of a node that is cut at `cut`, in radii, as is `tolerance`.
    pub(super) fn for_tolerance(tolerance: f64, cut: f64) -> Self {
        let levels = (0..Self::FINEST_NEEDED.0).map(Self);
        levels.into_iter().find(|level| level.error(cut) <= tolerance).unwrap_or(Self::FINEST_NEEDED)
    }

    /// Bound of the distance between flat triangles and limit, in radii.
    pub(super) fn error(self, cut: f64) -> f64 {
        COARSEST_ERROR * LEFT.powi(i32::from(self.0)) * stretch(cut)
    }
}

/// Bound of the distance between limit and level 0 as PN triangles, in radii.
pub(super) fn curved_error(cut: f64) -> f64 {
    CURVED_ERROR * stretch(cut)
}

/// How much longer triangles are than those of a node without narrow angles.
fn stretch(cut: f64) -> f64 {
    (cut / SHORT_CUT).max(1.0)
}
