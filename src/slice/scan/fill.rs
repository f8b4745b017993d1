//! A layer's regions filled by the rules of [`ScanSettings`]: contours, centre lines, points, hatches and skins, in a short order.
//!
//! ```
//! use layerd::layer::{MarkClass, Vectors};
//! use layerd::slice::scan::{Fill, HatchSettings, HatchStrategy, Region, ScanSettings};
//! let hatch = HatchSettings {
//!     strategy: HatchStrategy::Zigzag,
//!     spacing_um: 60.0,
//!     angle_deg: 0.0,
//!     rotation_deg: 67.0,
//!     end_offset_um: 30.0,
//! };
//! let settings = ScanSettings {
//!     beam_diameter_um: 60.0,
//!     simplify_tolerance_um: 5.0,
//!     contour_count: 1,
//!     contour_offset_um: 30.0,
//!     contour_spacing_um: 60.0,
//!     thin_below_um: 120.0,
//!     contour_only_below_um: 240.0,
//!     point_below_um: 60.0,
//!     shortest_mark_um: 40.0,
//!     hatch: Some(hatch),
//!     up_skin: None,
//!     down_skin: None,
//! };
//! let square = vec![[0.0, 0.0], [1000.0, 0.0], [1000.0, 1000.0], [0.0, 1000.0]];
//! let mut vectors = Vectors::default();
//! let mut fill = Fill::new(settings, 1)?;
//! let counts = fill.layer(0, &[Region { outer: square, holes: vec![] }], None, None, &mut vectors)?;
//! assert_eq!((counts.regions, counts.unmarked), (1, 0));
//! let count = |class| vectors.marks().filter(|mark| mark.class == class).count();
//! // Lines at 60, 120 to 900 µm; the border less beam and end offset begins at 60 and ends at 940 µm.
//! assert_eq!((count(MarkClass::Contour), count(MarkClass::Hatch)), (4, 15));
//! # Ok::<(), layerd::slice::scan::FillError>(())
//! ```
//!
//! Memory: the vectors of the layer twice, once as found and once in order, about 100 bytes for each piece while they are ordered, and
//! about 1 kB for each point of the border of a region that is worked on, one region for each thread.

use crate::layer::{HatchFrame, MarkClass, Vectors};
use crate::slice::SliceError;
use crate::slice::workers::Workers;

use super::bare::{Stretch, bare_stretches};
use super::counts::ScanCounts;
use super::hatch::Hatcher;
use super::offset::{Area, MAX_FIELD_UM, to_um};
use super::pieces::Pieces;
use super::region::Region;
use super::settings::{HatchSettings, ScanSettings, SettingsError};
use super::skin::{Cover, exposed};
use super::thin::{Split, ThinMark, ThinPart, ThinRules, split, thin_mark};

/// How many regions are filled before their pieces are put together, so that memory does not hold two copies of all.
const BATCH_REGIONS: usize = 256;

/// How many contours lead from the border to the middle of a part that is too narrow for hatches. Settings allow it to be some 100 µm
/// wide; this ends the loop whatever they say.
const MAX_INNER_CONTOURS: u32 = 1000;

/// By how much farther than a rolling disc its area reaches, so that right-angled corners of wide areas are hatched.
const CORNER_REACH: f64 = std::f64::consts::SQRT_2;

/// By how much what is hatched reaches over its border, micrometres: more than arcs leave their circles, so that no slivers remain along it.
const SEAM_UM: f64 = 2.0;

/// Why a layer cannot be filled.
#[derive(Debug, thiserror::Error)]
pub enum FillError {
    /// Settings that contradict each other or are out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A region outside every field.
    #[error(
        "the layer reaches to {at_um} µm; a field reaches from 0 to at most {MAX_FIELD_UM} µm: check where the part is placed"
    )]
    OutsideField {
        /// A coordinate outside, micrometres, or not a number.
        at_um: f64,
    },
    /// The system gives no threads.
    #[error(transparent)]
    Threads(#[from] SliceError),
}

