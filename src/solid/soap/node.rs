//! A node: its struts, whether there is a film between them, and the mesh of it. `benches/nodes.rs` and `tests/nodes/` make some.

use glam::DVec3;
use thiserror::Error;

use super::control::Control;
use super::fairing::{Fairing, Free};
use super::film::Film;
use super::level::{Level, curved_error};
use super::mesh::FilmMesh;
use super::subdivide::Subdivision;
use super::surface::Surface;
use super::voronoi::Voronoi;
use super::{cap, cut};

/// A strut as a node sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StrutEnd {
    /// From the node along the strut. Any length but 0; only the direction counts.
    pub direction: [f64; 3],
    /// From this node to the other one, in the unit of the radius.
    pub length: f64,
}

/// A node of a lattice whose struts all have the same radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node<'a> {
    /// The struts that end here. Their order changes no bit of the surface, only which circle is whose.
    pub ends: &'a [StrutEnd],
    /// Radius of all struts; any unit of length.
    pub radius: f64,
    /// λ, above 0 and below 0.5: struts are cut at 1 + λ times the distance where they meet (Luo & Zou 2025, Eq. 5).
    pub lambda: f64,
}

impl Node<'_> {
    /// The λ of Luo & Zou 2025, §4.1.
    pub const USUAL_LAMBDA: f64 = 0.3;

    /// Struts that are closer, in degrees, get no film. At this angle they are cut at 15 radii already, and the film between them is a web
    /// much longer than wide. 5 % of a strut's length is a usual radius, and such struts would need 30 radii.
    pub const LEAST_ANGLE_DEG: f64 = 10.0;

    /// More struts get no film: 64 directions cannot all be 30° apart, and every triple of them is tried. Real lattices have up to 41
    /// (Luo & Zou 2025, Table 2).
    pub const MAX_STRUTS: usize = 64;
}

/// Why a node has no film. It is to be drawn as the exact union of its struts.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NoFilm {
    /// Radius, λ, a length or a direction is not a number in its range.
    #[error("the node's {what} is {value}, which is out of range")]
    OutOfRange {
        /// What it is.
        what: &'static str,
        /// The value found.
        value: f64,
    },
    /// No strut ends here.
    #[error("no strut ends at the node")]
    NoStrut,
    /// Two struts that form a straight line, within 1°: they need no film.
    #[error("the node's two struts form a straight line")]
    Straight,
    /// More struts than [`Node::MAX_STRUTS`].
    #[error("{count} struts end at the node, and a film may have {limit}", limit = Node::MAX_STRUTS)]
    TooMany {
        /// Number of struts.
        count: usize,
    },
    /// Two struts are closer than [`Node::LEAST_ANGLE_DEG`].
    #[error("struts {} and {} of the node are closer than {limit}°", struts[0], struts[1], limit = Node::LEAST_ANGLE_DEG)]
    Close {
        /// Which, counted from 0.
        struts: [usize; 2],
    },
    /// The cut would lie beyond the middle of a strut, where the other node's film may begin.
    #[error("strut {of} would be cut at {cut}, which is not within half of its length {length}")]
    Short {
        /// Which strut, counted from 0.
        of: usize,
        /// Where it would be cut, from the node.
        cut: f64,
        /// Its length.
        length: f64,
    },
    /// The cells around the struts do not fit together: a Voronoi vertex reaches a circle, or rounding errors decide about neighbours.
    #[error("the cells around the node's struts do not fit together")]
    Degenerate,
}

/// What is known of a node before its mesh is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Where each strut is cut: the distance of its circle from the node, in the unit of the radius. The strut itself remains beyond.
    pub cuts: Vec<f64>,
    /// Least and greatest x, y and z that the mesh may reach at any level, from the node.
    pub bounds: [[f64; 3]; 2],
    radius: f64,
    /// Vertices, edges and triangles of the control mesh.
    counts: [usize; 3],
    rims: usize,
}

