//! Every configuration file that is shipped loads; every mistake in one is told with file, key, value and range.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

use std::path::{Path, PathBuf};

use layerd::config::{DaemonConfig, Machine, Recipe, load_pair};
use layerd::layer::MarkClass;
use layerd::pipeline::Scan;

fn shipped(directory: &str) -> Vec<PathBuf> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(directory);
    let files = std::fs::read_dir(&directory).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|extension| extension == "toml")).collect()
}

#[test]
fn every_shipped_file_loads() {
    let machines = shipped("machines");
    assert!(machines.len() >= 3);
    for path in machines {
        Machine::load(&path).unwrap();
    }
    let recipes = shipped("recipes");
    assert!(recipes.len() >= 3);
    for path in recipes {
        Recipe::load(&path).unwrap();
    }
    let daemon = DaemonConfig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/layerd.toml")).unwrap();
    assert!(daemon.machine.is_file() && daemon.recipe.is_file(), "what it names is shipped as well");
}

/// Recipe files from before recipes had a kind are for DLP machines.
#[test]
fn a_recipe_may_name_its_kind_and_is_for_dlp_machines_if_it_does_not() {
    let parse = |text: &str| Recipe::parse(Path::new("my.toml"), text);
    let text = recipe_with("name = \"mine\"");
    assert!(!text.lines().any(|line| line.starts_with("kind")));
    let plain = parse(&text).unwrap();
    assert_eq!(parse(&format!("kind = \"dlp\"\n{text}")).unwrap(), plain);
    let unknown = parse(&format!("kind = \"fdm\"\n{text}")).unwrap_err().to_string();
    for word in ["my.toml", "line 1, column 8", "unknown kind `fdm`, expected `dlp` or `slm`"] {
        assert!(unknown.contains(word), "{unknown}");
    }
}

