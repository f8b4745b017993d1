//! `layerctl` as a program: exit codes, messages, what goes to stdout and what to stderr.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

use std::path::Path;
use std::process::{Command, Output, Stdio};

fn layerctl(arguments: &[&str], socket: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_layerctl"));
    command.args(arguments).env("LAYERD_SOCKET", socket).stdin(Stdio::null());
    command.output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A build file.
fn part_in(directory: &Path) -> String {
    let part = directory.join("part.layerd").to_str().unwrap().to_owned();
    let output = layerctl(&["generate", "bcc", "--struts", "20", "-o", &part], Path::new("/nonexistent"));
    assert!(output.status.success(), "{}", stderr(&output));
    part
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let wrong: [&[&str]; 15] = [
        &["pack", "Cargo.toml", "-o", "x.3MF"],
        &["generate", "bcc", "--struts", "9", "-o", "/nonexistent/x.txt"],
        &["pack", "Cargo.toml", "-o", "x.layerd", "--scale", "-1"],
        &["pack", "x.txt", "-o", "x.layerd", "--support", "1", "--joint", "union"],
        &["generate", "bcc", "--struts", "0", "-o", "/nonexistent/x.layerd"],
        &["generate", "bcc", "--struts", "9", "--radius", "-1", "-o", "/nonexistent/x.layerd"],
        &[],
        &["launch"],
        &["start"],
        &["start", "part.layerd", "--again", "7"],
        &["log"],
        &["status", "--jsn"],
        &["resume", "7", "--in-doubt", "perhaps"],
        &["demo", "fdm"],
        &["pause", "1", "2"],
    ];
    for arguments in wrong {
        let output = layerctl(arguments, Path::new("/nonexistent"));
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn without_a_daemon_every_command_tells_the_remedy() {
    let directory = tempfile::tempdir().unwrap();
    let part = &part_in(directory.path());
    let commands: [&[&str]; 11] = [
        &["status"],
        &["status", "--json"],
        &["jobs"],
        &["log", "7"],
        &["start", "--again", "7"],
        &["device"],
        &["watch", "--json"],
        &["abort"],
        &["resume"],
        &["start", part],
        &["start", part, "--wait"],
    ];
    for arguments in commands {
        let output = layerctl(arguments, &directory.path().join("none.sock"));
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {told}");
        assert!(told.starts_with("error: "), "{told}");
        assert!(told.contains("layerd --config FILE") && told.contains("none.sock"), "{told}");
        assert_eq!(told.contains("at the mains"), arguments == ["abort"], "what to do by hand: {told}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_start_without_a_part_names_both_ways_to_give_one() {
    let told = stderr(&layerctl(&["start"], Path::new("/nonexistent")));
    assert!(told.contains("<FILE|--again <JOB>>"), "{told}");
}

/// A daemon that ends while it takes a job leaves open whether it took it.
#[test]
fn a_connection_that_breaks_while_a_job_is_handed_over_sends_the_operator_to_the_list_of_jobs() {
    let directory = tempfile::tempdir().unwrap();
    let part = &part_in(directory.path());
    let socket = directory.path().join("control.sock");
    let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    for arguments in [&["start", part][..], &["start", "--again", "7"]] {
        let output = std::thread::scope(|scope| {
            scope.spawn(|| {
                let (mut connection, _) = listener.accept().unwrap();
                std::io::Read::read(&mut connection, &mut [0; 64 << 10]).unwrap();
            });
            layerctl(arguments, &socket)
        });
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(told.contains("broke off") && told.contains("look at `layerctl "), "{told}");
        assert!(told.contains("jobs` before you start the part again") && told.lines().count() == 1, "{told}");
    }
}

#[test]
fn a_daemon_started_by_hand_is_as_likely_as_a_service_where_no_socket_was_named() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_layerctl"));
    let output = command.args(["status"]).env_remove("LAYERD_SOCKET").output().unwrap();
    let told = stderr(&output);
    if output.status.success() || told.contains("may not be opened") {
        eprintln!("skipped: this machine runs a layerd of its own");
        return;
    }
    for words in ["systemctl start layerd", "export LAYERD_SOCKET=PATH", "layerd.toml"] {
        assert!(told.contains(words), "{told}");
    }
}

#[test]
fn a_build_file_is_not_named_as_a_source() {
    let directory = tempfile::tempdir().unwrap();
    let source = directory.path().join("edges.txt").to_str().unwrap().to_owned();
    let text = "1 0.3 0.45 0\n0 0 0 1 1 1\n";
    std::fs::write(&source, text).unwrap();
    let output = layerctl(&["pack", &source, "-o", &source], Path::new("/nonexistent"));
    assert!(stderr(&output).contains("edges.txt: a build file is named .layerd"), "{}", stderr(&output));
    assert_eq!(std::fs::read_to_string(&source).unwrap(), text, "the source is untouched");
}

#[test]
fn a_socket_path_that_is_too_long_is_told_as_that() {
    let output = layerctl(&["status"], Path::new(&format!("/{}/control.sock", "x".repeat(120))));
    let told = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("has 134 bytes, but the system allows 107") && told.contains("LAYERD_SOCKET"), "{told}");
    assert!(!told.contains("SUN_LEN"), "{told}");
}

#[test]
fn what_is_no_build_file_is_told_before_the_daemon_is_asked() {
    let directory = tempfile::tempdir().unwrap();
    let part = part_in(directory.path());
    let bytes = std::fs::read(&part).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = directory.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let cases = [
        (write("text.layerd", b"the bytes of something else"), "not a build file"),
        (write("empty.layerd", b""), "too few"),
        (write("cut.layerd", &bytes[..bytes.len() - 1]), "cut short"),
        (directory.path().to_str().unwrap().to_owned(), "not a regular file"),
    ];
    for (file, words) in cases {
        let output = layerctl(&["start", &file], &directory.path().join("none.sock"));
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(told.contains(&file) && told.contains(words) && !told.contains("none.sock"), "{told}");
    }
}

#[test]
fn a_negative_number_is_a_value_wherever_one_may_stand() {
    let commands: [(&[&str], &str); 12] = [
        (&["pack", "x.txt", "-o", "x", "--scale", "-5"], "--scale -5"),
        (&["pack", "x.txt", "-o", "x", "--rotate", "-5,0,0"], "x.txt"),
        (&["pack", "x.txt", "-o", "x", "--rotate", "-5"], "'-5' for '--rotate"),
        (&["pack", "x.txt", "-o", "x", "--memory", "-5"], "'-5' for '--memory"),
        (&["generate", "bcc", "--struts", "-5", "-o", "x"], "'-5' for '--struts"),
        (&["generate", "bcc", "--struts", "5", "--box", "-5,1,1", "-o", "/nonexistent/x"], "-5"),
        (&["slice", "x", "-m", "sim-dlp", "-o", "x", "--threads", "-5"], "'-5' for '--threads"),
        (&["slice", "x", "-m", "sim-dlp", "-o", "x", "--layers", "-5..2"], "'-5..2' for '--layers"),
        (&["check", "x", "-m", "sim-dlp", "--budget", "-5"], "'-5' for '--budget"),
        (&["simulate", "dlp", "--link", "x", "--baud", "-5"], "'-5' for '--baud"),
        (&["simulate", "dlp", "--link", "x", "--window", "-5"], "'-5' for '--window"),
        (&["resume", "-5"], "none.sock"),
    ];
    for (arguments, words) in commands {
        let output = layerctl(arguments, Path::new("/nonexistent/none.sock"));
        let told = stderr(&output);
        assert!(!output.status.success() && told.contains(words) && !told.contains("-- -5"), "{arguments:?}: {told}");
    }
}

#[test]
fn what_is_no_zip_is_told_to_be_no_3mf() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("part.3mf");
    std::fs::write(&file, "solid a\nfacet normal 0 0 1\n").unwrap();
    let out = directory.path().join("out.layerd");
    let output = layerctl(&["pack", file.to_str().unwrap(), "-o", out.to_str().unwrap()], Path::new("/nonexistent"));
    let told = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("part.3mf: it is not a 3MF file") && !told.contains("EOCD"), "{told}");
}

#[test]
fn what_is_wrong_on_this_side_is_told_before_anything_is_sent() {
    let directory = tempfile::tempdir().unwrap();
    let bad = directory.path().join("bad.toml");
    std::fs::write(&bad, "name = \"x\"\nexposure = 3\n").unwrap();
    let socket = directory.path().join("none.sock");
    let cases: [(&[&str], &str); 4] = [
        (&["start", "part.layerd"], "part.layerd"),
        (&["start", "part.layerd", "--recipe", "nonesuch"], "nonesuch"),
        (&["start", "part.layerd", "--recipe", bad.to_str().unwrap()], "exposure"),
        (&["watch"], "terminal"),
    ];
    for (arguments, word) in cases {
        let output = layerctl(arguments, &socket);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(stderr(&output).contains(word), "{arguments:?}: {}", stderr(&output));
    }
}

#[test]
fn a_wrong_machine_is_told_before_a_wrong_link_and_each_in_one_sentence() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("none/port");
    let simulate = |more: &[&str]| {
        let arguments = [&["simulate", "dlp", "--link", link.to_str().unwrap()], more].concat();
        let output = layerctl(&arguments, Path::new("/nonexistent"));
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        stderr(&output)
    };
    let told = simulate(&["--machine", "nonesuch"]);
    assert!(told.contains("no machine named `nonesuch`") && !told.contains("none/port"), "{told}");
    let told = simulate(&[]);
    assert!(told.starts_with("error: cannot put a pseudo-terminal at ") && told.contains("none/port"), "{told}");
    assert_eq!(told.lines().count(), 1, "{told}");
}

