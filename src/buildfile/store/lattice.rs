//! Builds the header of a lattice from its struts as they are written. `writer` adds it to the header of the file.

use super::lowest::Lowest;
use super::nodes::NodeCounter;
use super::profile::ProfileBuilder;
use super::settings::smallest_lattice;
use crate::buildfile::materials::Shares;
use crate::buildfile::model::{Bounds, Joint, Lattice, Strut, node_key};

/// A lattice that is being written.
pub(super) struct LatticeBuilder {
    lattice: Lattice,
    largest_radius: u32,
    reach: i64,
    profile: ProfileBuilder,
    nodes: NodeCounter,
    lowest: Lowest,
    last: Option<Strut>,
}

impl LatticeBuilder {
    pub(super) fn new(joint: Joint, largest_radius: u32, quantum_um: f64) -> Self {
        let lattice = Lattice {
            joint,
            bounds: Bounds::EMPTY,
            radius_range: [u32::MAX, 0],
            strut_count: 0,
            ball_count: 0,
            node_count: 0,
            is_graded: false,
        };
        Self {
            lattice,
            largest_radius,
            reach: smallest_lattice(joint, largest_radius).reach_quanta(quantum_um),
            profile: ProfileBuilder::default(),
            nodes: NodeCounter::default(),
            lowest: Lowest::default(),
            last: None,
        }
    }

    /// Adds a strut.
    ///
    /// # Errors
    /// A text that says how the strut is out of order, not as [`Strut`] demands, or beyond ±2³¹ quanta. Then it is not added.
    pub(super) fn add(&mut self, strut: Strut) -> Result<(), String> {
        self.check(&strut)?;
        let Lattice { bounds, radius_range, strut_count, ball_count, is_graded, .. } = &mut self.lattice;
        *bounds = bounds.with(&strut).ok_or_else(|| format!("{strut:?} reaches beyond ±2³¹ quanta"))?;
        let [thinner, thicker] = [strut.radius_a.min(strut.radius_b), strut.radius_a.max(strut.radius_b)];
        *radius_range = [radius_range[0].min(thinner), radius_range[1].max(thicker)];
        *if strut.is_ball() { ball_count } else { strut_count } += 1;
        *is_graded |= strut.shares != Shares::default();
        self.profile.add(i64::from(strut.a[2]) - self.reach, i64::from(strut.b[2]) + self.reach);
        self.nodes.count(&strut);
        self.lowest.add(&strut);
        self.last = Some(strut);
        Ok(())
    }

    fn check(&self, strut: &Strut) -> Result<(), String> {
        let ends = [strut.a, strut.b].map(node_key);
        if ends[0] > ends[1] {
            return Err(format!("{strut:?}: its lower node must come first"));
        }
        if self.last.is_some_and(|last| [last.a, last.b].map(node_key) > ends) {
            return Err(format!("{strut:?} comes after a higher one"));
        }
        let radii = [strut.radius_a, strut.radius_b];
        if radii.iter().any(|&radius| radius == 0 || radius > self.largest_radius) {
            return Err(format!("{strut:?}: radii from 1 to {} quanta are allowed", self.largest_radius));
        }
        if strut.is_ball() && strut.radius_a != strut.radius_b {
            return Err(format!("{strut:?}: a ball has one radius"));
        }
        if strut.is_ball() && strut.shares.a != strut.shares.b {
            return Err(format!("{strut:?}: a ball has one share"));
        }
        Ok(())
    }

    /// The header of the struts added so far.
    pub(super) fn header(&self) -> Lattice {
        Lattice { node_count: self.nodes.total(), ..self.lattice.clone() }
    }

    /// Their profile.
    pub(super) fn profile(&self) -> &ProfileBuilder {
        &self.profile
    }

    /// Their lowest solid point, micrometres. Of a convolution this is the lower end of the bounds: the true point can only be found
    /// when the file can be read.
    pub(super) fn bottom_um(&self, quantum_um: f64) -> f64 {
        match self.lattice.joint {
            Joint::Union => self.lowest.um(quantum_um),
            Joint::Convolution { .. } | Joint::Elliptic { .. } => self.lattice.bounds.bottom_um(quantum_um),
        }
    }
}