#[test]
fn a_recipe_for_another_kind_of_machine_is_told_with_both_files() {
    let directory = tempfile::tempdir().unwrap();
    let [machine, recipe] = ["vat.toml", "laser.toml"].map(|name| directory.path().join(name));
    let sim_dlp = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/machines/sim-dlp.toml");
    std::fs::copy(sim_dlp, &machine).unwrap();
    std::fs::write(&recipe, "kind = \"slm\"\nlaser_power_w = 200.0\n").unwrap();
    let message = load_pair(&machine, &recipe).unwrap_err().to_string();
    for word in ["vat.toml", "laser.toml", "`dlp`", "`slm`"] {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    std::fs::write(&recipe, recipe_with("exposure_ms = 7")).unwrap();
    let (_, Recipe::Dlp(recipe)) = load_pair(&machine, &recipe).unwrap() else { panic!("a recipe for DLP machines") };
    assert_eq!(recipe.exposure_ms, 7);
}

/// The default recipe with one line changed.
fn recipe_with(line: &str) -> String {
    let text =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/recipes/default.toml")).unwrap();
    let key = line.split('=').next().unwrap().trim();
    let kept = text.lines().filter(|old| old.split('=').next().unwrap().trim() != key);
    kept.chain([line]).collect::<Vec<_>>().join("\n")
}

#[test]
fn mistakes_in_a_recipe_are_told_with_file_key_value_and_range() {
    let cases = [
        ("exposure_ms = 600001", ["exposure_ms", "600001", "1 to 600000"]),
        ("exposure_ms = 0", ["exposure_ms", "0", "1 to 600000"]),
        ("layer_height_um = nan", ["layer_height_um", "NaN", "1 to 1000"]),
        ("layer_height_um = -5.0", ["layer_height_um", "-5", "1 to 1000"]),
        ("light_pwm = 0", ["light_pwm", "0", "1 to 255"]),
        ("lift_speed_um_s = 1", ["lift_speed_um_s", "1", "10 to 1000000"]),
        ("light_pwm = 256", ["light_pwm", "256", "1 to 255"]),
        ("exposure_ms = -1", ["exposure_ms", "-1", "from 0 to"]),
        ("exposure_ms = \"2 s\"", ["exposure_ms", "2 s", "whole number"]),
        ("exposure_seconds = 2", ["exposure_seconds", "unknown field", "exposure_ms"]),
    ];
    for (line, words) in cases {
        let message = Recipe::parse(Path::new("my.toml"), &recipe_with(line)).unwrap_err().to_string();
        for word in words.iter().chain(&["my.toml"]) {
            assert!(message.contains(word), "{line}: `{word}` is not in: {message}");
        }
    }
    let message = Recipe::parse(Path::new("my.toml"), "name = \"x\"").unwrap_err().to_string();
    assert!(message.contains("missing field `layer_height_um`"), "{message}");
}

#[test]
fn mistakes_in_machine_and_daemon_files_are_told() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("m.toml");
    let sim_dlp = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/machines/sim-dlp.toml");
    let machine = std::fs::read_to_string(sim_dlp).unwrap();
    let cases = [
        (machine.replace("baud = ", "baud = 1 # "), vec!["m.toml", "link.baud", "= 1:", "9600 to 12000000"]),
        (machine.replace("width_px = ", "width_px = 9 # "), vec!["m.toml", "width_px", "= 9:", "16 to 32768"]),
        (machine.replace("baud", "bauds"), vec!["m.toml", "bauds", "unknown field"]),
        (
            machine.replace("\"dlp\"", "\"fdm\""),
            vec!["m.toml", "line 4, column 8", "unknown kind `fdm`, expected `dlp`"],
        ),
        (machine.replace("kind = ", "# kind = "), vec!["m.toml", "missing field `kind`"]),
        (String::new(), vec!["m.toml", "missing field `kind`", "kind = \"dlp\""]),
        (
            format!("kind = 7\n{}", machine.replace("kind = ", "# kind = ")),
            vec!["m.toml", "line 1, column 8", "expected a kind in quotes, as in `kind = \"dlp\"`"],
        ),
        (machine.replace("\"dlp\"", "\"slm\""), vec!["m.toml", "clear_height_um", "unknown field", "field_um"]),
        (
            machine.replace("pixel_um = ", "pixel_um = [0.5, 40.0] # "),
            vec!["m.toml", "pixel_um[0]", "0.5", "1 to 1000"],
        ),
        (machine.replace("clear_height_um", "clear_um"), vec!["m.toml", "clear_um", "unknown field"]),
        (machine.replace("[link]", "[mirror]\nz = true\n[link]"), vec!["m.toml", "`z`", "unknown field"]),
        (format!("time_scale = 0.5\n{machine}"), vec!["m.toml", "time_scale", "0.5", "1 to 1000"]),
        (machine.replace("\"none\"", "\"ack\""), vec!["m.toml", "ack", "rts_cts", "xon_xoff"]),
    ];
    for (text, words) in cases {
        std::fs::write(&path, text).unwrap();
        let message = Machine::load(&path).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "`{word}` is not in: {message}");
        }
    }
    std::fs::write(&path, "memory_budget = \"64 parsecs\"\nmachine = \"m\"\nrecipe = \"r\"\n").unwrap();
    let message = DaemonConfig::load(&path).unwrap_err().to_string();
    assert!(message.contains("m.toml") && message.contains("64 parsecs") && message.contains("64MiB"), "{message}");
    std::fs::write(&path, "memory_budget = \"1KiB\"\nthreads = 0\nmachine = \"m\"\nrecipe = \"r\"\n").unwrap();
    let message = DaemonConfig::load(&path).unwrap_err().to_string();
    assert!(
        message.contains("memory_budget") && message.contains("= 1.0 KiB:") && message.contains("8MiB"),
        "{message}"
    );
    assert!(message.contains("threads = 0: allowed is 1 to 256"), "all of them: {message}");
    let message = DaemonConfig::load(&directory.path().join("none.toml")).unwrap_err().to_string();
    assert!(message.contains("none.toml") && message.contains("No such file"), "{message}");
}

fn shipped_text(place: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(place)).unwrap()
}

#[test]
fn mistakes_in_files_for_slm_machines_are_told() {
    let machine = shipped_text("machines/sim-slm.toml");
    let machines = [
        ("grid_um = ", "grid_um = 0.5 # ", ["grid_um", "0.5", "1 to 1000"]),
        ("field_um = ", "field_um = [120000.0, 2e6] # ", ["field_um[1]", "2000000", "1000 to 983040"]),
        ("max_power_w = ", "max_power_w = 0.0 # ", ["max_power_w", "0", "0.1 to 10000"]),
        ("layer_height_range_um = ", "layer_height_range_um = [50.0, 20.0] # ", ["range_um[1]", "20", "50 to 1000"]),
        ("beam_diameter_um", "beam_um", ["beam_um", "unknown field", "beam_diameter_um"]),
    ];
    for (old, new, words) in machines {
        let message = Machine::parse(Path::new("m.toml"), &machine.replacen(old, new, 1)).unwrap_err().to_string();
        for word in words.iter().chain(&["m.toml"]) {
            assert!(message.contains(word), "{new}: `{word}` is not in: {message}");
        }
    }
    let recipe = shipped_text("recipes/slm-demo.toml");
    let recipes = [
        ("mark_speed_mm_s = ", "mark_speed_mm_s = 0.0 # ", ["mark_speed_mm_s", "0", "1 to 50000"]),
        ("hatch_spacing_um = ", "hatch_spacing_um = 0.0 # ", ["hatch_spacing_um", "0", "1 to 10000"]),
        ("= \"stripes\"", "= \"spiral\"", ["spiral", "unknown variant", "chessboard"]),
        ("stripe_overlap_um = ", "stripe_overlap_um = 3000.0 # ", ["stripe_overlap_um", "3000", "0 to 2500"]),
        ("[contour]", "[contour]\nhatch_spacing_um = 50.0", ["contour.hatch_spacing_um", "only up_skin", "down_skin"]),
        ("[contour]", "[point]\npoint_time_us = 0\n[contour]", ["point.point_time_us", "0", "1 to 1000000"]),
        ("[down_skin]", "[down_skin]\nexposure_ms = 1", ["exposure_ms", "unknown field", "laser_power_w"]),
        ("hatch_strategy = ", "# ", ["missing field", "hatch_strategy", "slm"]),
    ];
    for (old, new, words) in recipes {
        let message = Recipe::parse(Path::new("slm.toml"), &recipe.replacen(old, new, 1)).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "{new}: `{word}` is not in: {message}");
        }
    }
}