#[test]
fn counts_and_sizes_read_well() {
    let directory = tempfile::tempdir().unwrap();
    let part = directory.path().join("part.layerd").to_str().unwrap().to_owned();
    let generate = ["generate", "bcc", "--struts", "20", "--box", "8,8,4", "-o", &part];
    assert!(layerctl(&generate, Path::new("/nonexistent")).status.success());
    let out = directory.path().join("layers");
    let slice = ["slice", &part, "--machine", "sim-dlp", "-o", out.to_str().unwrap(), "--layers"];
    let output = layerctl(&[&slice[..], &["0..1"]].concat(), Path::new("/nonexistent"));
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("1 layer and manifest.json in "), "{output:?}");
    let output = layerctl(&[&slice[..], &["1..3"]].concat(), Path::new("/nonexistent"));
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("2 layers and"), "{output:?}");
    assert!(stderr(&output).starts_with("note: 1 more picture of layers, from another run, "), "{output:?}");
    let output = layerctl(&["info", &part], Path::new("/nonexistent"));
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && told.contains(" bytes per strut, in 1 chunk\n"), "{told}");
}

#[test]
fn help_teaches_by_examples() {
    let commands = [
        "start", "status", "watch", "jobs", "log", "device", "pause", "resume", "stop", "abort", "raise", "remove",
        "demo",
    ];
    let offline = ["pack", "generate", "info", "check", "slice", "simulate"];
    for command in commands.into_iter().chain(offline) {
        let output = layerctl(&[command, "--help"], Path::new("/nonexistent"));
        let help = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && help.contains("Examples:") && help.contains("layerctl "), "{help}");
    }
}

