//! `layerd --check` and a start: all that is wrong with the places the daemon needs is told, with the remedy.

mod support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Output, Stdio};

use support::{Bench, Setup, skipped};

const LAYERD: &str = env!("CARGO_BIN_EXE_layerd");

fn run(bench: &Bench, arguments: &[&str]) -> (Output, String) {
    let mut command = bench.daemon_command(&[LAYERD]);
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    let output = command.output().expect("layerd runs");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    (output, told)
}

fn edit(bench: &Bench, file: &str, from: &str, to: &str) {
    let text = fs::read_to_string(bench.path(file)).expect(file);
    assert!(text.contains(from), "{text}");
    fs::write(bench.path(file), text.replace(from, to)).expect(file);
}

fn everything_in(directory: &std::path::Path) -> Vec<std::path::PathBuf> {
    let entries = fs::read_dir(directory).expect("a directory").map(|entry| entry.expect("an entry").path());
    let mut found: Vec<_> = entries.collect();
    let below: Vec<_> = found.iter().filter(|path| path.is_dir()).flat_map(|path| everything_in(path)).collect();
    found.extend(below);
    found.sort();
    found
}

#[test]
fn a_check_changes_nothing_and_warns_of_a_missing_port() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    let before = everything_in(bench.dir.path());
    let (output, told) = run(&bench, &["--check"]);
    assert!(output.status.success(), "{told}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("machine `bench`, recipe `bench`: fine"));
    assert!(
        told.starts_with("warning: `link.path` in ") && told.contains("device") && told.contains("machine.toml"),
        "{told}"
    );
    let after = everything_in(bench.dir.path());
    assert_eq!(after.iter().filter(|path| !path.ends_with("daemon.log")).count(), before.len(), "{after:?}");
}

/// Such a setting in the file of a real machine would take exposures for right that are too short.
#[test]
fn a_clock_that_is_not_real_time_is_warned_of_by_a_check_and_a_start() {
    let bench = Bench::start(Setup { time_scale: 50, ..Setup::default() });
    let (output, told) = run(&bench, &["--check"]);
    let words = "`time_scale` in machine.toml is 50: ";
    assert!(output.status.success() && told.contains(&format!("warning: {words}")), "{told}");
    let log = fs::read_to_string(bench.path("daemon.log")).expect("a log");
    assert!(log.lines().any(|line| line.contains("WARN") && line.contains(words)), "{log}");
}

#[test]
fn a_check_beside_a_daemon_that_runs_says_so_and_disturbs_nothing() {
    let bench = Bench::start(Setup { time_scale: 1, ..Setup::default() });
    let (output, told) = run(&bench, &["--check"]);
    assert!(output.status.success(), "{told}");
    assert!(told.lines().count() == 1 && told.contains("another layerd uses spool now"), "{told}");
    bench.ok(&["status"]);
}

#[test]
fn everything_that_is_wrong_is_told_at_once() {
    let bench = Bench::prepare(Setup { memory_budget: "8MiB", size_px: [16_000, 9_000], ..Setup::default() });
    edit(&bench, "layerd.toml", "control.sock", "none/control.sock");
    edit(&bench, "layerd.toml", "\"spool\"", "\"layerd.toml/spool\"");
    fs::write(bench.path("device"), "no terminal").expect("a file");
    let (output, told) = run(&bench, &["--check"]);
    assert_eq!(output.status.code(), Some(1), "{told}");
    for words in [
        "error: `socket` in layerd.toml: the control socket's directory ",
        "none does not exist: make it, or give layerd another `socket`",
        "error: `spool` in layerd.toml: ",
        "error: `link.path` in ",
        "not a serial port or pseudo-terminal",
        "warning: `memory_budget` of 8.0 MiB is less than",
    ] {
        assert!(told.contains(words), "`{words}` is not in:\n{told}");
    }
    // A start says the same.
    let (output, started) = run(&bench, &[]);
    assert_eq!(output.status.code(), Some(1), "{started}");
    let errors = |told: &str| -> Vec<String> {
        told.lines().filter(|line| line.starts_with("error: ")).map(str::to_owned).collect()
    };
    assert_eq!(errors(&started), errors(&told), "{started}");
    assert!(started.contains("memory_budget"), "{started}");
}

#[test]
fn all_that_is_wrong_in_machine_and_recipe_is_told() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    edit(&bench, "machine.toml", "width_px = 400", "width_px = 4");
    edit(&bench, "machine.toml", "baud = ", "baud = 3 # ");
    edit(&bench, "recipe.toml", "exposure_ms = 400", "exposure_ms = 0");
    for arguments in [&["--check"][..], &[]] {
        let (output, told) = run(&bench, arguments);
        assert_eq!(output.status.code(), Some(1), "{told}");
        for words in [
            "error: `machine` in layerd.toml",
            "width_px = 4:",
            "; link.baud = 3:",
            "error: `recipe` in layerd.toml",
            "exposure_ms = 0:",
        ] {
            assert!(told.contains(words), "`{words}` is not in:\n{told}");
        }
    }
}

