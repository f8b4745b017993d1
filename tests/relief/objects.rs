//! Meshes with texture coordinates, as OBJ.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use glam::DVec3;

/// Triangles with a place, texture coordinates and maybe a normal at each corner.
#[derive(Clone, Default)]
pub(crate) struct Object {
    pub(crate) triangles: Vec<[Corner; 3]>,
}

#[derive(Clone, Copy)]
pub(crate) struct Corner {
    pub(crate) at: DVec3,
    pub(crate) texture: [f64; 2],
    pub(crate) normal: Option<DVec3>,
}

impl Object {
    /// The text of an OBJ file.
    pub(crate) fn obj(&self) -> String {
        let mut text = String::new();
        for (number, corners) in self.triangles.iter().enumerate() {
            let mut face = "f".to_owned();
            for (place, Corner { at, texture: [u, v], normal }) in corners.iter().enumerate() {
                let number = 3 * number + place + 1;
                writeln!(text, "v {} {} {}\nvt {u} {v}", at.x, at.y, at.z).expect("a string");
                write!(face, " {number}/{number}").expect("a string");
                if let Some(normal) = normal {
                    writeln!(text, "vn {} {} {}", normal.x, normal.y, normal.z).expect("a string");
                    write!(face, "/{number}").expect("a string");
                }
            }
            writeln!(text, "{face}").expect("a string");
        }
        text
    }

    /// Each triangle as four, `times` times.
    pub(crate) fn divided(mut self, times: u32) -> Self {
        let between = |a: &Corner, b: &Corner| Corner {
            at: (a.at + b.at) / 2.0,
            texture: [0, 1].map(|axis| (a.texture[axis] + b.texture[axis]) / 2.0),
            normal: a.normal.zip(b.normal).map(|(a, b)| (a + b).normalize()),
        };
        for _ in 0..times {
            let fourth = |[a, b, c]: &[Corner; 3]| {
                let [ab, bc, ca] = [between(a, b), between(b, c), between(c, a)];
                [[*a, ab, ca], [ab, *b, bc], [ca, bc, *c], [ab, bc, ca]]
            };
            self.triangles = self.triangles.iter().flat_map(fourth).collect();
        }
        self
    }

    /// Moves every corner.
    pub(crate) fn mapped(mut self, place: impl Fn(&Corner) -> DVec3) -> Self {
        self.triangles.iter_mut().flatten().for_each(|corner| corner.at = place(corner));
        self
    }

    /// Without normals.
    pub(crate) fn without_normals(mut self) -> Self {
        self.triangles.iter_mut().flatten().for_each(|corner| corner.normal = None);
        self
    }
}

