//! The control mesh: rows of vertices along each strut, from the circle where it is cut to the film, and fans over gaps (Luo & Zou 2025,
//! §3.3.1 and §3.3.2, Fig. 6 and 8). `fairing` smooths it and `subdivide` refines it.

use glam::DVec3;

use super::fairing::Free;
use super::film::{Film, lifted};
use super::surface::{Edge, Surface, Triangle};
use super::{across, cap, unit_or};

/// Rows of a strut's own vertices: the circle, and three more at quarters of the way to the film. The film is the row behind them.
pub(super) const ROWS: usize = 4;

/// The vertices of a strut's rows that have one azimuth, and the film's vertex there.
#[derive(Clone, Copy, Debug)]
struct Column {
    /// Vertex of the film.
    film: u32,
    /// The next column of the strut, counter-clockwise as seen from outside.
    next: u32,
    /// Segment of the film from this column to the next one.
    segment: u32,
    /// Away from the strut's axis; a unit vector.
    radial: DVec3,
}

/// One step around a fan over a gap.
#[derive(Clone, Copy, Debug)]
struct Spoke {
    /// Vertex of the film where it begins.
    film: u32,
    /// The next spoke around the same tip.
    next: u32,
    /// Segment of the film from this spoke to the next one.
    segment: u32,
    /// Which fan.
    tip: u32,
}

/// Vertices are numbered row by row, beginning with the circles; those of the film, the middles of spokes and the tips of fans follow.
#[derive(Debug, Default)]
pub(super) struct Control {
    /// Of all struts, one after the other.
    columns: Vec<Column>,
    /// The first column of each strut, and the number of all.
    starts: Vec<u32>,
    /// Of all fans, one after the other.
    spokes: Vec<Spoke>,
    /// For each vertex of the film, how many struts it lies between.
    struts_beside: Vec<u32>,
    tips: usize,
    /// Where the vertices lie, in radii from the node.
    pub(super) points: Vec<DVec3>,
}

impl Control {
    /// Fills it for struts along the first cells' `axes`, cut at `cuts`; the other cells become fans. False if the rows would cross.
    pub(super) fn fill(&mut self, film: &Film, axes: &[DVec3], cuts: &[f64]) -> bool {
        self.columns.clear();
        self.starts.clear();
        for (strut, axis) in axes[..cuts.len()].iter().enumerate() {
            let first = self.columns.len() as u32;
            self.starts.push(first);
            let border = film.border(strut);
            let count = border.len() as u32;
            self.columns.extend((0..count).zip(border).map(|(at, step)| Column {
                film: step.vertex,
                next: first + (at + 1) % count,
                segment: step.segment,
                radial: unit_or(across(film.points[step.vertex as usize], *axis), axis.any_orthonormal_vector()),
            }));
        }
        self.starts.push(self.columns.len() as u32);
        self.struts_beside.clear();
        self.struts_beside.resize(film.points.len(), 0);
        self.columns.iter().for_each(|column| self.struts_beside[column.film as usize] += 1);
        self.tips = axes.len() - cuts.len();
        self.spokes.clear();
        for tip in 0..self.tips {
            let first = self.spokes.len() as u32;
            let border = film.border(cuts.len() + tip);
            let count = border.len() as u32;
            self.spokes.extend((0..count).zip(border).map(|(at, step)| Spoke {
                film: step.vertex,
                next: first + (at + 1) % count,
                segment: step.segment,
                tip: tip as u32,
            }));
        }
        self.place(film, axes, cuts)
    }