impl Outline {
    /// Numbers of vertices and triangles at a level.
    pub fn size(&self, level: Level) -> [usize; 2] {
        let [vertices, _, triangles] = (0..level.steps()).fold(self.counts, |[vertices, edges, triangles], _| {
            [vertices + edges, 2 * edges + 3 * triangles, 4 * triangles]
        });
        [vertices, triangles]
    }

    /// The coarsest level whose error is at most `tolerance`, a length in the unit of the radius; [`Level::FINEST_NEEDED`] if a finer one
    /// would be needed. A quarter of a pixel is a good tolerance.
    pub fn level(&self, tolerance: f64) -> Level {
        Level::for_tolerance(tolerance / self.radius, self.farthest_cut())
    }

    /// Bound of the distance between the flat triangles of a level and the limit surface, in the unit of the radius.
    pub fn error(&self, level: Level) -> f64 {
        level.error(self.farthest_cut()) * self.radius
    }

    /// Bound of the distance between the limit surface and level 0 drawn as PN triangles (Vlachos et al. 2001) with the normals of the
    /// mesh, in the unit of the radius: about that of level 1, for a quarter of the memory.
    pub fn curved_error(&self) -> f64 {
        curved_error(self.farthest_cut()) * self.radius
    }

    /// In radii.
    fn farthest_cut(&self) -> f64 {
        self.cuts.iter().copied().fold(0.0, f64::max) / self.radius
    }

    /// Bytes that a [`FilmMesh`] of a level holds.
    pub fn bytes(&self, level: Level) -> usize {
        let [vertices, triangles] = self.size(level);
        let rims = (self.rims << level.steps()) + self.cuts.len() + 1;
        2 * vertices * size_of::<[f64; 3]>() + triangles * size_of::<[u32; 3]>() + rims * size_of::<u32>()
    }
}

/// How far fairing and refining may lead a mesh out of the box around its control mesh, in radii. Measured: see `tests/nodes/`.
const SLACK: f64 = 0.2;

/// Makes the meshes of nodes. It keeps its buffers, which are about twice as large as the largest mesh that it made.
#[derive(Debug, Default)]
pub struct FilmBuilder {
    given: Vec<DVec3>,
    order: Vec<usize>,
    /// For each strut as given, which one it is in the order used here.
    places: Vec<usize>,
    voronoi: Voronoi,
    /// Directions of struts, then those of fans.
    axes: Vec<DVec3>,
    /// Of the struts, in radii.
    cuts: Vec<f64>,
    film: Film,
    control: Control,
    free: Free,
    fairing: Fairing,
    subdivision: Subdivision,
    /// The surface, and room for the next level.
    surfaces: [Surface; 2],
}

impl FilmBuilder {
    /// A builder with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Where the struts of a node are cut, and how large its mesh may be.
    ///
    /// # Errors
    ///
    /// The reason why there is no film.
    pub fn outline(&mut self, node: &Node<'_>) -> Result<Outline, NoFilm> {
        self.prepare(node)?;
        let points = &self.control.points;
        let least = points.iter().fold(DVec3::INFINITY, |least, point| least.min(*point)) - SLACK;
        let greatest = points.iter().fold(DVec3::NEG_INFINITY, |greatest, point| greatest.max(*point)) + SLACK;
        Ok(Outline {
            cuts: self.places.iter().map(|place| self.cuts[*place] * node.radius).collect(),
            bounds: [least, greatest].map(|corner| (corner * node.radius).to_array()),
            radius: node.radius,
            counts: self.control.counts(&self.film),
            rims: self.control.rim_length(),
        })
    }

    /// Fills `mesh` with the surface of a node. Once the buffers of both are large enough, nothing is allocated.
    ///
    /// # Errors
    ///
    /// The reason why there is no film; `mesh` is then unchanged.
    pub fn mesh(&mut self, node: &Node<'_>, level: Level, mesh: &mut FilmMesh) -> Result<(), NoFilm> {
        self.prepare(node)?;
        self.refine(node, level, true, mesh);
        Ok(())
    }

