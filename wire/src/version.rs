//! Versions of the protocol, and how host and device agree on one: see [`VersionRange::highest_common`].

use core::fmt;

/// The versions that this implementation speaks.
pub const VERSIONS: VersionRange = VersionRange { lowest: 1, highest: 1 };

/// The versions that one end speaks: all from the lowest to the highest. If `lowest` is above `highest`, it speaks none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VersionRange {
    /// The lowest version.
    pub lowest: u16,
    /// The highest version.
    pub highest: u16,
}

impl VersionRange {
    /// The highest version that both ends speak; `None` if there is none.
    ///
    /// ```
    /// use layerd_wire::VersionRange;
    ///
    /// let host = VersionRange { lowest: 2, highest: 4 };
    /// assert_eq!(host.highest_common(VersionRange { lowest: 1, highest: 3 }), Some(3));
    /// assert_eq!(host.highest_common(VersionRange { lowest: 5, highest: 6 }), None);
    /// ```
    #[must_use]
    pub fn highest_common(self, other: Self) -> Option<u16> {
        let highest = self.highest.min(other.highest);
        (highest >= self.lowest.max(other.lowest)).then_some(highest)
    }

    /// Whether this end speaks no version at all.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.lowest > self.highest
    }

    /// Whether this end speaks the version.
    #[must_use]
    pub fn contains(self, version: u16) -> bool {
        (self.lowest..=self.highest).contains(&version)
    }
}

impl fmt::Display for VersionRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { lowest, highest } = self;
        if lowest == highest { write!(f, "version {lowest}") } else { write!(f, "versions {lowest} to {highest}") }
    }
}