    /// Puts the vertices where they lie before fairing; false if a strut's rows would cross.
    fn place(&mut self, film: &Film, axes: &[DVec3], cuts: &[f64]) -> bool {
        self.points.clear();
        let mut fits = true;
        for row in 0..ROWS {
            // The share of the way from the film.
            let share = 1.0 - row as f64 / ROWS as f64;
            for (strut, cut) in cuts.iter().enumerate() {
                for column in &self.columns[self.starts[strut] as usize..self.starts[strut + 1] as usize] {
                    let foot = film.points[column.film as usize].dot(axes[strut]);
                    let turns_on =
                        column.radial.cross(self.columns[column.next as usize].radial).dot(axes[strut]) > 0.0;
                    fits &= foot < *cut && turns_on;
                    self.points.push(axes[strut] * (foot + (cut - foot) * share) + column.radial);
                }
            }
        }
        self.points.extend(&film.points);
        let (struts, ghosts) = axes.split_at(cuts.len());
        self.points.extend(self.spokes.iter().map(|spoke| {
            let ghost = ghosts[spoke.tip as usize];
            lifted(unit_or(unit_or(film.points[spoke.film as usize], ghost) + ghost, ghost), struts)
        }));
        self.points.extend(ghosts.iter().map(|ghost| lifted(*ghost, struts)));
        fits
    }

    /// Moves the rows between circle and film onto the ball, for the end of a single strut.
    pub(super) fn bend_over_end(&mut self) {
        let count = self.columns.len();
        for row in 1..ROWS {
            for at in 0..count {
                let [circle, film] = [self.points[at], self.points[self.vertex(ROWS, at) as usize]];
                self.points[row * count + at] = cap::on_ball(circle, film, row as f64 / ROWS as f64);
            }
        }
    }

    /// The first vertex of the film.
    fn first_film(&self) -> usize {
        ROWS * self.columns.len()
    }

    /// The first middle of a spoke.
    fn first_middle(&self) -> usize {
        self.first_film() + self.struts_beside.len()
    }

    /// The first tip of a fan.
    fn first_tip(&self) -> usize {
        self.first_middle() + self.spokes.len()
    }

    /// Numbers of vertices, edges and triangles.
    pub(super) fn counts(&self, film: &Film) -> [usize; 3] {
        let (columns, spokes) = (self.columns.len(), self.spokes.len());
        let edges = 3 * ROWS * columns + film.segments.len() + 4 * spokes;
        [self.points.len(), edges, 2 * ROWS * columns + 3 * spokes]
    }

    /// The edges of the mesh without diagonals, then the diagonals; the second number tells how many of them come first.
    fn add_edges(&self, film: &Film, edges: &mut Vec<Edge>) -> usize {
        let quads = || (0..ROWS).flat_map(|row| (0..self.columns.len()).map(move |column| (row, column)));
        let next = |column: usize| self.columns[column].next as usize;
        let (films, middles, tips) = (self.first_film() as u32, self.first_middle() as u32, self.first_tip() as u32);
        let spokes = || (0..).zip(&self.spokes);
        edges.extend(quads().map(|(row, column)| Edge::new(self.vertex(row, column), self.vertex(row, next(column)))));
        edges.extend(quads().map(|(row, column)| Edge::new(self.vertex(row + 1, column), self.vertex(row, column))));
        edges.extend(film.segments.iter().map(|[from, to]| Edge::new(films + from, films + to)));
        edges.extend(spokes().map(|(at, spoke)| Edge::new(films + spoke.film, middles + at)));
        edges.extend(spokes().map(|(at, spoke)| Edge::new(middles + at, middles + spoke.next)));
        edges.extend(spokes().map(|(at, spoke)| Edge::new(middles + at, tips + spoke.tip)));
        let straight = edges.len();
        edges.extend(
            quads().map(|(row, column)| Edge::new(self.vertex(row + 1, column), self.vertex(row, next(column)))),
        );
        edges.extend(self.spokes.iter().map(|spoke| Edge::new(films + spoke.film, middles + spoke.next)));
        straight
    }

    /// The vertex of a column in a row, or in the film behind all rows.
    fn vertex(&self, row: usize, column: usize) -> u32 {
        let number = if row < ROWS {
            row * self.columns.len() + column
        } else {
            self.first_film() + self.columns[column].film as usize
        };
        number as u32
    }

