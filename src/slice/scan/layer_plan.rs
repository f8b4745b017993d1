//! How the regions of one layer are filled, one by one. `fill` uses it.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use crate::layer::{HatchFrame, MarkClass};
use crate::stream::{BudgetExceeded, Charge};

use super::bare::{Stretch, bare_stretches};
use super::counts::ScanCounts;
use super::hatch::{Ground, Hatcher};
use super::memory::{RegionMemory, Room, hatch_bytes, middle_bytes};
use super::offset::{Area, to_um};
use super::pieces::{self, Pieces};
use super::region::Region;
use super::settings::{HatchSettings, ScanSettings};
use super::skin::{Cover, exposed};
use super::thin::{Split, ThinMark, ThinPart, ThinRules, Wide, split, thin_mark};

/// Most contours from the border to the middle of a part that is too narrow for hatches. Usual settings need a few; this bounds the loop
/// for any settings.
const MAX_INNER_CONTOURS: u32 = 1000;

/// Factor on the radius of the rolling disc, so that what it reaches has the right-angled corners of a wide area.
pub(super) const CORNER_REACH: f64 = std::f64::consts::SQRT_2;

/// By how much the hatched area is grown before it is taken out of the rest, micrometres: as far as an arc may leave its circle. Fewer
/// slivers then remain along its border.
pub(super) const SEAM_UM: f64 = 0.5;

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
    /// What the pieces are charged, if they are charged as they are found.
    charge: Option<Charge>,
}

impl Filled {
    /// Charges the pieces before `more_bytes` are added, or a little: lists may double, and the old ones are there until they are copied.
    fn charge_more(&mut self, room: Room<'_>, more_bytes: u64) -> Result<(), BudgetExceeded> {
        self.charge = room.take(|| 3 * self.pieces.memory_bytes() + more_bytes)?;
        Ok(())
    }

    /// Gives back what the pieces are charged, and returns their memory, bytes, which is to be charged instead.
    pub(super) fn settle(&mut self) -> u64 {
        self.charge = None;
        size_of::<Self>() as u64 + self.pieces.memory_bytes()
    }
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

    /// What filling a region takes at most.
    pub(super) fn memory(&self, region: &Region) -> RegionMemory {
        let near = [&self.below, &self.above].into_iter().flatten().map(|cover| cover.points_near(region));
        RegionMemory::of(region, self.settings, &self.rules, near.sum())
    }

    /// Fills a region. `room` charges what [`RegionMemory::filling_bytes`] and [`RegionMemory::lines_bytes`] bound.
    ///
    /// # Errors
    /// [`BudgetExceeded`] if the budget of `room` has no room.
    pub(super) fn fill(&self, region: &Region, room: Room<'_>, filled: &mut Filled) -> Result<(), BudgetExceeded> {
        let began = Instant::now();
        let Split { wide, thin } = split(Area::of(region), &self.rules);
        for part in &thin {
            let _work = room.take(|| middle_bytes(&part.area, &self.rules))?;
            let mark = thin_mark(part, &self.rules);
            match mark {
                ThinMark::Lines(_) => filled.counts.centre_lines += 1,
                ThinMark::Point(_) => filled.counts.points += 1,
            }
            filled.charge_more(room, 0)?;
            push_thin(&mark, MarkClass::Thin, &mut filled.pieces);
        }
        filled.times.thin += began.elapsed();
        if !wide.area.is_empty() {
            self.fill_wide(&wide, room, filled)?;
        }
        filled.counts.regions += 1;
        filled.counts.unmarked += u64::from(filled.pieces.all().is_empty());
        Ok(())
    }

    /// Contours and hatches. A region that thin parts divide has several wide ones, which are filled together.
    fn fill_wide(&self, wide: &Wide, room: Room<'_>, filled: &mut Filled) -> Result<(), BudgetExceeded> {
        let ScanSettings { contour_count, contour_offset_um, contour_spacing_um, .. } = *self.settings;
        let contour_um = |number: u32| contour_offset_um + f64::from(number) * contour_spacing_um;
        let began = Instant::now();
        let mut inside = Cow::Borrowed(&wide.area);
        for number in 0..contour_count {
            inside = wide.inset(contour_um(number));
            push_rings(&inside, &mut filled.pieces);
            if inside.is_empty() {
                break;
            }
        }
        filled.times.contours += began.elapsed();
        if inside.is_empty() {
            return Ok(());
        }
        let began = Instant::now();
        let depth_um = if contour_count == 0 { 0.0 } else { contour_um(contour_count - 1) };
        let hatched = self.hatch(wide, depth_um, room, filled)?;
        filled.times.hatch += began.elapsed();
        let Hatched::Only(hatched) = hatched else { return Ok(()) };
        let began = Instant::now();
        let next_um = if contour_count == 0 { contour_offset_um } else { contour_spacing_um };
        self.fill_narrow(&inside.subtract(&hatched), hatched.is_empty(), next_um, room, filled)?;
        filled.times.narrow += began.elapsed();
        Ok(())
    }

