//! Filled regions: what is covered, what is spilled, and what lies where.

mod properties;
mod scan_samples;

use layerd::layer::{Mark, MarkClass, Run, Vectors};
use layerd::slice::SliceError;
use layerd::slice::scan::{Fill, FillError, HatchSettings, HatchStrategy, Region, ScanCounts, ScanSettings};
use layerd::stream::MemoryBudget;
use properties::cases;
use proptest::prelude::*;
use scan_samples::{disc, dumb_bell, islands, rectangle, settings, star, with_hole};

const STRATEGIES: [HatchStrategy; 4] = [
    HatchStrategy::Zigzag,
    HatchStrategy::Unidirectional,
    HatchStrategy::Stripes { width_um: 700.0, overlap_um: 50.0 },
    HatchStrategy::Chessboard { island_um: 600.0, overlap_um: 50.0 },
];

/// Enough for every layer here.
fn budget() -> MemoryBudget {
    MemoryBudget::new(1 << 30)
}

fn filled(settings: &ScanSettings, layer: u32, regions: &[Region]) -> (Vectors, ScanCounts) {
    let mut vectors = Vectors::default();
    let mut fill = Fill::new(settings.clone(), 1, &budget()).expect("good settings");
    let counts = fill.layer(layer, regions, None, None, &mut vectors).expect("it lies in the field");
    (vectors, counts)
}

/// Shares of the regions' area: what tracks of a beam's width cover, and what they cover beside it. Pixels of 5 µm.
struct Melted {
    covered: f64,
    spilled: f64,
}

const PIXEL_UM: f64 = 5.0;

fn melted(vectors: &Vectors, regions: &[Region], beam_um: f64) -> Melted {
    let points = || regions.iter().flat_map(|region| &region.outer);
    let low = [0, 1].map(|axis| points().map(|point| point[axis]).fold(f64::MAX, f64::min) - 2.0 * beam_um);
    let high = [0, 1].map(|axis| points().map(|point| point[axis]).fold(f64::MIN, f64::max) + 2.0 * beam_um);
    let [width, height] = [0, 1].map(|axis| ((high[axis] - low[axis]) / PIXEL_UM).ceil() as usize);
    let mut is_solid = vec![false; width * height];
    for row in 0..height {
        let y = low[1] + (row as f64 + 0.5) * PIXEL_UM;
        let mut crossings: Vec<f64> =
            regions.iter().flat_map(Region::rings).flat_map(|ring| ring_crossings(ring, y)).collect();
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks(2) {
            let [from, to] = [pair[0], pair[1]].map(|x| ((x - low[0]) / PIXEL_UM - 0.5).ceil() as usize);
            is_solid[row * width + from..row * width + to].fill(true);
        }
    }
    let mut is_melted = vec![false; width * height];
    for mark in vectors.marks() {
        let [a, b] = [mark.from_um, mark.to_um].map(|point| [0, 1].map(|axis| f64::from(point[axis]) - low[axis]));
        let pixel = |um: f64| (um / PIXEL_UM).max(0.0) as usize;
        let first = [0, 1].map(|axis| pixel(a[axis].min(b[axis]) - beam_um / 2.0));
        let last = [0, 1].map(|axis| pixel(a[axis].max(b[axis]) + beam_um / 2.0));
        for row in first[1]..=last[1].min(height - 1) {
            for column in first[0]..=last[0].min(width - 1) {
                let at = [column, row].map(|pixel| (pixel as f64 + 0.5) * PIXEL_UM);
                if off_um(at, a, b) <= beam_um / 2.0 {
                    is_melted[row * width + column] = true;
                }
            }
        }
    }
    let count = |wanted: fn(bool, bool) -> bool| {
        is_solid.iter().zip(&is_melted).filter(|(solid, melted)| wanted(**solid, **melted)).count() as f64
    };
    let solid = count(|solid, _| solid);
    Melted {
        covered: count(|solid, melted| solid && melted) / solid,
        spilled: count(|solid, melted| !solid && melted) / solid,
    }
}

