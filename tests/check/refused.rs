//! What is refused, with a remedy, on a terminal and as JSON.

use std::fs;

use serde_json::Value;

use crate::support::layerctl;
use crate::{bench, check, json, slice, stderr};

#[test]
fn names_in_files_do_not_reach_the_terminal_as_commands() {
    let dir = bench("", &[]);
    fs::copy(dir.path().join("part.txt"), dir.path().join("\u{1b}[31m\nred.txt")).expect("copied");
    assert!(layerctl(dir.path(), &["pack", "\u{1b}[31m\nred.txt", "-o", "part.layerd"]).status.success());
    let told = layerctl(dir.path(), &["info", "part.layerd"]).stdout;
    assert!(!told.contains(&0x1b) && String::from_utf8_lossy(&told).contains("[31m red.txt"), "{told:?}");
    let told = layerctl(dir.path(), &["info", "\u{1b}[2J.layerd"]).stderr;
    assert!(!told.contains(&0x1b) && !told.is_empty(), "{told:?}");
}

#[test]
fn a_part_that_does_not_fit_the_machine_is_told_as_json_too() {
    let dir = bench("", &["--scale", "3"]);
    let output = check(dir.path(), &["--json"]);
    let found = json(&output);
    assert_eq!((output.status.code(), &found["fits"]), (Some(1), &Value::from(false)));
    let problem = found["problems"][0].as_str().expect("a problem");
    assert!(problem.contains("--scale") && stderr(&output).contains(problem), "{problem}\n{}", stderr(&output));
    let sliced = slice(dir.path(), &["-o", "layers"]);
    assert_eq!(sliced.status.code(), Some(1));
    assert!(stderr(&sliced).contains(problem) && !dir.path().join("layers").exists(), "{}", stderr(&sliced));
}

#[test]
fn what_is_wrong_is_named_with_a_remedy() {
    let dir = bench("", &[]);
    fs::write(dir.path().join("a-file"), "in the way").expect("written");
    let recipes = concat!(env!("CARGO_MANIFEST_DIR"), "/config/recipes/default.toml");
    fs::create_dir_all(dir.path().join("config/recipes")).expect("made");
    fs::copy(recipes, dir.path().join("config/recipes/default.toml")).expect("copied");
    let cases: [(&[&str], i32, &[&str]); 9] = [
        (
            &["slice", "part.layerd", "-m", "nowhere", "-o", "x"],
            1,
            &["no machine named `nowhere`", "/etc/layerd/machines"],
        ),
        (
            &["slice", "part.layerd", "-m", "machine.toml", "-r", "thin", "-o", "x"],
            1,
            &["no recipe named `thin`", "known are default"],
        ),
        (&["check", "part.layerd", "-m", "gone.toml"], 1, &["cannot read gone.toml", "No such file"]),
        (&["check", "gone.layerd", "-m", "machine.toml"], 1, &["gone.layerd", "No such file"]),
        (&["check", "part.txt", "-m", "machine.toml"], 1, &["part.txt", "pack"]),
        (&["slice", "part.layerd", "-m", "machine.toml", "--layers", "80..100", "-o", "x"], 1, &["80..100", "0..90"]),
        (
            &["slice", "part.layerd", "-m", "machine.toml", "--layers", "7..3", "-o", "x"],
            2,
            &["7..3", "holds no layer"],
        ),
        (&["slice", "part.layerd", "-m", "machine.toml", "-o", "a-file"], 1, &["a-file is a file", "directory"]),
        (
            &["slice", "part.layerd", "-m", "machine.toml", "--threads", "0", "-o", "x"],
            2,
            &["--threads", "0 is not in 1..=256"],
        ),
    ];
    for (arguments, code, words) in cases {
        let output = layerctl(dir.path(), arguments);
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {told}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
        for word in words {
            assert!(told.contains(word), "{arguments:?}: `{word}` is missing in: {told}");
        }
    }
}

#[test]
fn a_turn_is_proposed_only_where_the_part_then_fits() {
    // The machine takes 38.4 × 21.6 × 100 mm.
    let cases = [
        ([20.0, 30.0, 10.0], Some("0,0,90")),
        ([30.0, 60.0, 10.0], Some("90,0,0")),
        ([60.0, 20.0, 10.0], Some("0,90,0")),
        ([20.0, 60.0, 30.0], Some("90,0,90")),
        ([60.0, 30.0, 20.0], Some("90,90,0")),
        ([120.0, 30.0, 30.0], None),
    ];
    let dir = tempfile::tempdir().expect("a directory");
    for (size, turn) in cases {
        let [x, y, z] = size.map(|edge: f64| edge - 1.0);
        let text = format!("3 0.5\n0 0 0 {x} 0 0\n0 0 0 0 {y} 0\n0 0 0 0 0 {z}\n");
        fs::write(dir.path().join("axes.txt"), text).expect("written");
        let pack = |rotate: &str| {
            let output = layerctl(
                dir.path(),
                &["pack", "axes.txt", "--joint", "union", "--rotate", rotate, "-o", "axes.layerd"],
            );
            assert!(output.status.success(), "{}", stderr(&output));
            layerctl(dir.path(), &["check", "axes.layerd", "-m", "sim-dlp"])
        };
        let refused = pack("0,0,0");
        let told = stderr(&refused);
        assert_eq!(refused.status.code(), Some(1), "{told}");
        match turn {
            Some(turn) => {
                assert!(told.contains(&format!("pack it with `--rotate {turn}`")), "{size:?}: {told}");
                let turned = pack(turn);
                assert!(turned.status.success(), "{size:?} turned by {turn}: {}", stderr(&turned));
            }
            None => assert!(told.contains("--scale") && !told.contains("--rotate"), "{size:?}: {told}"),
        }
    }
}

#[test]
fn a_part_of_several_materials_is_refused_by_a_machine_that_prints_one() {
    let dir = bench("", &[]);
    let part = "2 0.5 0 0\n0 0 0 2 2 4 0.5 soft\n2 2 4 4 0 8 0.5 rigid\n";
    fs::write(dir.path().join("two.txt"), part).expect("written");
    assert!(layerctl(dir.path(), &["pack", "two.txt", "-o", "part.layerd"]).status.success());
    let output = check(dir.path(), &["--json"]);
    let problem = json(&output)["problems"][0].as_str().expect("a problem").to_owned();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        problem.contains("2 materials (rigid, soft)") && problem.contains("--materials 'rigid=rigid,soft=rigid'"),
        "{problem}"
    );
    let together = ["pack", "two.txt", "--materials", "rigid=rigid,soft=rigid", "-o", "part.layerd"];
    assert!(layerctl(dir.path(), &together).status.success());
    let fits = check(dir.path(), &["--json"]);
    assert!(fits.status.success(), "{}", stderr(&fits));
}