/// Fills layers. The result depends on the layer and the settings alone: not on the number of threads, or the layers before.
pub struct Fill {
    settings: ScanSettings,
    rules: ThinRules,
    workers: Workers,
}

impl Fill {
    /// Checks the settings, and starts `threads` threads, including the calling one.
    pub fn new(settings: ScanSettings, threads: usize) -> Result<Self, FillError> {
        settings.check()?;
        let rules = ThinRules {
            // Narrower parts have no room for a contour.
            below_um: settings.thin_below_um.max(2.0 * settings.contour_offset_um),
            beam_um: settings.beam_diameter_um,
            contour_um: settings.contour_offset_um,
            point_below_um: settings.point_below_um,
            tolerance_um: settings.simplify_tolerance_um,
        };
        Ok(Self { settings, rules, workers: Workers::new(threads.max(1))? })
    }

    /// Appends the vectors of a layer, counted from 0, in the order in which they are marked. `above` and `below` are the regions of the
    /// layers next to it; if there is none, all of the layer is skin. They are not looked at unless the settings have skins.
    pub fn layer(
        &mut self,
        layer: u32,
        regions: &[Region],
        above: Option<&[Region]>,
        below: Option<&[Region]>,
        out: &mut Vectors,
    ) -> Result<ScanCounts, FillError> {
        for region in regions.iter().chain(above.into_iter().chain(below).flatten()) {
            check_place(region)?;
        }
        let plan = LayerPlan::new(&self.settings, self.rules, layer, above, below);
        let mut counts = ScanCounts::default();
        let mut all = Pieces::default();
        let mut filled: Vec<(Pieces, ScanCounts)> = Vec::new();
        for batch in regions.chunks(BATCH_REGIONS) {
            filled.clear();
            filled.resize_with(batch.len(), Default::default);
            self.workers.each(batch.iter().zip(&mut filled), |(region, (pieces, counts))| {
                plan.fill(region, pieces, counts);
            });
            for (pieces, more) in &filled {
                all.append(pieces);
                counts += *more;
            }
        }
        all.write(&plan.frames, out, &mut counts);
        Ok(counts)
    }
}

fn check_place(region: &Region) -> Result<(), FillError> {
    let is_outside = |um: &f64| !(0.0..=MAX_FIELD_UM).contains(um);
    let outside = region.rings().flatten().flatten().copied().find(|um| is_outside(um));
    outside.map_or(Ok(()), |at_um| Err(FillError::OutsideField { at_um }))
}

/// How the regions of one layer are filled.
struct LayerPlan<'a> {
    settings: &'a ScanSettings,
    rules: ThinRules,
    /// Down-skin, up-skin, and what lies between them.
    fillings: [Option<Filling<'a>>; 3],
    frames: Vec<HatchFrame>,
    /// The layers next to it; `None` for a skin that is filled like the rest.
    below: Option<Cover>,
    above: Option<Cover>,
}

/// One kind of hatches.
struct Filling<'a> {
    class: MarkClass,
    settings: &'a HatchSettings,
    hatcher: Hatcher,
    /// Number of its first frame in the layer.
    frame: u8,
}

impl<'a> LayerPlan<'a> {
    fn new(
        settings: &'a ScanSettings,
        rules: ThinRules,
        layer: u32,
        above: Option<&[Region]>,
        below: Option<&[Region]>,
    ) -> Self {
        let mut frames = Vec::new();
        let kinds = [
            (MarkClass::DownSkin, &settings.down_skin),
            (MarkClass::UpSkin, &settings.up_skin),
            (MarkClass::Hatch, &settings.hatch),
        ];
        let fillings = kinds.map(|(class, settings_of)| {
            let of = settings_of.as_ref()?;
            let hatcher = Hatcher::new(of, layer, settings.shortest_mark_um);
            let frame = frames.len() as u8;
            frames.extend(hatcher.frames());
            Some(Filling { class, settings: of, hatcher, frame })
        });
        let cover = |skin: &Option<HatchSettings>, regions: Option<&[Region]>| {
            skin.as_ref().map(|_| Cover::new(regions.unwrap_or_default()))
        };
        let (below, above) = (cover(&settings.down_skin, below), cover(&settings.up_skin, above));
        Self { settings, rules, fillings, frames, below, above }
    }