fn ring_crossings(ring: &[[f64; 2]], y: f64) -> impl Iterator<Item = f64> {
    (0..ring.len()).filter_map(move |number| {
        let [a, b] = [ring[number], ring[(number + 1) % ring.len()]];
        ((a[1] <= y) != (b[1] <= y)).then(|| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    })
}

fn off_um(point: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let [x, y] = [b[0] - a[0], b[1] - a[1]];
    let [px, py] = [point[0] - a[0], point[1] - a[1]];
    let squared = x * x + y * y;
    let share = if squared > 0.0 { ((px * x + py * y) / squared).clamp(0.0, 1.0) } else { 0.0 };
    (px - x * share).hypot(py - y * share)
}

/// Distance from a point to the nearest border, negative outside.
fn depth_um(regions: &[Region], point: [f64; 2]) -> f64 {
    let rings = || regions.iter().flat_map(Region::rings);
    let right = rings().flat_map(|ring| ring_crossings(ring, point[1])).filter(|x| *x > point[0]).count();
    let edges = rings().flat_map(|ring| (0..ring.len()).map(|number| [ring[number], ring[(number + 1) % ring.len()]]));
    let nearest = edges.map(|[a, b]| off_um(point, a, b)).fold(f64::MAX, f64::min);
    if right % 2 == 1 { nearest } else { -nearest }
}

/// Hatches end at least `least_um` inside, less what rounding to whole micrometres takes.
fn assert_hatches_inside(vectors: &Vectors, regions: &[Region], least_um: f64) {
    let is_hatch = |mark: &Mark| !matches!(mark.class, MarkClass::Contour | MarkClass::Thin | MarkClass::Point);
    for mark in vectors.marks().filter(is_hatch) {
        for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
            let at = [0, 1].map(|axis| {
                let [from, to] = [mark.from_um[axis], mark.to_um[axis]].map(f64::from);
                from + (to - from) * share
            });
            let depth = depth_um(regions, at);
            // Half a micrometre is what an arc leaves its circle.
            assert!(depth >= least_um - 1.5, "{mark:?} is {depth} µm inside");
        }
    }
}

fn plate() -> Region {
    let plate = rectangle([1000.0, 1000.0], [5000.0, 3500.0]);
    let plate = with_hole(plate, disc([2000.0, 2000.0], 400.0));
    with_hole(plate, rectangle([3000.0, 1500.0], [4200.0, 2900.0]))
}

#[test]
fn wide_regions_are_covered_and_little_is_spilled() {
    let regions = [
        plate(),
        disc([7000.0, 2500.0], 900.0),
        with_hole(disc([9500.0, 2500.0], 1000.0), disc([9500.0, 2500.0], 400.0)),
    ];
    for strategy in STRATEGIES {
        for layer in 0..3 {
            let (vectors, counts) = filled(&settings(strategy), layer, &regions);
            let Melted { covered, spilled } = melted(&vectors, &regions, 60.0);
            assert!(covered >= 0.99, "{strategy:?}, layer {layer}: {covered} covered");
            assert!(spilled <= 0.005, "{strategy:?}, layer {layer}: {spilled} spilled");
            assert_eq!((counts.regions, counts.unmarked, counts.centre_lines, counts.points), (3, 0, 0, 0));
            assert_hatches_inside(&vectors, &regions, 45.0);
        }
    }
}

#[test]
fn islands_of_a_lattice_are_all_marked_and_covered() {
    let regions = islands(150, 40.0, 400.0, 7);
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 3, &regions);
    let Melted { covered, spilled } = melted(&vectors, &regions, 60.0);
    assert_eq!((counts.regions, counts.unmarked), (150, 0));
    assert!(counts.contours_only > 0 && counts.centre_lines > 0);
    assert!(covered >= 0.98, "{covered} covered");
    assert!(spilled <= 0.01, "{spilled} spilled");
    for region in &regions {
        let marked =
            vectors.marks().any(|mark| depth_um(std::slice::from_ref(region), mark.from_um.map(f64::from)) > 0.0);
        assert!(marked, "nothing in {region:?}");
    }
}

