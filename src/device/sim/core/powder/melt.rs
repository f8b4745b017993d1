//! The picture of what the laser melts: a disc as wide as the beam, swept along each vector. Part of [`Powder`](super::Powder).

use crate::layer::{Bitmap, Depth, Raster};
use crate::link::message::ExposureId;

/// How melted layers are drawn. No capability tells it: a host does not need it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeltSettings {
    /// The machine's grid. A pixel is lit if its centre was under the beam. The picture is not mirrored: row 0 lies at the field's low
    /// edge, as in the pictures that `layerctl slice` draws for this grid.
    pub raster: Raster,
    /// Diameter of the beam, micrometres; greater than 0.
    pub beam_um: f64,
}

/// Draws one layer, over all its acts.
#[derive(Debug)]
pub(super) struct Melt {
    settings: MeltSettings,
    /// The layer that is being drawn. It stays when its marking is cut short, so that it becomes whole.
    picture: Option<(ExposureId, Bitmap)>,
}

impl Melt {
    pub(super) fn new(settings: MeltSettings) -> Self {
        Self { settings, picture: None }
    }

    /// Marking of a layer begins, or goes on.
    pub(super) fn begin(&mut self, id: ExposureId) {
        if self.picture.as_ref().is_none_or(|(drawn, _)| *drawn != id) {
            let Raster { width_px, height_px, .. } = self.settings.raster;
            self.picture = Some((id, Bitmap::new(width_px, height_px, Depth::Bit)));
        }
    }

    /// The layer is whole: its picture.
    pub(super) fn take(&mut self, id: ExposureId) -> Option<Bitmap> {
        self.picture.take_if(|(drawn, _)| *drawn == id).map(|(_, picture)| picture)
    }

    /// The beam goes from one point to another, micrometres.
    pub(super) fn sweep(&mut self, from_um: [f64; 2], to_um: [f64; 2]) {
        let Some((_, picture)) = &mut self.picture else { return };
        let Raster { width_px, height_px, pixel_um: [pitch_x, pitch_y], .. } = self.settings.raster;
        let radius_um = self.settings.beam_um / 2.0;
        let stride = picture.stride_bytes();
        let data = picture.data_mut();
        let low_um = from_um[1].min(to_um[1]) - radius_um;
        let high_um = from_um[1].max(to_um[1]) + radius_um;
        for row in pixels(low_um, high_um, pitch_y, height_px) {
            let y_um = (f64::from(row) + 0.5) * pitch_y;
            let Some([low_um, high_um]) = span(from_um, to_um, radius_um, y_um) else { continue };
            let bytes = &mut data[row as usize * stride..][..stride];
            for column in pixels(low_um, high_um, pitch_x, width_px) {
                bytes[column as usize / 8] |= 0x80 >> (column % 8);
            }
        }
    }
}

/// The pixels whose centres lie between two places, both included.
fn pixels(low_um: f64, high_um: f64, pitch_um: f64, count: u32) -> std::ops::Range<u32> {
    // Conversions saturate, so that places outside the picture give its edges.
    let first = (low_um / pitch_um - 0.5).ceil() as u32;
    let end = (high_um / pitch_um - 0.5).floor() + 1.0;
    first..(end as u32).min(count)
}

/// Where the line at height `y_um` lies inside the swept disc. The swept disc is convex, so that is one interval.
fn span(from_um: [f64; 2], to_um: [f64; 2], radius_um: f64, y_um: f64) -> Option<[f64; 2]> {
    let mut low_um = f64::INFINITY;
    let mut high_um = f64::NEG_INFINITY;
    let mut include = |x_um: f64| (low_um, high_um) = (low_um.min(x_um), high_um.max(x_um));
    // The discs at both ends.
    for [x_um, centre_um] in [from_um, to_um] {
        let half_um2 = radius_um * radius_um - (y_um - centre_um) * (y_um - centre_um);
        if half_um2 >= 0.0 {
            include(x_um - half_um2.sqrt());
            include(x_um + half_um2.sqrt());
        }
    }
    // The sides of the rectangle between them.
    let [along_x, along_y] = [to_um[0] - from_um[0], to_um[1] - from_um[1]];
    let length_um = along_x.hypot(along_y);
    if length_um > 0.0 && along_y != 0.0 {
        let offset_um = [-along_y * radius_um / length_um, along_x * radius_um / length_um];
        for side in [1.0, -1.0] {
            let share = (y_um - from_um[1] - side * offset_um[1]) / along_y;
            if (0.0..=1.0).contains(&share) {
                include(from_um[0] + side * offset_um[0] + share * along_x);
            }
        }
    }
    // A horizontal vector: its rectangle ends where its discs have their centres, which the discs include.
    (low_um <= high_um).then_some([low_um, high_um])
}
