//! Displaced solids against their signed distance field, f = s·|p − x| − ϕ(x) with the point x of the base nearest to p (Brunton and Abu Rmaileh
//! 2021), in f64. Layers are drawn in another way, from facets and winding numbers. `--nocapture` shows histograms.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::DVec3;
use layerd::layer::Depth;

use crate::objects::{Corner, Object, ball, closed, cuboid, torus};
use crate::{PLAIN, Part, Recipe, lit, map, pixels, point_mm};

/// Pixels and layers: coarse, because each of them is compared.
const VOXEL_UM: [f64; 3] = [75.0, 65.0, 50.0];

/// A displacement, as a share of its height.
type Value = fn([f64; 2]) -> f64;

/// The triangles of a base, and which of them lie near each cell of a grid.
struct Base<'a> {
    triangles: &'a [[Corner; 3]],
    reach: f64,
    cells: HashMap<[i64; 3], Vec<usize>>,
}

impl<'a> Base<'a> {
    /// Triangles are found from points that are up to `reach` away.
    fn new(object: &'a Object, reach: f64) -> Self {
        let mut cells: HashMap<_, Vec<usize>> = HashMap::new();
        for (number, corners) in object.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|corner| corner.at);
            let [low, high] = [a.min(b).min(c) - reach, a.max(b).max(c) + reach].map(|at| cell(at, reach));
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        cells.entry([x, y, z]).or_default().push(number);
                    }
                }
            }
        }
        Self { triangles: &object.triangles, reach, cells }
    }

    /// The field at a point, positive outside; `None` if the base is farther away than the reach.
    fn field(&self, at: DVec3, height: f64, value: Value) -> Option<f64> {
        let near = self.cells.get(&cell(at, self.reach))?.iter().map(|number| {
            let corners = &self.triangles[*number];
            let shares = nearest(at, corners.map(|corner| corner.at));
            let mix = |part: &dyn Fn(&Corner) -> DVec3| (0..3).map(|i| part(&corners[i]) * shares[i]).sum::<DVec3>();
            let to = at - mix(&|corner| corner.at);
            let [a, b, c] = corners.map(|corner| corner.at);
            let above = to.dot((b - a).cross(c - a).normalize());
            let [u, v] = [0, 1].map(|axis| (0..3).map(|i| corners[i].texture[axis] * shares[i]).sum());
            (to.length(), above, [u, v])
        });
        // Of triangles that are equally near, at an edge, the one that is seen best knows the side.
        let best = near.reduce(|best, next| {
            let is_nearer = next.0 < best.0 - 1e-9 || next.0 < best.0 + 1e-9 && next.1.abs() > best.1.abs();
            if is_nearer { next } else { best }
        });
        let (distance, above, texture) = best.filter(|best| best.0 < self.reach)?;
        Some(distance.copysign(above) - height * value(texture))
    }
}

fn cell(at: DVec3, size: f64) -> [i64; 3] {
    (at / size).floor().to_array().map(|part| part as i64)
}