fn class_count(vectors: &Vectors, class: MarkClass) -> usize {
    vectors.marks().filter(|mark| mark.class == class).count()
}

#[test]
fn compensation_taken_back_gives_the_area_of_the_region() {
    for region in [disc([2000.0, 2000.0], 300.0), rectangle([1000.0, 1000.0], [1900.0, 1450.0])] {
        let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), 0, std::slice::from_ref(&region));
        let (_, run) = vectors.runs().find(|(class, _)| *class == MarkClass::Contour).expect("a contour");
        let Run::Path(points) = run else { panic!("{run:?}") };
        assert_eq!(points.first(), points.last());
        let (mut area_um2, mut length_um) = (0.0, 0.0);
        for pair in points.windows(2) {
            let [[x1, y1], [x2, y2]] = [pair[0], pair[1]].map(|point| point.map(f64::from));
            area_um2 += (x1 * y2 - x2 * y1) / 2.0;
            length_um += (x2 - x1).hypot(y2 - y1);
        }
        // A convex polygon grows by its length times the distance, and by a disc.
        let grown_um2 = area_um2 + length_um * 30.0 + std::f64::consts::PI * 30.0 * 30.0;
        let error = grown_um2 / region.area_um2() - 1.0;
        assert!(error.abs() < 0.01, "{error}");
    }
}

#[test]
fn spacing_and_angle_are_exact_in_each_layer_and_lines_do_not_depend_on_the_region() {
    for layer in [0, 1, 2, 1000, 1_000_000] {
        let regions = [plate(), disc([300_000.0, 200_000.0], 700.0)];
        let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), layer, &regions);
        let (sin, cos) = (57.0 + 67.0 * f64::from(layer)).to_radians().sin_cos();
        let mut lines = 0;
        for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Hatch) {
            let across = |point: [i32; 2]| (cos * f64::from(point[1]) - sin * f64::from(point[0])) / 60.0;
            let line = across(mark.from_um).round();
            for end in [mark.from_um, mark.to_um] {
                // Rounding to whole micrometres takes up to 0.71.
                assert!((across(end) - line).abs() * 60.0 < 0.72, "layer {layer}: {mark:?}");
            }
            lines += 1;
        }
        assert!(lines > 60, "layer {layer}: {lines}");
    }
}

#[test]
fn unidirectional_hatches_run_one_way_and_stripes_are_no_longer_than_their_width() {
    let (vectors, _) = filled(&settings(STRATEGIES[1]), 0, &[plate()]);
    let (sin, cos) = 57.0_f64.to_radians().sin_cos();
    for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Hatch) {
        let along = |point: [i32; 2]| cos * f64::from(point[0]) + sin * f64::from(point[1]);
        assert!(along(mark.to_um) > along(mark.from_um), "{mark:?}");
    }
    // A remainder shorter than the shortest mark of 30 µm is added to its neighbour, at either end.
    for (strategy, longest_um) in [(STRATEGIES[2], 700.0 + 60.0), (STRATEGIES[3], 600.0)] {
        let (vectors, _) = filled(&settings(strategy), 0, &[plate()]);
        let hatches = vectors.marks().filter(|mark| mark.class == MarkClass::Hatch);
        let longest = hatches.map(|mark| far_um(mark.from_um, mark.to_um)).fold(0.0, f64::max);
        assert!(longest > 0.9 * 600.0 && longest <= longest_um + 2.0, "{strategy:?}: {longest}");
    }
}