    /// Fills a region.
    fn fill(&self, region: &Region, pieces: &mut Pieces, counts: &mut ScanCounts) {
        let Split { wide, thin } = split(Area::of(region), &self.rules);
        for part in &thin {
            self.mark_thin(part, MarkClass::Thin, &self.rules, pieces, counts);
        }
        if !wide.is_empty() {
            self.fill_wide(&wide, pieces, counts);
        }
        counts.regions += 1;
        counts.unmarked += u64::from(pieces.len() == 0);
    }

    fn mark_thin(
        &self,
        part: &ThinPart,
        class: MarkClass,
        rules: &ThinRules,
        pieces: &mut Pieces,
        counts: &mut ScanCounts,
    ) {
        match thin_mark(part, rules) {
            ThinMark::Lines(lines) => {
                lines.iter().for_each(|line| pieces.push_path(class, line));
                counts.centre_lines += 1;
            }
            ThinMark::Point(point) => {
                pieces.push_path(MarkClass::Point, &[point]);
                counts.points += 1;
            }
        }
    }

    /// Contours and hatches. A region that thin parts divide has several wide ones, which are filled together.
    fn fill_wide(&self, wide: &Area, pieces: &mut Pieces, counts: &mut ScanCounts) {
        let ScanSettings { contour_count, contour_offset_um, contour_spacing_um, .. } = *self.settings;
        let contour_um = |number: u32| contour_offset_um + f64::from(number) * contour_spacing_um;
        let mut inside = wide.clone();
        for number in 0..contour_count {
            inside = wide.offset(-contour_um(number));
            if inside.is_empty() {
                return;
            }
            push_rings(&inside, pieces);
        }
        let depth_um = if contour_count == 0 { 0.0 } else { contour_um(contour_count - 1) };
        let hatched = self.hatch(wide, depth_um, pieces, counts);
        if let Hatched::Only(hatched) = hatched {
            let next_um = if contour_count == 0 { contour_offset_um } else { contour_spacing_um };
            self.fill_narrow(inside.subtract(&hatched), hatched.is_empty(), next_um, pieces, counts);
        }
    }

    /// Hatches what is wide enough.
    fn hatch(&self, wide: &Area, depth_um: f64, pieces: &mut Pieces, counts: &mut ScanCounts) -> Hatched {
        let core = Core::of(wide, self.settings.contour_only_below_um);
        let mut masks = [None, None];
        for (mask, cover) in masks.iter_mut().zip([&self.below, &self.above]) {
            if let (Some(cover), false) = (cover, core.area.is_empty()) {
                *mask = Some(exposed(wide, cover, self.settings.beam_diameter_um));
            }
        }
        let mut hatched = Hatched::All;
        for (number, filling) in self.fillings.iter().enumerate() {
            let Some(filling) = filling else { continue };
            let end_offset_um = filling.settings.end_offset_um;
            let (border, is_whole) = core.inset(wide, depth_um + end_offset_um);
            let area = match (number, &masks) {
                (0 | 1, _) => {
                    let own = masks[number].as_ref().map(|mask| border.intersect(mask)).unwrap_or_default();
                    if number == 1 { without(own, &masks[..1]) } else { own }
                }
                _ => without(border.clone(), &masks),
            };
            if filling.class == MarkClass::Hatch {
                hatched = if is_whole { Hatched::All } else { Hatched::Only(border.offset(end_offset_um + SEAM_UM)) };
            }
            pieces.push_hatches(filling.class, (&filling.hatcher, filling.frame), &area, counts);
        }
        hatched
    }