/// A value that loads but cannot be used would end a print at its first layer.
#[test]
fn the_filling_takes_every_value_of_a_recipe_that_loads() {
    let machine = Machine::parse(Path::new("m.toml"), &shipped_text("machines/sim-slm.toml")).unwrap();
    let Machine::Slm(machine) = machine else { panic!("a laser machine") };
    let shipped = shipped_text("recipes/slm-demo.toml");
    let keys = [
        "contour_count",
        "contour_offset_um",
        "contour_spacing_um",
        "simplify_tolerance_um",
        "thin_below_um",
        "contour_only_below_um",
        "point_below_um",
        "shortest_mark_um",
        "hatch_spacing_um",
        "hatch_angle_deg",
        "hatch_rotation_deg",
        "hatch_end_offset_um",
        "stripe_width_um",
        "stripe_overlap_um",
        "island_um",
        "island_overlap_um",
        "up_skin.hatch_spacing_um",
    ];
    let values = [-361, -10, 0, 1, 99, 100, 360, 1000, 2500, 5001, 10_000, 10_001, 100_000, 1_000_000, 10_000_000];
    let mut loaded = 0;
    for strategy in ["zigzag", "unidirectional", "stripes", "chessboard"] {
        for (key, value) in keys.iter().flat_map(|key| values.map(|value| (*key, value))) {
            let sets = |line: &str, key: &str| line.starts_with(&format!("{key} = "));
            let is_other = |line: &&str| !sets(line, key) && !sets(line, "hatch_strategy");
            let rest: Vec<_> = shipped.lines().filter(is_other).collect();
            let text = format!("{key} = {value}\nhatch_strategy = \"{strategy}\"\n{}", rest.join("\n"));
            let Ok(Recipe::Slm(recipe)) = Recipe::parse(Path::new("my.toml"), &text) else { continue };
            let settings = Scan::of(&machine, &recipe).settings;
            assert_eq!(settings.check(), Ok(()), "{strategy}, {key} = {value}");
            loaded += 1;
        }
    }
    assert!(loaded > 400, "{loaded}");
}

#[test]
fn a_wrong_value_that_all_classes_share_is_told_once() {
    let recipe = shipped_text("recipes/slm-demo.toml").replacen("jump_speed_mm_s = ", "jump_speed_mm_s = nan # ", 1);
    let message = Recipe::parse(Path::new("slm.toml"), &recipe).unwrap_err().to_string();
    assert_eq!(message.matches("jump_speed_mm_s").count(), 1, "{message}");
}