#[test]
fn a_web_between_wide_parts_gets_a_centre_line_that_joins_their_contours() {
    let regions = [dumb_bell([2000.0, 2000.0], 400.0, 1600.0, 80.0)];
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &regions);
    assert_eq!((counts.centre_lines, counts.points, counts.unmarked), (1, 0, 0));
    for step in 0..=160 {
        let at = [2000.0 + 10.0 * f64::from(step), 2000.0];
        let mut borders = vectors.marks().filter(|mark| mark.class != MarkClass::Hatch);
        let near = borders.any(|mark| off_um(at, mark.from_um.map(f64::from), mark.to_um.map(f64::from)) <= 30.0);
        let in_discs = !(2350.0..3250.0).contains(&at[0]);
        assert!(near || in_discs, "nothing melts {at:?}");
    }
    for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Thin) {
        let off_um = [mark.from_um, mark.to_um].map(|point| (point[1] - 2000).abs());
        assert!(off_um.iter().all(|um| *um <= 6), "{mark:?} leaves the middle");
    }
}

#[test]
fn a_web_of_middle_width_gets_contours_and_no_hatches() {
    let regions = [dumb_bell([2000.0, 2000.0], 500.0, 1800.0, 200.0)];
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &regions);
    assert_eq!((counts.contours_only, counts.centre_lines), (1, 0));
    for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Hatch) {
        for x in [mark.from_um[0], mark.to_um[0]] {
            assert!(!(2560..3240).contains(&x), "{mark:?} is in the web");
        }
    }
}

#[test]
fn thin_rings_and_strips_are_marked_along_their_middle() {
    let ring = with_hole(disc([2000.0, 2000.0], 500.0), disc([2000.0, 2000.0], 420.0));
    let strip = rectangle([3000.0, 2000.0], [4000.0, 2070.0]);
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &[ring, strip]);
    assert_eq!((counts.centre_lines, counts.unmarked), (2, 0));
    let mut ends = Vec::new();
    for (class, run) in vectors.runs() {
        let (MarkClass::Thin, Run::Path(points)) = (class, run) else { panic!("{class:?} {run:?}") };
        for point in points {
            let [x, y] = point.map(f64::from);
            let radius = (x - 2000.0).hypot(y - 2000.0);
            assert!((radius - 460.0).abs() < 8.0 || (y - 2035.0).abs() < 8.0, "{point:?} is not in the middle");
        }
        ends.push([points[0], points[points.len() - 1]]);
    }
    let strips: Vec<_> = ends.iter().filter(|[a, b]| a != b).collect();
    let [[a, b]] = strips[..] else { panic!("{ends:?}") };
    // Half a beam before the border.
    let (low, high) = (a[0].min(b[0]), a[0].max(b[0]));
    assert!((low - 3030).abs() <= 10 && (high - 3970).abs() <= 10, "{ends:?}");
}

#[test]
fn however_small_a_region_is_it_is_marked() {
    let regions = [
        rectangle([1000.0, 1000.0], [1005.0, 1005.0]),
        rectangle([1100.0, 1000.0], [1101.0, 2000.0]),
        disc([1500.0, 1500.0], 30.0),
        Region { outer: vec![[2000.0, 2000.0], [2100.0, 2000.0], [2000.0, 2100.0]], holes: Vec::new() },
        rectangle([2500.0, 2500.0], [2560.0, 2560.0]),
        rectangle([3000.0, 2500.0], [3120.0, 2620.0]),
    ];
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &regions);
    assert_eq!((counts.regions, counts.unmarked), (6, 0));
    for region in &regions {
        let near = |mark: &Mark| {
            let [a, b] = [mark.from_um, mark.to_um].map(|point| point.map(f64::from));
            region.outer.iter().any(|point| off_um(*point, a, b) < 90.0)
        };
        assert!(vectors.marks().any(|mark| near(&mark)), "nothing near {region:?}");
    }
    assert!(class_count(&vectors, MarkClass::Point) >= 3);
}

#[test]
fn what_gets_no_mark_is_counted() {
    let settings = ScanSettings { contour_count: 0, hatch: None, ..settings(HatchStrategy::Zigzag) };
    let (vectors, counts) = filled(&settings, 0, &[disc([1000.0, 1000.0], 500.0), disc([3000.0, 1000.0], 50.0)]);
    assert_eq!((counts.regions, counts.unmarked, vectors.mark_count()), (2, 1, 1));
}