    /// Fills what is too narrow for hatches with contours, up to the middle, and what remains between the innermost two with lines.
    /// `is_all`: no part of the region is wide enough. `next_um`: from the border of `inside` to the next contour.
    fn fill_narrow(&self, mut inside: Area, is_all: bool, next_um: f64, pieces: &mut Pieces, counts: &mut ScanCounts) {
        let beam_um = self.settings.beam_diameter_um;
        let mut step_um = next_um;
        // What the track of the contour around it leaves; nothing yet if there is none.
        let gap = |inside: &Area, step_um: f64| inside.offset(-(step_um - beam_um / 2.0).max(0.0));
        let mut rest = gap(&inside, step_um);
        if is_all || !rest.is_empty() {
            counts.contours_only += 1;
        }
        for _ in 0..MAX_INNER_CONTOURS {
            if rest.is_empty() {
                return;
            }
            let next = inside.offset(-step_um);
            push_rings(&next, pieces);
            for area in left_between(&rest, &next, beam_um)
                .into_pieces()
                .filter(|area| area.area_um2() > beam_um * beam_um / 4.0)
            {
                // Between two tracks: up to their borders, so no end stops before.
                let rules = ThinRules { beam_um: 0.0, ..self.rules };
                self.mark_thin(
                    &ThinPart { area, joints: Vec::new() },
                    MarkClass::Contour,
                    &rules,
                    pieces,
                    &mut ScanCounts::default(),
                );
            }
            (inside, step_um) = (next, self.settings.contour_spacing_um);
            rest = gap(&inside, step_um);
        }
    }
}

/// What a contour does not melt of the area inside the track of the one around it. Nothing if only short stretches of the border are left:
/// then all pieces are small.
fn left_between(rest: &Area, next: &Area, beam_um: f64) -> Area {
    let reach_um = beam_um / 2.0 * CORNER_REACH;
    let is_short = |bare: &Stretch| bare.length_um() < beam_um / 4.0;
    if !next.is_empty() && bare_stretches(rest, next, reach_um).iter().all(is_short) {
        return Area::default();
    }
    rest.subtract(&next.offset(reach_um))
}

/// What is left of an area without some others.
fn without(area: Area, masks: &[Option<Area>]) -> Area {
    masks.iter().flatten().fold(area, |area, mask| area.subtract(mask))
}

fn push_rings(area: &Area, pieces: &mut Pieces) {
    for ring in area.rings() {
        pieces.push_ring(MarkClass::Contour, ring.iter().map(|point| to_um(*point)).collect());
    }
}

/// What of an area has hatches.
enum Hatched {
    /// All of it, or the settings have none.
    All,
    /// What lies here. It reaches to the innermost contour, or to the border if there is none.
    Only(Area),
}

/// Where an area is wide enough for hatches.
struct Core {
    /// Centres of a disc that rolls through it.
    area: Area,
    radius_um: f64,
}

impl Core {
    fn of(wide: &Area, narrow_below_um: f64) -> Self {
        let radius_um = narrow_below_um / 2.0;
        Self { area: wide.offset(-radius_um), radius_um }
    }

    /// The area at some distance from its border, where it is wide enough, and whether that is everywhere.
    fn inset(&self, wide: &Area, depth_um: f64) -> (Area, bool) {
        if self.area.is_empty() {
            return (Area::default(), false);
        }
        let inset = wide.offset(-depth_um);
        let reach_um = self.radius_um - depth_um;
        if reach_um <= 0.0 {
            return (inset, true);
        }
        let reach_um = reach_um * CORNER_REACH;
        if bare_stretches(&inset, &self.area, reach_um).is_empty() {
            return (inset, true);
        }
        (inset.intersect(&self.area.offset(reach_um)), false)
    }
}
