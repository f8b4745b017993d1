//! Whether a part holds to the plate and prints well: where it stands, what may be missing, and what does not peel.

use std::fs;

use serde_json::Value;

use crate::support::{Bench, Setup, layerctl};
use crate::{bench, check, json, stderr};

/// A lone strut's end prints shorter than its bounds: the part stands on where its field reaches the isovalue.
#[test]
fn a_convolution_stands_on_its_lowest_solid_point() {
    let dir = bench("", &[]);
    fs::write(dir.path().join("part.txt"), "1 0.9\n2 2 0 2 2 6\n").expect("written");
    for joint in ["convolution", "union"] {
        assert!(layerctl(dir.path(), &["pack", "part.txt", "--joint", joint, "-o", "part.layerd"]).status.success());
        let checked = check(dir.path(), &["--json"]);
        assert!(checked.status.success(), "{joint}: {}", stderr(&checked));
        assert_eq!(json(&checked)["dark_bottom_layers"], 0, "{joint}");
    }
}

#[test]
fn thin_struts_and_a_recipe_without_a_lift_are_warned_of() {
    let dir = bench("", &[]);
    // 40 µm thick, less than a pixel of 60 µm and a layer of 100 µm.
    fs::write(dir.path().join("part.txt"), "2 0.4\n0 0 0 0 0 2\n0 0 1.9 3 0 1.9 0.02\n").expect("written");
    assert!(layerctl(dir.path(), &["pack", "part.txt", "--joint", "union", "-o", "part.layerd"]).status.success());
    let recipe = fs::read_to_string(dir.path().join("recipe.toml")).expect("a recipe");
    fs::write(dir.path().join("recipe.toml"), recipe.replace("lift_height_um = 3000", "lift_height_um = 0"))
        .expect("flat");
    let checked = check(dir.path(), &["--json"]);
    let found = json(&checked);
    assert_eq!((checked.status.code(), &found["fits"]), (Some(0), &Value::from(true)), "{found}");
    let told = check(dir.path(), &[]);
    let text = String::from_utf8_lossy(&told.stdout).into_owned();
    assert_eq!(told.status.code(), Some(0), "{text}");
    let problems: Vec<&str> = found["problems"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    for words in [
        "the thinnest strut is 40.0 µm thick, 0.67 pixels",
        "a layer 100 µm: flat struts thinner than a layer may be missing",
        "lift_height_um = 0 does not peel",
    ] {
        assert!(problems.iter().any(|problem| problem.contains(words)), "`{words}` is not in {found}");
        assert!(text.lines().any(|line| line.starts_with("note ") && line.contains(words)), "`{words}`: {text}");
    }
    assert!(text.contains("verdict         fits, but read the notes; "), "{text}");
}

/// A ball on a spike of 2 µm that no pixel shows.
const ON_A_SPIKE: &str = "2 0.001\n0 0 0 0 0 2\n0 0 2 0 0 2.1 0.5\n";

#[test]
fn a_part_that_begins_dark_is_refused() {
    let dir = bench("", &[]);
    fs::write(dir.path().join("part.txt"), ON_A_SPIKE).expect("written");
    assert!(layerctl(dir.path(), &["pack", "part.txt", "--joint", "union", "-o", "part.layerd"]).status.success());
    let refused = check(dir.path(), &["--json"]);
    let found = json(&refused);
    assert_eq!((refused.status.code(), &found["fits"]), (Some(1), &Value::from(false)), "{found}");
    // From 1 µm below 0 to 1.5 mm, in layers of 0.1 mm.
    assert_eq!(found["dark_bottom_layers"], 15);
    let problem = found["problems"][0].as_str().expect("a problem");
    assert!(problem.contains("the lowest 15 layers are dark") && problem.contains("--rotate"), "{problem}");
    assert!(stderr(&refused).contains(problem), "{}", stderr(&refused));
    let told = check(dir.path(), &[]);
    assert!(String::from_utf8_lossy(&told.stdout).contains("would not hold to the plate"), "{told:?}");
    // Too short for its support: nothing of it is solid.
    fs::write(dir.path().join("part.txt"), "1 0.9\n2 2 0 2 2 0.05\n").expect("written");
    assert!(layerctl(dir.path(), &["pack", "part.txt", "-o", "part.layerd"]).status.success());
    let refused = check(dir.path(), &[]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("all layers are dark"), "{}", stderr(&refused));
}

#[test]
fn the_daemon_prints_onto_nothing_neither_when_asked_nor_when_the_jobs_turn_comes() {
    let bench = Bench::start(Setup { time_scale: 100, ..Setup::default() });
    fs::write(bench.path("spike.txt"), ON_A_SPIKE).expect("written");
    bench.ok(&["pack", "spike.txt", "--joint", "union", "-o", "spike.layerd"]);
    let refused = bench.layerctl(&["start", "spike.layerd"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("the lowest 15 layers are dark"), "{}", stderr(&refused));
    // Behind another job there is no memory to look at it at once.
    bench.ok(&["generate", "bcc", "--struts", "40", "--box", "4,4,4", "--radius", "0.3", "-o", "good.layerd"]);
    let good = bench.start_job("good.layerd");
    let loose = bench.start_job("spike.layerd");
    assert_eq!(bench.wait_for(good, &["completed", "failed", "interrupted"])["state"], "completed");
    let job = bench.wait_for(loose, &["completed", "failed", "interrupted"]);
    assert_eq!((&job["state"], &job["layers_done"]), (&"failed".into(), &0.into()), "{job}");
    assert!(job["reason"].as_str().is_some_and(|why| why.contains("the lowest 15 layers are dark")), "{job}");
    let layers = bench.job(good)["layers_total"].as_u64().expect("layers_total");
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>(), "not a layer of the second");
}