#[test]
fn short_hatches_are_counted() {
    let long = ScanSettings { shortest_mark_um: 300.0, ..settings(HatchStrategy::Zigzag) };
    let (vectors, counts) = filled(&long, 0, &[disc([2000.0, 2000.0], 400.0)]);
    assert!(counts.dropped_hatches > 0);
    let lines = counts.dropped_hatches + class_count(&vectors, MarkClass::Hatch) as u64;
    assert!((11..=13).contains(&lines), "{lines} lines in 710 µm");
    let hatch = settings(HatchStrategy::Stripes { width_um: 500.0, overlap_um: 20.0 }).hatch;
    let (_, counts) = filled(&ScanSettings { hatch, ..long }, 0, &[plate()]);
    assert!(counts.merged_hatches > 0, "{counts:?}");
}

#[test]
fn skins_have_their_own_class_lines_and_place() {
    let of = |strategy, spacing_um| HatchSettings { spacing_um, ..settings(strategy).hatch.expect("hatches") };
    let both = ScanSettings {
        up_skin: Some(of(HatchStrategy::Unidirectional, 50.0)),
        down_skin: Some(of(HatchStrategy::Zigzag, 40.0)),
        ..settings(HatchStrategy::Zigzag)
    };
    let region = [rectangle([1000.0, 1000.0], [4000.0, 3000.0])];
    let above = [rectangle([0.0, 0.0], [2000.0, 9000.0])];
    let below = [rectangle([3000.0, 0.0], [9000.0, 9000.0]), rectangle([900.0, 0.0], [2500.0, 9000.0])];
    let mut fill = Fill::new(both, 1, &budget()).expect("good settings");
    let mut vectors = Vectors::default();
    fill.layer(0, &region, Some(&above), Some(&below), &mut vectors).expect("it fits");
    for mark in vectors.marks() {
        for x in [mark.from_um[0], mark.to_um[0]] {
            let good = match mark.class {
                MarkClass::DownSkin => (2498..=3002).contains(&x),
                MarkClass::UpSkin => (1998..=2502).contains(&x) || x >= 2998,
                MarkClass::Hatch => x <= 2002,
                _ => true,
            };
            assert!(good, "{mark:?}");
        }
    }
    for class in [MarkClass::DownSkin, MarkClass::UpSkin, MarkClass::Hatch] {
        assert!(class_count(&vectors, class) > 5, "{class:?}");
    }
    // The first layer has nothing below, the last nothing above. Of rounded corners some may remain.
    let mut share = |above, below, class| {
        vectors.clear();
        fill.layer(0, &region, above, below, &mut vectors).expect("it fits");
        let contours = class_count(&vectors, MarkClass::Contour) as u64;
        class_count(&vectors, class) as f64 / (vectors.mark_count() - contours) as f64
    };
    assert!(share(Some(&region[..]), None, MarkClass::DownSkin) > 0.95);
    assert!(share(None, Some(&region[..]), MarkClass::UpSkin) > 0.95);
    assert_eq!(share(Some(&region[..]), Some(&region[..]), MarkClass::Hatch), 1.0);
}

#[test]
fn a_layer_outside_every_field_and_bad_settings_are_refused() {
    let mut fill = Fill::new(settings(HatchStrategy::Zigzag), 1, &budget()).expect("good settings");
    for at_um in [-1.0, 1_000_001.0, f64::NAN, f64::INFINITY] {
        let mut region = disc([1000.0, 1000.0], 500.0);
        region.outer[3][1] = at_um;
        let refused = fill.layer(0, &[region], None, None, &mut Vectors::default());
        assert!(matches!(refused, Err(FillError::OutsideField { .. })), "{at_um}: {refused:?}");
    }
    let bad = ScanSettings { beam_diameter_um: 0.0, ..settings(HatchStrategy::Zigzag) };
    assert!(matches!(Fill::new(bad, 1, &budget()), Err(FillError::Settings(_))));
}