    /// As [`FilmBuilder::mesh`], without fairing: to see what it does, and what it takes.
    ///
    /// # Errors
    ///
    /// As [`FilmBuilder::mesh`].
    pub fn unfaired_mesh(&mut self, node: &Node<'_>, level: Level, mesh: &mut FilmMesh) -> Result<(), NoFilm> {
        self.prepare(node)?;
        self.refine(node, level, false, mesh);
        Ok(())
    }

    /// Makes the control mesh, before fairing.
    fn prepare(&mut self, node: &Node<'_>) -> Result<(), NoFilm> {
        check_numbers(node)?;
        self.given.clear();
        // Adding 0 makes −0 a 0, which is sorted elsewhere.
        self.given.extend(node.ends.iter().map(|end| {
            let direction = DVec3::from(end.direction);
            direction / direction.length() + 0.0
        }));
        cut::check_angles(&self.given)?;
        cut::sort(&self.given, &mut self.order);
        self.places.clear();
        self.places.resize(self.order.len(), 0);
        self.order.iter().enumerate().for_each(|(place, strut)| self.places[*strut] = place);
        self.axes.clear();
        self.cuts.clear();
        if let [axis] = self.given[..] {
            self.prepare_end(axis);
            return Ok(());
        }
        self.voronoi.fill(self.order.iter().map(|strut| self.given[*strut]));
        self.axes.extend(&self.voronoi.sites);
        self.cuts.extend((0..self.order.len()).map(|strut| cut::cut(&self.axes, strut, node.lambda)));
        for (of, end) in node.ends.iter().enumerate() {
            let cut = self.cuts[self.places[of]] * node.radius;
            if cut >= end.length / 2.0 {
                return Err(NoFilm::Short { of, cut, length: end.length });
            }
        }
        let fits = self.film.fill(&self.voronoi) && self.control.fill(&self.film, &self.axes, &self.cuts);
        if fits { Ok(()) } else { Err(NoFilm::Degenerate) }
    }

    /// The end of a single strut, cut at the node.
    fn prepare_end(&mut self, axis: DVec3) {
        self.axes.extend([axis, -axis]);
        self.cuts.push(0.0);
        cap::fill_film(axis, &mut self.film);
        self.control.fill(&self.film, &self.axes, &self.cuts);
        self.control.bend_over_end();
    }

    /// Refines the control mesh and hands it over.
    fn refine(&mut self, node: &Node<'_>, level: Level, fair: bool, mesh: &mut FilmMesh) {
        let [surface, next] = &mut self.surfaces;
        let straight = self.control.fill_surface(&self.film, surface);
        surface.count_neighbours();
        // Half a ball is fair, and its vertices stay on it.
        if node.ends.len() > 1 {
            if fair {
                self.control.fill_free(&mut self.free);
                self.fairing.fair(&mut surface.points, &surface.edges[..straight], &self.free);
            }
            surface.set_normals();
            self.control.set_radial_normals(&mut surface.normals);
        } else {
            surface.normals.extend(&surface.points);
        }
        let struts = self.cuts.len();
        for step in 1..=level.steps() {
            let joined = step < level.steps();
            self.subdivision.refine(surface, &self.axes[..struts], &self.cuts, joined, next);
            std::mem::swap(surface, next);
        }
        mesh.fill(surface, level, node.radius, &self.places);
    }
}

/// Refuses numbers that are none, and too many struts.
fn check_numbers(node: &Node<'_>) -> Result<(), NoFilm> {
    if node.ends.is_empty() {
        return Err(NoFilm::NoStrut);
    }
    if node.ends.len() > Node::MAX_STRUTS {
        return Err(NoFilm::TooMany { count: node.ends.len() });
    }
    let refuse = |what, value: f64, fits: bool| if fits { Ok(()) } else { Err(NoFilm::OutOfRange { what, value }) };
    refuse("radius", node.radius, node.radius.is_finite() && node.radius > 0.0)?;
    refuse("lambda", node.lambda, node.lambda > 0.0 && node.lambda < 0.5)?;
    for end in node.ends {
        let length = DVec3::from(end.direction).length();
        refuse("direction's length", length, length.is_normal())?;
        refuse("strut length", end.length, end.length.is_finite() && end.length > 0.0)?;
    }
    Ok(())
}