#[test]
fn a_recipe_beyond_the_limits_of_a_machine_is_told() {
    let directory = tempfile::tempdir().unwrap();
    let [machine, recipe] = ["m.toml", "r.toml"].map(|name| directory.path().join(name));
    std::fs::write(&machine, shipped_text("machines/sim-slm.toml")).unwrap();
    let text = shipped_text("recipes/slm-demo.toml");
    std::fs::write(&recipe, &text).unwrap();
    load_pair(&machine, &recipe).unwrap();
    let strong = text.replacen("[contour]\nlaser_power_w = 120.0", "[contour]\nlaser_power_w = 250.0", 1);
    std::fs::write(&recipe, strong.replacen("layer_height_um = 30.0", "layer_height_um = 10.0", 1)).unwrap();
    let message = load_pair(&machine, &recipe).unwrap_err().to_string();
    for word in ["r.toml", "layer_height_um = 10: allowed is 20 to 100", "laser_power_w = 250: allowed is at most 200"]
    {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
}

#[test]
fn a_class_of_vectors_has_the_recipes_laser_parameters_or_its_own() {
    let recipe = Recipe::parse(Path::new("slm.toml"), &shipped_text("recipes/slm-demo.toml")).unwrap();
    let Recipe::Slm(recipe) = recipe else { panic!("a recipe for SLM machines") };
    let [hatch, contour] = [MarkClass::Hatch, MarkClass::Contour].map(|class| recipe.laser(class));
    assert_eq!((hatch.power_w, hatch.mark_speed_mm_s), (180.0, 1000.0));
    assert_eq!((contour.power_w, contour.mark_speed_mm_s), (120.0, 600.0));
    assert_eq!(contour.jump_speed_mm_s, hatch.jump_speed_mm_s);
}

#[test]
fn the_daemon_starts_with_a_laser_machine() {
    let directory = tempfile::tempdir().unwrap();
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let [machine, recipe] = ["machines/sim-slm.toml", "recipes/slm-demo.toml"].map(|name| config.join(name));
    let text = format!(
        "spool = \"{0}\"\nsocket = \"{0}/s\"\nmachine = {machine:?}\nrecipe = {recipe:?}\n",
        directory.path().display()
    );
    let place = directory.path().join("layerd.toml");
    std::fs::write(&place, text).unwrap();
    let findings = layerd::daemon::check(&place);
    assert!(findings.errors.is_empty(), "{:?}", findings.errors);
}

/// A machine file of a laser machine with these lines in place of those of the same keys, and its tables from `[axes]` on.
fn laser_machine(axes: &str, protocol: &str) -> String {
    format!(
        "name = \"mine\"\nkind = \"slm\"\nfield_um = [100000.0, 100000.0]\nbuild_height_um = 50000.0\nbeam_diameter_um = 100.0\n\
         max_power_w = 5.0\nlayer_height_range_um = [20.0, 200.0]\n{axes}\n[link]\npath = \"tty\"\nbaud = 115200\nprotocol = \"{protocol}\"\n"
    )
}

#[test]
fn axes_belong_to_grbl_controllers_and_their_mistakes_are_told() {
    let parse = |axes: &str, protocol: &str| Machine::parse(Path::new("my.toml"), &laser_machine(axes, protocol));
    let axes = "[axes]\nmax_speed_mm_s = 100.0\nacceleration_mm_s2 = 500.0\n";
    let machine = parse(axes, "grbl").unwrap().grbl().expect("a grbl machine");
    assert_eq!((machine.max_speed_um_s, machine.max_power_mw), (100_000, 5_000));
    assert_eq!(machine.recoat_gcode, ["M8", "G4P10", "M9"]);
    let cases = [
        ("", "grbl", ["axes", "missing", "max_speed_mm_s and acceleration_mm_s2"]),
        (axes, "layerd", ["axes", "nothing here", "grbl"]),
        ("[axes]\nmax_speed_mm_s = 0.5\nacceleration_mm_s2 = 500.0\n", "grbl", ["axes.max_speed_mm_s", "0.5", "1 to"]),
    ];
    for (axes, protocol, words) in cases {
        let message = parse(axes, protocol).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "`{word}` is not in: {message}");
        }
    }
    for line in [
        "S5",
        "M3",
        "g1 x5 m4",
        "M04",
        "M004",
        "G28",
        "G10L2P1X5",
        "G1Z1",
        "$H",
        "",
        "G1X",
        "G1X1;",
        &"G4P0.001".repeat(10),
    ] {
        let message = parse(&format!("{axes}recoat_gcode = [{line:?}]\n"), "grbl").unwrap_err().to_string();
        assert!(message.contains("axes.recoat_gcode"), "{line}: {message}");
    }
    parse(&format!("{axes}recoat_gcode = [\"G1 Y90 F3000\", \"M8\", \"G4P1.5\", \"M9\"]\n"), "grbl").unwrap();
    let dlp =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/machines/sim-dlp.toml")).unwrap();
    let message =
        Machine::parse(Path::new("my.toml"), &format!("{dlp}\nprotocol = \"grbl\"\n")).unwrap_err().to_string();
    assert!(message.contains("link.protocol") && message.contains("kind = \"slm\""), "{message}");
}

#[test]
fn a_recipe_that_axes_cannot_follow_is_refused_with_both_names() {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let machine = directory.join("machines/grbl-laser.toml");
    load_pair(&machine, &directory.join("recipes/grbl-laser.toml")).unwrap();
    let message = load_pair(&machine, &directory.join("recipes/slm-demo.toml")).unwrap_err().to_string();
    for word in ["mark_speed_mm_s", "1200", "at most 200", "axes.max_speed_mm_s", "laser_power_w"] {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
}
