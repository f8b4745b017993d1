//! The end of a single strut: half of the ball, with its circle at the node itself. `node` uses it instead of a film.

use glam::DVec3;

use super::film::Film;
use super::unit_or;

/// Columns around the strut, 22.5° apart, as wide as films usually have them.
const COLUMNS: usize = 16;

/// Cosine of 22.5°, and of 67.5°, its sine.
const COSINES: [f64; 2] = [0.923_879_532_511_286_7, 0.382_683_432_365_089_8];

/// How far beyond the circle the film runs around the ball, the sine of 60°: rows, fan and tip are then about evenly spaced.
const FILM_DEPTH: f64 = 0.866_025_403_784_438_7;

/// Fills a film around the end of a strut: its cell is the strut's, the other one is a fan over the end.
pub(super) fn fill_film(axis: DVec3, film: &mut Film) {
    let x = axis.any_orthonormal_vector();
    let y = axis.cross(x);
    let across = (1.0 - FILM_DEPTH * FILM_DEPTH).sqrt();
    film.fill_loop((0..COLUMNS).map(|column| {
        let [cosine, sine] = cosine_and_sine(column);
        (x * cosine + y * sine) * across - axis * FILM_DEPTH
    }));
}

/// Cosine and sine of a column's azimuth.
fn cosine_and_sine(column: usize) -> [f64; 2] {
    let [a, b] = COSINES;
    let diagonal = std::f64::consts::FRAC_1_SQRT_2;
    let quarter = [[1.0, 0.0], [a, b], [diagonal, diagonal], [b, a]];
    let [cosine, sine] = quarter[column % 4];
    match column / 4 {
        0 => [cosine, sine],
        1 => [-sine, cosine],
        2 => [-cosine, -sine],
        _ => [sine, -cosine],
    }
}

/// A point of a row on the ball, `share` of the way from the circle to the film.
pub(super) fn on_ball(circle: DVec3, film: DVec3, share: f64) -> DVec3 {
    unit_or(circle.lerp(film, share), circle)
}
