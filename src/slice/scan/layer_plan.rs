//! How the regions of a layer are filled, one by one. `fill` uses it.

use std::time::{Duration, Instant};

use crate::layer::{HatchFrame, MarkClass};

use super::bare::{Stretch, bare_stretches};
use super::counts::ScanCounts;
use super::hatch::{Ground, Hatcher};
use super::offset::{Area, to_um};
use super::pieces::Pieces;
use super::region::Region;
use super::settings::{HatchSettings, ScanSettings};
use super::skin::{Cover, exposed};
use super::thin::{Split, ThinMark, ThinPart, ThinRules, split, thin_mark};

/// How many contours lead from the border to the middle of a part that is too narrow for hatches. Settings allow it to be some 100 µm
/// wide; this ends the loop whatever they say.
const MAX_INNER_CONTOURS: u32 = 1000;

/// By how much farther than a rolling disc its area reaches, so that right-angled corners of wide areas are hatched.
const CORNER_REACH: f64 = std::f64::consts::SQRT_2;

/// By how much what is hatched reaches over its border, micrometres: as far as an arc may leave its circle. Fewer slivers then remain along
/// the border, and little is left without a mark.
const SEAM_UM: f64 = 0.5;

/// Time that the steps of filling took, of all threads together.
#[derive(Clone, Copy, Debug, Default)]
pub struct FillTimes {
    /// Finding thin parts, and their centre lines.
    pub thin: Duration,
    /// Contours of what is wide.
    pub contours: Duration,
    /// Where hatches lie, and the hatches.
    pub hatch: Duration,
    /// Contours and lines of what is too narrow for hatches.
    pub narrow: Duration,
    /// Putting everything in order.
    pub order: Duration,
}

impl std::ops::AddAssign for FillTimes {
    fn add_assign(&mut self, other: Self) {
        self.thin += other.thin;
        self.contours += other.contours;
        self.hatch += other.hatch;
        self.narrow += other.narrow;
        self.order += other.order;
    }
}

/// What a region is filled with.
#[derive(Default)]
pub(super) struct Filled {
    pub(super) pieces: Pieces,
    pub(super) counts: ScanCounts,
    pub(super) times: FillTimes,
}

/// How the regions of one layer are filled.
pub(super) struct LayerPlan<'a> {
    settings: &'a ScanSettings,
    rules: ThinRules,
    /// Down-skin, up-skin, and what lies between them.
    fillings: [Option<Filling<'a>>; 3],
    pub(super) frames: Vec<HatchFrame>,
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
    pub(super) fn new(
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
    pub(super) fn fill(&self, region: &Region, filled: &mut Filled) {
        let began = Instant::now();
        let Split { wide, thin } = split(Area::of(region), &self.rules);
        for part in &thin {
            self.mark_thin(part, MarkClass::Thin, &self.rules, &mut filled.pieces, &mut filled.counts);
        }
        filled.times.thin += began.elapsed();
        if !wide.is_empty() {
            self.fill_wide(&wide, filled);
        }
        filled.counts.regions += 1;
        filled.counts.unmarked += u64::from(filled.pieces.len() == 0);
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
    fn fill_wide(&self, wide: &Area, filled: &mut Filled) {
        let Filled { pieces, counts, times } = filled;
        let ScanSettings { contour_count, contour_offset_um, contour_spacing_um, .. } = *self.settings;
        let contour_um = |number: u32| contour_offset_um + f64::from(number) * contour_spacing_um;
        let began = Instant::now();
        let mut inside = wide.clone();
        for number in 0..contour_count {
            inside = wide.offset(-contour_um(number));
            push_rings(&inside, pieces);
            if inside.is_empty() {
                break;
            }
        }
        times.contours += began.elapsed();
        if inside.is_empty() {
            return;
        }
        let began = Instant::now();
        let depth_um = if contour_count == 0 { 0.0 } else { contour_um(contour_count - 1) };
        let hatched = self.hatch(wide, depth_um, pieces, counts);
        times.hatch += began.elapsed();
        let Hatched::Only(hatched) = hatched else { return };
        let began = Instant::now();
        let next_um = if contour_count == 0 { contour_offset_um } else { contour_spacing_um };
        self.fill_narrow(inside.subtract(&hatched), hatched.is_empty(), next_um, pieces, counts);
        times.narrow += began.elapsed();
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
            let border = if core.area.is_empty() { Area::default() } else { wide.offset(-(depth_um + end_offset_um)) };
            let reach_um = core.reach_um(&border, depth_um + end_offset_um);
            let reached = reach_um.map(|reach_um| core.area.offset(reach_um));
            if let (MarkClass::Hatch, Some(reach_um)) = (filling.class, reach_um) {
                hatched = Hatched::Only(core.area.offset(reach_um + end_offset_um + SEAM_UM));
            }
            // Where both skins are, the down-skin's parameters count.
            let (own, others) =
                if number < masks.len() { (&masks[number..=number], &masks[..number]) } else { (&[][..], &masks[..]) };
            let within = [Some(&border), reached.as_ref()].into_iter().chain(own.iter().map(Option::as_ref)).flatten();
            let ground = Ground { within: within.collect(), without: others.iter().flatten().collect() };
            if !border.is_empty() {
                pieces.push_hatches(filling.class, (&filling.hatcher, filling.frame), &ground, counts);
            }
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

    /// How far around the core an area is wide enough for hatches that lies at some distance from the border of the wide one; `None` if it
    /// is everywhere.
    fn reach_um(&self, area: &Area, depth_um: f64) -> Option<f64> {
        let reach_um = (self.radius_um - depth_um) * CORNER_REACH;
        let is_whole = if self.area.is_empty() {
            false
        } else {
            reach_um <= 0.0 || bare_stretches(area, &self.area, reach_um).is_empty()
        };
        (!is_whole).then_some(reach_um)
    }
}
