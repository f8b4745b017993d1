//! In which order a layer is marked: short jumps, each piece once, the same on any number of threads.

use layerd::layer::{Run, Vectors};
use layerd::slice::scan::{Fill, FillError, HatchStrategy, Neighbours, Region};

use crate::measure::far_um;
use crate::scan_samples::{islands, rectangle, settings};
use crate::{STRATEGIES, budget, filled};

#[test]
fn layers_of_very_many_pieces_are_ordered_in_groups_and_each_piece_is_marked_once() {
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
        fill.layer(4, &regions[..100], Neighbours::default(), &mut vectors).expect("it fits");
        vectors.clear();
        assert_eq!(fill.layer(5, &regions, Neighbours::default(), &mut vectors).expect("it fits"), counts);
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

#[test]
fn groups_of_regions_and_boxes_of_a_large_region_jump_little_more_than_greedy() {
    // Several groups, and one region with so many pieces that it is put in order box by box.
    let plate = rectangle([100.0, 100.0], [36_100.0, 36_100.0]);
    let chessboard = HatchStrategy::Chessboard { island_um: 300.0, overlap_um: 10.0 };
    for (strategy, regions) in [(STRATEGIES[0], islands(4500, 40.0, 400.0, 9)), (chessboard, vec![plate])] {
        let mut fill = Fill::new(settings(strategy), 1, &budget()).expect("good settings");
        let (mut vectors, mut groups) = (Vectors::default(), 0);
        let take = |group: &Vectors| {
            groups += 1;
            vectors.append(group);
            Ok::<(), FillError>(())
        };
        let counts = fill.groups(0, &regions, Neighbours::default(), take).expect("it fits");
        assert!(groups > 1, "{groups}");
        let greedy_um = greedy_jump_um(&vectors);
        assert!(counts.jump_um <= 1.05 * greedy_um, "{} µm instead of {greedy_um}", counts.jump_um);
        let mut at: Option<[i32; 2]> = None;
        let jumps = vectors.marks().map(|mark| {
            let jump_um = at.map_or(0.0, |at| far_um(at, mark.from_um));
            at = Some(mark.to_um);
            jump_um
        });
        assert!((jumps.sum::<f64>() - counts.jump_um).abs() < 1.0, "jumps between groups count");
    }
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