#[test]
fn a_name_in_place_of_a_path_is_told_as_that_and_other_faults_of_a_file_are_not() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    edit(&bench, "layerd.toml", "machine = \"machine.toml\"", "machine = \"sim-dlp\"");
    edit(&bench, "layerd.toml", "recipe = \"recipe.toml\"", "recipe = \"none.toml\"");
    let (output, told) = run(&bench, &["--check"]);
    assert_eq!(output.status.code(), Some(1), "{told}");
    let lines: Vec<&str> = told.lines().filter(|line| line.starts_with("error: ")).collect();
    let path = "it is a path, counted from the directory of the file that names it";
    assert!(
        lines[0].contains(&format!("{path}, not a name: write the path of its file, such as `machines/sim-dlp.toml`"))
    );
    assert!(lines[0].contains("`layerctl machines` shows the files"), "{told}");
    assert!(lines[1].contains("none.toml") && lines[1].ends_with(path), "{told}");
    fs::create_dir(bench.path("none.toml")).expect("a directory");
    let (_, told) = run(&bench, &["--check"]);
    let line = told.lines().find(|line| line.contains("none.toml")).expect("a line");
    assert!(line.contains("not a regular file") && !line.contains("it is a path"), "{told}");
}

#[test]
fn names_with_control_characters_are_shown_escaped() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    edit(&bench, "machine.toml", "name = \"bench\"", "name = \"be\\u001b[31mnch\"");
    let (output, told) = run(&bench, &["--check"]);
    assert!(output.status.success(), "{told}");
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(told.contains("machine `be\\u{1b}[31mnch`, recipe `bench`: fine") && !told.contains('\u{1b}'), "{told}");
}

#[test]
fn a_path_too_long_for_a_socket_is_named_with_the_limit() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    edit(&bench, "layerd.toml", "control.sock", &"s".repeat(150));
    for arguments in [&["--check"][..], &[]] {
        let (output, told) = run(&bench, arguments);
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(told.contains("150 bytes") && told.contains("shorter `socket`") && !told.contains("SUN_LEN"), "{told}");
    }
}

#[test]
fn places_that_this_user_may_not_write_are_named() {
    if rustix::process::getuid().is_root() {
        return without_rights();
    }
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    for directory in ["spool", "sockets"] {
        fs::create_dir(bench.path(directory)).expect("made");
        fs::set_permissions(bench.path(directory), fs::Permissions::from_mode(0o555)).expect("set");
    }
    edit(&bench, "layerd.toml", "control.sock", "sockets/control.sock");
    let (output, told) = run(&bench, &["--check"]);
    assert_not_writable(&output, &told);
}

/// The same where this process is root: as the user nobody, if there is a program to become it.
fn without_rights() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    fs::set_permissions(bench.dir.path(), fs::Permissions::from_mode(0o755)).expect("set");
    for directory in ["spool", "sockets"] {
        fs::create_dir(bench.path(directory)).expect("made");
    }
    edit(&bench, "layerd.toml", "control.sock", "sockets/control.sock");
    let copy = bench.path("layerd");
    fs::copy(LAYERD, &copy).expect("a copy that nobody may run");
    let mut command = Command::new("setpriv");
    command.current_dir(bench.dir.path()).args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
    match command.arg(&copy).args(["--config", "layerd.toml", "--check"]).output() {
        Ok(output) => assert_not_writable(&output, &String::from_utf8_lossy(&output.stderr)),
        Err(error) => skipped(&format!("setpriv: {error}")),
    }
}

fn assert_not_writable(output: &Output, told: &str) {
    assert_eq!(output.status.code(), Some(1), "{told}");
    for words in ["this user may not make the control socket in", "this user cannot make files in", "chown -R"] {
        assert!(told.contains(words), "`{words}` is not in:\n{told}");
    }
}

#[test]
fn too_few_file_descriptors_are_told() {
    let bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    for check in ["--check", "--config=layerd.toml"] {
        let script = "ulimit -n 100; exec \"$@\"";
        let mut command = Command::new("sh");
        command.current_dir(bench.dir.path()).args(["-c", script, "sh", LAYERD]);
        if check == "--check" {
            command.args(["--config", "layerd.toml"]);
        }
        let output = command.arg(check).output().expect("sh runs");
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(told.contains("may open 100 files") && told.contains("LimitNOFILE="), "{told}");
    }
}
