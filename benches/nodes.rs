//! Soap-film nodes: time, deviation and bending, beside the figures of Luo & Zou 2025. `cargo bench --bench nodes`
//!
//! Times are processor time of one thread for a node, from directions to the mesh, with buffers that serve again; of several passes the
//! fastest counts. Deviation is the distance to cylinders and ball at level 3, and bending is ∫H² there.

mod cpu_time;
#[path = "../tests/node_shapes/mod.rs"]
mod node_shapes;

use std::time::Duration;

use cpu_time::cpu_time;
use layerd::solid::soap::{FilmBuilder, FilmMesh, Level, Node};
use node_shapes::{Random, ends, measure, node, regular};

/// Meshes of a pass, and passes.
const MESHES: u32 = 50;
const PASSES: u32 = 10;

/// Mean and greatest deviation in the paper's Table 1, regular and irregular nodes; theirs are other irregular nodes.
const PAPER: [[f64; 2]; 6] =
    [[0.0647, 0.2846], [0.0645, 0.3021], [0.1009, 0.6653], [0.1643, 1.1082], [0.1442, 0.9762], [0.1681, 1.3798]];

fn main() {
    println!(
        "{:<14} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9} {:>17} {:>17} {:>8} {:>8}",
        "node", "outline", "ms, 0", "1", "2", "3", "fairing", "triangles", "mean/max", "paper", "∫H²", "unfaired"
    );
    let regular = [6, 12, 20].map(|count| (format!("regular {count}"), regular(count)));
    let irregular =
        [6, 12, 20].map(|count| (format!("irregular {count}"), Random(count as u64).directions(count, 25.0)));
    for ((name, directions), paper) in regular.into_iter().chain(irregular).zip(PAPER) {
        print_row(&name, &directions, paper);
    }
}

fn print_row(name: &str, directions: &[[f64; 3]], paper: [f64; 2]) {
    let ends = ends(directions);
    let node = node(&ends);
    let (mut builder, mut mesh) = (FilmBuilder::new(), FilmMesh::default());
    let outline = fastest(|| drop(builder.outline(&node).expect("a film")));
    let levels = [0, 1, 2, 3].map(|steps| Level::new(steps).expect("a level"));
    let times = levels.map(|level| fastest(|| builder.mesh(&node, level, &mut mesh).expect("a film")));
    let unfaired = fastest(|| builder.unfaired_mesh(&node, levels[0], &mut mesh).expect("a film"));
    let bent = bending_of(&mut builder, &node, &mut mesh);
    builder.mesh(&node, levels[3], &mut mesh).expect("a film");
    let [mean, most] = measure::deviations(&mesh, directions);
    let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
    let [level_0, level_1, level_2, level_3] = times.map(milliseconds);
    println!(
        "{name:<14} {:>8.3} {level_0:>8.3} {level_1:>8.3} {level_2:>8.3} {level_3:>8.3} {:>8.3} {:>9} {mean:>8.4}/{most:<8.4} {:>8.4}/{:<8.4} {:>8.1} {bent:>8.1}",
        milliseconds(outline),
        level_0 - milliseconds(unfaired),
        builder.outline(&node).expect("a film").size(levels[1])[1],
        paper[0],
        paper[1],
        measure::bending(&mesh),
    );
}

/// ∫H² without fairing.
fn bending_of(builder: &mut FilmBuilder, node: &Node<'_>, mesh: &mut FilmMesh) -> f64 {
    builder.unfaired_mesh(node, Level::FINEST_NEEDED, mesh).expect("a film");
    measure::bending(mesh)
}

/// Processor time of one call.
fn fastest(mut call: impl FnMut()) -> Duration {
    let pass = |_| {
        let begun = cpu_time();
        (0..MESHES).for_each(|_| call());
        (cpu_time() - begun) / MESHES
    };
    (0..PASSES).map(pass).min().expect("a pass")
}