#[test]
fn memory_is_charged_and_a_layer_that_does_not_fit_is_refused() {
    let fine = HatchSettings { spacing_um: 5.0, ..settings(STRATEGIES[3]).hatch.expect("hatches") };
    let many = ScanSettings { contour_count: 8, contour_spacing_um: 20.0, ..settings(STRATEGIES[0]) };
    for (settings, regions) in [
        (settings(STRATEGIES[0]), islands(300, 40.0, 400.0, 3)),
        (ScanSettings { hatch: Some(fine), ..settings(STRATEGIES[3]) }, vec![plate()]),
        (many, islands(100, 100.0, 900.0, 5)),
    ] {
        let budget = budget();
        let mut fill = Fill::new(settings.clone(), 2, &budget).expect("good settings");
        let mut vectors = Vectors::default();
        fill.layer(7, &regions, None, None, &mut vectors).expect("it fits");
        // As found and in order.
        let need_bytes = budget.used_bytes();
        assert!(need_bytes >= 2 * vectors.memory_bytes() as u64, "{need_bytes}");
        drop(fill);
        assert_eq!(budget.used_bytes(), 0);

        let small = MemoryBudget::new(need_bytes - 1);
        let mut fill = Fill::new(settings, 2, &small).expect("good settings");
        let refused = fill.layer(7, &regions, None, None, &mut Vectors::default()).expect_err("too complex");
        let FillError::Slice(SliceError::TooComplex { layer: 7, exceeded }) = &refused else { panic!("{refused}") };
        assert_eq!((exceeded.need_bytes, small.used_bytes()), (need_bytes, 0));
        assert!(
            refused.to_string().starts_with("layer 7 is too complex: filling the layer with vectors takes"),
            "{refused}"
        );
        fill.layer(8, &regions[..0], None, None, &mut Vectors::default()).expect("nothing fits");
    }
}

#[test]
fn layers_of_very_many_pieces_are_ordered_in_parts_and_each_piece_is_marked_once() {
    let at = |number: u32| [f64::from(number % 300) * 100.0 + 50.0, f64::from(number / 300) * 100.0 + 50.0];
    let regions: Vec<Region> =
        (0..66_000).map(|number| rectangle(at(number), at(number).map(|low| low + 4.0))).collect();
    let (vectors, counts) = filled(&settings(STRATEGIES[0]), 0, &regions);
    assert_eq!((counts.points, counts.unmarked), (66_000, 0));
    let mut found: Vec<[i32; 2]> = vectors.marks().map(|mark| mark.from_um).collect();
    found.sort_unstable();
    found.dedup();
    assert_eq!(found.len(), 66_000);
    // From one to the next, nearly everywhere.
    assert!(counts.jump_um < 1.2 * 66_000.0 * 100.0, "{}", counts.jump_um);
}

#[test]
fn threads_and_layers_before_change_nothing() {
    let regions = islands(300, 40.0, 400.0, 3);
    let (expected, counts) = filled(&settings(STRATEGIES[2]), 5, &regions);
    for threads in [1, 2, 3] {
        let mut fill = Fill::new(settings(STRATEGIES[2]), threads, &budget()).expect("good settings");
        let mut vectors = Vectors::default();
        fill.layer(4, &regions[..100], None, None, &mut vectors).expect("it fits");
        vectors.clear();
        assert_eq!(fill.layer(5, &regions, None, None, &mut vectors).expect("it fits"), counts);
        assert_eq!(vectors, expected);
    }
}

