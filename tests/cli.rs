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

#[test]
fn wrong_usage_is_exit_code_2() {
    let wrong: [&[&str]; 11] = [
        &["pack", "Cargo.toml", "-o", "x.layerd", "--scale", "-1"],
        &["pack", "x.txt", "-o", "x.layerd", "--support", "1", "--blend", "union"],
        &["generate", "bcc", "--struts", "0", "-o", "/nonexistent/x.layerd"],
        &["generate", "bcc", "--struts", "9", "--radius", "-1", "-o", "/nonexistent/x.layerd"],
        &[],
        &["launch"],
        &["start"],
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
    let part = directory.path().join("part.layerd");
    std::fs::write(&part, "bytes").unwrap();
    let part = part.to_str().unwrap();
    let commands: [&[&str]; 9] = [
        &["status"],
        &["status", "--json"],
        &["jobs"],
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
        assert!(told.contains("systemctl start layerd") && told.contains("none.sock"), "{told}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn what_is_wrong_on_this_side_is_told_before_anything_is_sent() {
    let directory = tempfile::tempdir().unwrap();
    let bad = directory.path().join("bad.toml");
    std::fs::write(&bad, "name = \"x\"\nexposure = 3\n").unwrap();
    let socket = directory.path().join("none.sock");
    let cases: [(&[&str], &str); 4] = [
        (&["start", "part.layerd", "--recipe", "nonesuch"], "nonesuch"),
        (&["start", "part.layerd", "--recipe", bad.to_str().unwrap()], "exposure"),
        (&["watch"], "terminal"),
        (&["demo", "slm"], "later"),
    ];
    for (arguments, word) in cases {
        let output = layerctl(arguments, &socket);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(stderr(&output).contains(word), "{arguments:?}: {}", stderr(&output));
    }
}

#[test]
fn help_teaches_by_examples() {
    let commands =
        ["start", "status", "watch", "jobs", "device", "pause", "resume", "stop", "abort", "demo", "simulate"];
    let offline = ["pack", "generate", "info", "check", "slice"];
    for command in commands.into_iter().chain(offline) {
        let output = layerctl(&[command, "--help"], Path::new("/nonexistent"));
        let help = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && help.contains("Examples:") && help.contains("layerctl "), "{help}");
    }
}
