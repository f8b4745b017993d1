//! How far nodes are from cylinders and ball, and how much they are bent, against figures.

use crate::mesh;
use crate::node_shapes::measure::{bending, deviations};
use crate::node_shapes::{Random, regular};

/// Of a prototype with the same choices: mean and greatest deviation at level 3. Greater by 1 %, for its mean was taken in another way.
const PROTOTYPE: [(usize, [f64; 2]); 3] = [(6, [0.0073, 0.104]), (12, [0.0082, 0.141]), (20, [0.0289, 0.419])];

/// Luo & Zou 2025, Table 1.
const PAPER: [(usize, [f64; 2]); 3] = [(6, [0.0647, 0.2846]), (12, [0.0645, 0.3021]), (20, [0.1009, 0.6653])];

/// ∫H². With the diagonals and without a hold, as the paper has it, it is 96, 169 and 384. Without a hold alone it would be 53, 106 and
/// 227, at 10 to 40 % more deviation.
const BENDING: [(usize, f64); 3] = [(6, 62.0), (12, 133.5), (20, 270.0)];

#[test]
fn regular_nodes_are_as_near_to_the_struts_as_figures_say() {
    for ((count, prototype), (_, paper)) in PROTOTYPE.into_iter().zip(PAPER) {
        let found = deviations(&mesh(&regular(count), 3), &regular(count));
        for at in 0..2 {
            assert!(found[at] <= prototype[at] && found[at] < paper[at], "{count} struts: {found:?}");
        }
    }
}

#[test]
fn regular_nodes_are_as_fair_as_figures_say() {
    for (count, most) in BENDING {
        let found = bending(&mesh(&regular(count), 3));
        assert!(found <= most, "{count} struts: {found}");
    }
}

/// The paper's own irregular nodes are not known; it has 0.16, 0.14 and 0.17 for them.
#[test]
fn irregular_nodes_are_near_to_the_struts() {
    for count in [6, 12, 20] {
        for seed in 0..5 {
            let directions = Random(seed).directions(count, 25.0);
            let [mean, _] = deviations(&mesh(&directions, 3), &directions);
            assert!(mean < 0.05, "{count} struts, seed {seed}: {mean}");
        }
    }
}