/// A box of 12 triangles from 0 to `size`, each side with the whole map.
pub(crate) fn cuboid(size: [f64; 3]) -> Object {
    let corner =
        |number: usize| DVec3::from([0, 1, 2].map(|axis| if number >> axis & 1 == 1 { size[axis] } else { 0.0 }));
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let textures = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let triangles = sides.iter().flat_map(|side| {
        let corners =
            [0, 1, 2, 3].map(|place| Corner { at: corner(side[place]), texture: textures[place], normal: None });
        [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
    });
    Object { triangles: triangles.collect() }
}

/// A ball around 0 of rings and columns, with its normals. Texture coordinates are longitude and latitude.
pub(crate) fn ball(radius: f64, rings: u32, columns: u32) -> Object {
    let corner = |ring: u32, column: u32| {
        let (u, v) = (f64::from(column) / f64::from(columns), f64::from(ring) / f64::from(rings));
        let normal = direction([u, v]);
        Corner { at: normal * radius, texture: [u, v], normal: Some(normal) }
    };
    let mut triangles = Vec::new();
    for (ring, column) in (0..rings).flat_map(|ring| (0..columns).map(move |column| (ring, column))) {
        let [a, b] = [corner(ring, column), corner(ring, column + 1)];
        let [c, d] = [corner(ring + 1, column + 1), corner(ring + 1, column)];
        // At the poles, two of the corners are one.
        if ring > 0 {
            triangles.push([a, b, c]);
        }
        if ring + 1 < rings {
            triangles.push([a, c, d]);
        }
    }
    Object { triangles }
}

/// A surface that closes along both of its directions, with its normals and the whole map. `at` takes two angles; `counts` are the pieces of
/// both.
pub(crate) fn closed(counts: [u32; 2], at: impl Fn(f64, f64) -> DVec3) -> Object {
    let corner = |along: u32, over: u32| {
        let texture = [(along, counts[0]), (over, counts[1])].map(|(at, count)| f64::from(at) / f64::from(count));
        let [s, t] = texture.map(|share| TAU * share);
        let step = 1e-5;
        let normal = (at(s + step, t) - at(s - step, t)).cross(at(s, t + step) - at(s, t - step)).normalize();
        Corner { at: at(s % TAU, t % TAU), texture, normal: Some(normal) }
    };
    let places = (0..counts[0]).flat_map(|along| (0..counts[1]).map(move |over| (along, over)));
    let triangles = places.flat_map(|(along, over)| {
        let [a, b] = [corner(along, over), corner(along + 1, over)];
        let [c, d] = [corner(along + 1, over + 1), corner(along, over + 1)];
        [[a, b, c], [a, c, d]]
    });
    Object { triangles: triangles.collect() }
}

/// A torus around z.
pub(crate) fn torus(large: f64, small: f64, counts: [u32; 2]) -> Object {
    closed(counts, |s, t| DVec3::new(s.cos(), s.sin(), 0.0) * (large + small * t.cos()) + DVec3::Z * (small * t.sin()))
}

/// A ball around 0 of 80 triangles, with its normals: an icosahedron whose triangles are divided once.
pub(crate) fn ball_of_80(radius: f64) -> Object {
    let golden = f64::midpoint(1.0, 5.0_f64.sqrt());
    let signs = [[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]];
    let points: Vec<DVec3> = signs
        .iter()
        .map(|[x, y]| DVec3::new(*x, y * golden, 0.0))
        .flat_map(|point| [point, DVec3::new(point.z, point.x, point.y), DVec3::new(point.y, point.z, point.x)])
        .collect();
    let is_side = |a: DVec3, b: DVec3| a.distance(b) < 2.0 + 1e-9;
    let mut triangles = Vec::new();
    for (a, b, c) in (0..12).flat_map(|a| (0..a).flat_map(move |b| (0..b).map(move |c| (a, b, c)))) {
        let [a, b, c] = [points[a], points[b], points[c]];
        if is_side(a, b) && is_side(b, c) && is_side(c, a) {
            let is_outward = (b - a).cross(c - a).dot(a) > 0.0;
            let corner = |at: DVec3| Corner { at, texture: [0.0; 2], normal: None };
            triangles.push(if is_outward { [a, b, c] } else { [a, c, b] }.map(corner));
        }
    }
    let mut object = Object { triangles }.divided(1);
    assert_eq!(object.triangles.len(), 80);
    for corner in object.triangles.iter_mut().flatten() {
        let normal = corner.at.normalize();
        (corner.at, corner.normal) = (normal * radius, Some(normal));
    }
    object
}

/// The direction of a longitude and a latitude, both from 0 to 1.
pub(crate) fn direction([u, v]: [f64; 2]) -> DVec3 {
    let (azimuth, polar) = (u * TAU, v * PI);
    // Exact where all meridians meet and where they begin anew.
    let across = if v == 0.0 || v == 1.0 { 0.0 } else { polar.sin() };
    let (sin, cos) = if u == 1.0 { (0.0, 1.0) } else { azimuth.sin_cos() };
    DVec3::new(across * cos, across * sin, -polar.cos())
}

/// The longitude and latitude of a direction, from 0 to 1.
pub(crate) fn place(direction: DVec3) -> [f64; 2] {
    let u = (direction.y.atan2(direction.x) / TAU).rem_euclid(1.0);
    let v = (-direction.z / direction.length().max(1e-12)).acos() / PI;
    [u, v]
}