/// Length of the jumps if the laser goes to the nearest run that is left, by any of its ends; a ring by any of its points.
fn greedy_jump_um(vectors: &Vectors) -> f64 {
    let mut left: Vec<Vec<[[i32; 2]; 2]>> = vectors.runs().map(|(_, run)| ways(&run)).collect();
    let mut inner_um = 0.0;
    for (_, run) in vectors.runs() {
        if let Run::Hatches(frame, lines) = run {
            for pair in lines.windows(2) {
                let [leave, enter] = [(pair[0].line, pair[0].to_um), (pair[1].line, pair[1].from_um)];
                inner_um += far_um(frame.point_um(leave.0, leave.1), frame.point_um(enter.0, enter.1));
            }
        }
    }
    let mut at = [0, 0];
    let mut jump_um = 0.0;
    for number in 0..left.len() {
        let of = |(run, ways): (usize, &Vec<[[i32; 2]; 2]>)| {
            let best = ways.iter().map(|way| (far_um(at, way[0]), way[1])).min_by(|a, b| a.0.total_cmp(&b.0));
            best.map(|(far_um, to)| (far_um, run, to))
        };
        let best = left.iter().enumerate().filter_map(of).min_by(|a, b| a.0.total_cmp(&b.0));
        let (far_um, run, to) = best.expect("a run is left");
        jump_um += if number == 0 { 0.0 } else { far_um };
        at = to;
        left.swap_remove(run);
    }
    jump_um + inner_um
}

fn ways(run: &Run<'_>) -> Vec<[[i32; 2]; 2]> {
    match run {
        Run::Path(points) if points.first() == points.last() => points.iter().map(|point| [*point; 2]).collect(),
        Run::Path(points) => vec![[points[0], points[points.len() - 1]], [points[points.len() - 1], points[0]]],
        Run::Hatches(frame, lines) => {
            let ends = |of: layerd::layer::HatchLine| [of.from_um, of.to_um].map(|um| frame.point_um(of.line, um));
            let ([a, b], [c, d]) = (ends(lines[0]), ends(lines[lines.len() - 1]));
            // As marked, with all directions changed, and both backwards.
            vec![[a, d], [b, c], [d, a], [c, b]]
        }
    }
}

fn far_um(a: [i32; 2], b: [i32; 2]) -> f64 {
    (f64::from(a[0]) - f64::from(b[0])).hypot(f64::from(a[1]) - f64::from(b[1]))
}

#[test]
fn jumps_are_shorter_than_greedy_ones() {
    for (seed, count) in [(1, 645), (2, 200)] {
        let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &islands(count, 40.0, 400.0, seed));
        let greedy_um = greedy_jump_um(&vectors);
        assert!(counts.jump_um <= greedy_um, "{} µm instead of {greedy_um}", counts.jump_um);
        assert!(counts.jump_um < counts.unordered_jump_um);
    }
}

proptest! {
    #![proptest_config(cases(16))]

    #[test]
    fn stars_are_marked_inside(
        radii_um in prop::collection::vec(40.0..1500.0_f64, 5..24),
        layer in 0_u32..100,
        strategy in prop::sample::select(&STRATEGIES[..]),
    ) {
        let regions = [star([5000.0, 5000.0], &radii_um)];
        let (vectors, counts) = filled(&settings(strategy), layer, &regions);
        prop_assert_eq!((counts.regions, counts.unmarked), (1, 0));
        assert_hatches_inside(&vectors, &regions, 45.0);
        for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Contour) {
            let depth = depth_um(&regions, mark.from_um.map(f64::from));
            // Arcs and rounding take up to 2 µm.
            prop_assert!(depth >= 28.0, "{:?} is {} µm inside", mark, depth);
        }
        prop_assert_eq!(filled(&settings(strategy), layer, &regions), (vectors, counts));
    }

    #[test]
    fn rings_are_covered(outer_um in 400.0..1200.0_f64, wall in 0.3..0.9_f64, layer in 0_u32..9) {
        prop_assume!(outer_um * wall > 300.0);
        let centre = [2500.0, 2500.0];
        let regions = [with_hole(disc(centre, outer_um), disc(centre, outer_um * (1.0 - wall)))];
        let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), layer, &regions);
        let Melted { covered, spilled } = melted(&vectors, &regions, 60.0);
        prop_assert!(covered > 0.985 && spilled < 0.005, "{} covered, {} spilled", covered, spilled);
    }
}