/// The point of a triangle nearest to `at`, as shares of the corners.
fn nearest(at: DVec3, corners: [DVec3; 3]) -> [f64; 3] {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let part = |p: DVec3, q: DVec3| (q - p).cross(at - p).dot(normal) / normal.length_squared();
    let inner = [part(b, c), part(c, a), part(a, b)];
    if inner.iter().all(|share| *share >= 0.0) {
        return inner;
    }
    let on_edge = |edge: usize| {
        let (from, to) = (edge, (edge + 1) % 3);
        let along = corners[to] - corners[from];
        let share = ((at - corners[from]).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        let mut shares = [0.0; 3];
        (shares[from], shares[to]) = (1.0 - share, share);
        (at.distance(corners[from] + along * share), shares)
    };
    let edges = [0, 1, 2].map(on_edge);
    edges.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(inner, |(_, shares)| shares)
}

/// Waves that vanish along the edges of the map.
fn waves([u, v]: [f64; 2]) -> f64 {
    (PI * u).sin().powi(2) * (PI * v).sin().powi(2) * (0.5 + 0.5 * (2.0 * TAU * u).cos() * (TAU * v).sin())
}

/// Waves that go on around.
fn ripples([u, v]: [f64; 2]) -> f64 {
    0.5 + 0.5 * (6.0 * TAU * u).sin() * (2.0 * TAU * v).cos()
}

#[test]
fn layers_agree_with_the_field_on_five_parts() {
    // A ring that is thicker in some places, and waves up and down.
    let snake = |s: f64, t: f64| {
        let outward = DVec3::new(s.cos(), s.sin(), 0.0);
        let radius = 0.45 + 0.12 * (3.0 * s).sin();
        outward * (1.5 + radius * t.cos()) + DVec3::Z * (radius * t.sin() + 0.25 * (2.0 * s).cos())
    };
    let mut inner = ball(1.0, 30, 60);
    inner.triangles.iter_mut().for_each(|corners| {
        corners.swap(1, 2);
        corners.iter_mut().for_each(|corner| corner.normal = corner.normal.map(|normal| -normal));
    });
    let mut hollow = ball(1.6, 40, 80);
    hollow.triangles.append(&mut inner.triangles);
    let parts: [(&str, Object, Value); 5] = [
        ("ball", ball(1.7, 40, 80), waves),
        ("hollow ball", hollow, waves),
        ("box", cuboid([2.3, 1.9, 1.4]), waves),
        ("torus", torus(1.5, 0.5, [120, 90]), ripples),
        ("snake", closed([150, 90], snake), ripples),
    ];
    for (name, object, value) in parts {
        compare(name, &object, value);
    }
}

/// Compares the layers of an object, displaced by six layers at most, with its field.
fn compare(name: &str, object: &Object, value: Value) {
    let height_mm = 6.0 * VOXEL_UM[2] / 1000.0;
    let texels = map([1024, 1024], value);
    let part = Part::new(object, &Recipe { map: Some(&texels), height_mm, ..PLAIN });
    let plan = part.plan_of(Depth::Bit, [VOXEL_UM[0], VOXEL_UM[1]], VOXEL_UM[2]);
    let voxel_mm = VOXEL_UM.into_iter().fold(f64::MAX, f64::min) / 1000.0;
    let base = Base::new(object, 1.2 * height_mm);
    // Upper ends of the bars, voxels.
    let ends = [0.01, 0.02, 0.05, 0.1, 0.2, f64::INFINITY];
    let mut bars = [0_u32; 6];
    let (mut near_count, mut squares) = (0_u32, 0.0);
    let layers = part.layers(&plan, 2, 0);
    let is_lit = |x: u32, y: u32, layer: usize| layers.get(layer).is_some_and(|bitmap| lit(bitmap, x, y));
    for (number, bitmap) in layers.iter().enumerate() {
        for (x, y) in pixels(&plan) {
            // Pixels at the border of the drawn layers, and an eighth of all others: the field takes long.
            let around = [
                (x + 1, y, number),
                (x.saturating_sub(1), y, number),
                (x, y + 1, number),
                (x, y.saturating_sub(1), number),
            ];
            let beside = around.into_iter().chain([(x, y, number + 1), (x, y, number.wrapping_sub(1))]);
            let is_in = |x: u32, y: u32| x < plan.raster.width_px && y < plan.raster.height_px;
            let mut others = beside.map(|(x, y, layer)| is_in(x, y) && is_lit(x, y, layer));
            let is_at_border = others.any(|other| other != lit(bitmap, x, y));
            if !is_at_border && !(x as usize + 3 * y as usize + 5 * number).is_multiple_of(8) {
                continue;
            }
            let Some(field) = base.field(point_mm(&plan, x, y, number), height_mm, value) else { continue };
            let off = field.abs() / voxel_mm;
            near_count += u32::from(off < 0.5);
            if lit(bitmap, x, y) != (field <= 0.0) {
                squares += off * off;
                bars[ends.iter().position(|end| off < *end).unwrap_or(5)] += 1;
            }
        }
    }
    // A pixel is on the wrong side if it lies between both borders. The number of such pixels, divided by that of all pixels near the border,
    // is the distance of the two borders in voxels.
    let wrong: u32 = bars.iter().sum();
    let apart = f64::from(wrong) / f64::from(near_count);
    let rms = (squares / f64::from(wrong.max(1))).sqrt();
    println!(
        "{name}: {near_count} pixels within half a voxel of the border; on the other side of it, by up to 0.01, 0.02, 0.05, 0.1, 0.2 voxels and more: \
         {bars:?}, rms {rms:.3}; the borders are {apart:.4} voxels apart"
    );
    assert!(near_count > 3_000, "{name}: {near_count} pixels");
    assert!(apart < 0.03, "{name}: {apart} voxels apart");
    assert!(rms < 0.1, "{name}: rms {rms}");
    assert_eq!(bars[5], 0, "{name}: {bars:?}");
}