    /// Hatches what is wide enough. `depth_um`: from the border to the innermost contour, or 0 if there is none.
    fn hatch(
        &self,
        wide: &Wide,
        depth_um: f64,
        room: Room<'_>,
        filled: &mut Filled,
    ) -> Result<Hatched, BudgetExceeded> {
        let core = Core::of(wide, self.settings.contour_only_below_um);
        if core.area.is_empty() {
            return Ok(if self.settings.hatch.is_some() { Hatched::Only(Area::default()) } else { Hatched::All });
        }
        let masks = [&self.below, &self.above]
            .map(|cover| cover.as_ref().map(|cover| exposed(&wide.area, cover, self.settings.beam_diameter_um)));
        let mut hatched = Hatched::All;
        for (number, filling) in self.fillings.iter().enumerate() {
            let Some(filling) = filling else { continue };
            let end_offset_um = filling.settings.end_offset_um;
            // Where the ends of hatches lie.
            let border = wide.inset(depth_um + end_offset_um);
            let reach_um = core.reach_um(&border, depth_um + end_offset_um);
            let reached = reach_um.map(|reach_um| core.area.offset(reach_um));
            if let (MarkClass::Hatch, Some(reach_um)) = (filling.class, reach_um) {
                hatched = Hatched::Only(core.area.offset(reach_um + end_offset_um + SEAM_UM));
            }
            // A skin lies within its own mask. Each filling leaves out the masks before it: where both skins are, the down-skin counts.
            let own = masks.get(number).and_then(Option::as_ref);
            let within = [Some(&*border), reached.as_ref(), own].into_iter().flatten().collect();
            let ground = Ground { within, without: masks.iter().take(number).flatten().collect() };
            if !border.is_empty() {
                let _work = room.take(|| hatch_bytes(&ground, &filling.hatcher))?;
                let hatches = filling.hatcher.fill(&ground, &mut filled.counts);
                filled.charge_more(room, pieces::bytes([hatches.parts.len(), 0, hatches.lines.len()]))?;
                filled.pieces.push_hatches(filling.class, (&filling.hatcher, filling.frame), &hatches);
            }
        }
        Ok(hatched)
    }

    /// Fills what is too narrow for hatches with contours, up to the middle, and what their tracks leave between them with lines.
    /// `is_all`: no part of the region is wide enough. `next_um`: from the border of `inside` to the next contour.
    fn fill_narrow(
        &self,
        inside: &Area,
        is_all: bool,
        next_um: f64,
        room: Room<'_>,
        filled: &mut Filled,
    ) -> Result<(), BudgetExceeded> {
        let beam_um = self.settings.beam_diameter_um;
        let mut step_um = next_um;
        // What lies inside the outer edge of the next contour's track, and how far inside the last contour that is.
        let gap = |inside: &Area, step_um: f64| {
            let gap_um = (step_um - beam_um / 2.0).max(0.0);
            (inside.offset(-gap_um), gap_um)
        };
        let (mut rest, mut gap_um) = gap(inside, step_um);
        if is_all || !rest.is_empty() {
            filled.counts.contours_only += 1;
        }
        for _ in 0..MAX_INNER_CONTOURS {
            if rest.is_empty() {
                break;
            }
            let next = rest.offset(gap_um - step_um);
            push_rings(&next, &mut filled.pieces);
            for area in left_between(&rest, &next, beam_um)
                .into_pieces()
                .filter(|area| area.area_um2() > beam_um * beam_um / 4.0)
            {
                // It lies between two tracks: its lines end at its border, not half a beam before it.
                let rules = ThinRules { beam_um: 0.0, ..self.rules };
                let _work = room.take(|| middle_bytes(&area, &rules))?;
                let mark = thin_mark(&ThinPart { area, joints: Vec::new() }, &rules);
                filled.charge_more(room, 0)?;
                push_thin(&mark, MarkClass::Contour, &mut filled.pieces);
            }
            step_um = self.settings.contour_spacing_um;
            (rest, gap_um) = gap(&next, step_um);
        }
        Ok(())
    }
}

/// What the tracks of the contours `next` leave of `rest`, the area inside their outer edges. Nothing if they leave only short stretches of
/// its border: then all pieces are small.
fn left_between(rest: &Area, next: &Area, beam_um: f64) -> Area {
    let reach_um = beam_um / 2.0 * CORNER_REACH;
    let is_short = |bare: &Stretch| bare.length_um() < beam_um / 4.0;
    if !next.is_empty() && bare_stretches(rest, next, reach_um).iter().all(is_short) {
        return Area::default();
    }
    rest.subtract(&next.offset(reach_um))
}

/// Adds the mark of a thin part; `class` is the class of its lines.
fn push_thin(mark: &ThinMark, class: MarkClass, pieces: &mut Pieces) {
    match mark {
        ThinMark::Lines(lines) => lines.iter().for_each(|line| pieces.push_path(class, line)),
        ThinMark::Point(point) => pieces.push_path(MarkClass::Point, &[*point]),
    }
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
    /// What lies in this area. It reaches to the innermost contour, or to the border if there is none.
    Only(Area),
}

/// Where an area is wide enough for hatches.
struct Core<'a> {
    /// Where the centre of a disc goes that rolls through the wide area.
    area: Cow<'a, Area>,
    radius_um: f64,
}

impl<'a> Core<'a> {
    fn of(wide: &'a Wide, narrow_below_um: f64) -> Self {
        let radius_um = narrow_below_um / 2.0;
        Self { area: wide.rough_inset(radius_um), radius_um }
    }

    /// How far from the core an area is wide enough for hatches; `None` if it is everywhere. The area lies `depth_um` inside the wide one.
    fn reach_um(&self, area: &Area, depth_um: f64) -> Option<f64> {
        let reach_um = (self.radius_um - depth_um) * CORNER_REACH;
        let is_whole = reach_um <= 0.0 || bare_stretches(area, &self.area, reach_um).is_empty();
        (!is_whole).then_some(reach_um)
    }
}