    /// Makes it a surface to be refined, and returns how many edges come before the diagonals. Quads are divided by the same diagonal all
    /// the way round, so that almost all vertices have six neighbours.
    pub(super) fn fill_surface(&self, film: &Film, surface: &mut Surface) -> usize {
        surface.clear();
        surface.points.extend(&self.points);
        let straight = self.add_edges(film, &mut surface.edges);
        let count = self.columns.len() as u32;
        // Numbers of edges, in the order of `add_edges`.
        let (across, segments, diagonals) = (ROWS as u32 * count, 2 * ROWS as u32 * count, straight as u32);
        for row in 0..ROWS {
            for (at, column) in self.columns.iter().enumerate() {
                let (next, own) = (column.next as usize, (row * self.columns.len() + at) as u32);
                let along_next = if row + 1 < ROWS { own + count } else { segments + column.segment };
                let corners = [self.vertex(row + 1, at), self.vertex(row + 1, next), self.vertex(row, next)];
                let sides = [along_next, across + (row * self.columns.len() + next) as u32, diagonals + own];
                surface.triangles.push(Triangle { corners, sides });
                let corners = [self.vertex(row + 1, at), self.vertex(row, next), self.vertex(row, at)];
                surface.triangles.push(Triangle { corners, sides: [diagonals + own, own, across + own] });
            }
        }
        self.add_fans(segments, film.segments.len() as u32, diagonals + across, &mut surface.triangles);
        surface.rim_starts.extend(&self.starts);
        surface.rim_edges.extend(0..count);
        surface.rim_vertices.extend(0..count);
        surface.join();
        straight
    }

    /// Adds the triangles of the fans: from the film to the middles of the spokes, and to the tips. Edges of the film begin with
    /// `segments`, diagonals of fans with `diagonals`.
    fn add_fans(&self, segments: u32, segment_count: u32, diagonals: u32, triangles: &mut Vec<Triangle>) {
        let count = self.spokes.len() as u32;
        let (films, middles, tips) = (self.first_film() as u32, self.first_middle() as u32, self.first_tip() as u32);
        let outer = segments + segment_count;
        let (around, inner) = (outer + count, outer + 2 * count);
        for (at, spoke) in (0..).zip(&self.spokes) {
            let next = spoke.next;
            let [film, next_film] = [spoke.film, self.spokes[next as usize].film].map(|vertex| films + vertex);
            let corners = [film, next_film, middles + next];
            triangles.push(Triangle { corners, sides: [segments + spoke.segment, outer + next, diagonals + at] });
            let corners = [film, middles + next, middles + at];
            triangles.push(Triangle { corners, sides: [diagonals + at, around + at, outer + at] });
            let corners = [middles + at, middles + next, tips + spoke.tip];
            triangles.push(Triangle { corners, sides: [around + at, inner + next, inner + at] });
        }
    }

    /// Tells which vertices fairing moves: the last row and all behind it. Circle and the row beside it let the film leave the strut
    /// smoothly, and with the third row held as well it leaves along the axis.
    pub(super) fn fill_free(&self, free: &mut Free) {
        let count = self.columns.len();
        free.first = (ROWS - 1) * count;
        free.beside = (ROWS - 2) * count;
        let is_creased = |film: u32| self.struts_beside[film as usize] > 1;
        free.creased.clear();
        free.creased.extend(self.columns.iter().map(|column| is_creased(column.film)));
        free.creased.extend((0..self.struts_beside.len() as u32).map(is_creased));
        free.creased.resize(self.points.len() - free.first, false);
    }

    /// How many vertices all circles have.
    pub(super) fn rim_length(&self) -> usize {
        self.columns.len()
    }

    /// Sets the normals of the rows where the film leaves the strut, the circle and the one beside it: away from the axis.
    pub(super) fn set_radial_normals(&self, normals: &mut [DVec3]) {
        let radial = self.columns.iter().chain(&self.columns).map(|column| column.radial);
        normals.iter_mut().zip(radial).for_each(|(normal, radial)| *normal = radial);
    }
}
