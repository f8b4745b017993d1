//! Every configuration file that is shipped loads; every mistake in one is told with file, key, value and range.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

use std::path::{Path, PathBuf};

use layerd::config::{DaemonConfig, Machine, Recipe, load_pair};

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
    for word in ["my.toml", "line 1, column 8", "unknown kind `fdm`, expected `dlp`"] {
        assert!(unknown.contains(word), "{unknown}");
    }
    let laser = parse("\nkind = \"slm\"\nlaser_power_w = 200.0\n").unwrap_err().to_string();
    assert!(laser.starts_with("my.toml: line 2: layerd cannot drive machines of kind `slm` yet"), "{laser}");
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
    let (_, Recipe::Dlp(recipe)) = load_pair(&machine, &recipe).unwrap();
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
        (machine.replace("\"dlp\"", "\"slm\""), vec!["m.toml", "line 4", "kind", "cannot drive", "`slm`", "`dlp`"]),
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