#[test]
fn machines_and_recipes_are_listed_with_their_figures_and_what_is_wrong() {
    let directory = tempfile::tempdir().unwrap();
    let machines = directory.path().join("machines");
    std::fs::create_dir(&machines).unwrap();
    let shipped = include_str!("../config/machines/sim-dlp.toml");
    // A name of its own comes before one that is built in.
    std::fs::write(machines.join("sim-dlp.toml"), shipped.replace("width_px = 960", "width_px = 640")).unwrap();
    std::fs::write(machines.join("broken.toml"), shipped.replace("width_px = 960", "width_px = 1")).unwrap();
    let list = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_layerctl"));
        let output = command.args(arguments).env("LAYERD_CONFIG_DIR", directory.path()).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let told = list(&["machines"]);
    let line =
        |name: &str| told.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{name}: {told}"));
    assert!(line("sim-dlp").contains("640 × 540 pixels of 40 × 40 µm, 100 mm high"), "{told}");
    assert!(line("sim-dlp").contains(machines.to_str().unwrap()), "{told}");
    assert!(line("broken").contains("cannot be used") && line("broken").contains("width_px = 1"), "{told}");
    assert!(line("lcd-4k-35um").ends_with("config/machines/lcd-4k-35um.toml"), "{told}");
    let recipes: serde_json::Value = serde_json::from_str(&list(&["recipes", "--json"])).unwrap();
    let names: Vec<_> = recipes.as_array().unwrap().iter().map(|recipe| recipe["name"].as_str().unwrap()).collect();
    assert!(["default", "demo", "fine"].iter().all(|name| names.contains(name)), "{names:?}");
    assert!(recipes[0]["figures"].as_str().unwrap().contains("layers of"), "{recipes}");
}

#[test]
fn a_recipe_that_is_no_regular_file_is_told_as_that() {
    let directory = tempfile::tempdir().unwrap();
    let part = part_in(directory.path());
    std::fs::create_dir(directory.path().join("recipes")).unwrap();
    let pipe = directory.path().join("recipes/mine.toml");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mut command = Command::new(env!("CARGO_BIN_EXE_layerctl"));
    let output = command.args(["start", &part, "--recipe", "mine"]).env("LAYERD_CONFIG_DIR", directory.path()).output();
    let told = stderr(&output.unwrap());
    assert!(told.contains("mine.toml: it is not a regular file") && !told.contains("no recipe named"), "{told}");
}

#[test]
fn man_pages_and_completions_know_every_command() {
    let directory = tempfile::tempdir().unwrap();
    let output = layerctl(&["manual", directory.path().to_str().unwrap()], Path::new("/nonexistent"));
    assert!(output.status.success(), "{}", stderr(&output));
    let read = |name: &str| {
        std::fs::read_to_string(directory.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    };
    for command in ["start", "status", "jobs", "log", "abort", "pack", "check", "machines", "recipes"] {
        assert!(read(&format!("man/layerctl-{command}.1")).contains(command), "{command}");
        for completions in ["bash/layerctl.bash", "zsh/_layerctl", "fish/layerctl.fish"] {
            assert!(read(&format!("completions/{completions}")).contains(command), "{completions}: {command}");
        }
    }
    // An option, too; a man page escapes its hyphens.
    assert!(read("man/layerctl-start.1").contains("\\-\\-again"), "{}", read("man/layerctl-start.1"));
    for completions in ["bash/layerctl.bash", "zsh/_layerctl", "fish/layerctl.fish"] {
        assert!(read(&format!("completions/{completions}")).contains("again"), "{completions}");
    }
    assert!(read("man/layerd.8").contains("check"));
    assert!(read("completions/bash/layerd.bash").contains("config"));
}
