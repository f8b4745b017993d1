//! Writes man pages and shell completions, made of the same definitions that read the command line.
//!
//! `cargo run --example manual -- DIR` fills `DIR/man` and `DIR/completions/{bash,zsh,fish}`; the Debian package installs them.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Command, CommandFactory};
use clap_complete::Shell;

fn main() -> anyhow::Result<()> {
    let directory = std::env::args_os().nth(1).map(PathBuf::from).context("name a directory to write to")?;
    let man = directory.join("man");
    std::fs::create_dir_all(&man)?;
    clap_mangen::generate_to(layerd::cli::command(), &man)?;
    // A daemon stands in section 8.
    let page = clap_mangen::Man::new(layerd::daemon::Arguments::command()).section("8");
    page.render(&mut std::fs::File::create(man.join("layerd.8"))?)?;
    for (shell, name) in [(Shell::Bash, "bash"), (Shell::Zsh, "zsh"), (Shell::Fish, "fish")] {
        let place = directory.join("completions").join(name);
        std::fs::create_dir_all(&place)?;
        complete(shell, layerd::cli::command(), &place)?;
        complete(shell, layerd::daemon::Arguments::command(), &place)?;
    }
    println!("man pages and completions are in {}", directory.display());
    Ok(())
}

fn complete(shell: Shell, mut command: Command, place: &Path) -> anyhow::Result<()> {
    let name = command.get_name().to_owned();
    clap_complete::generate_to(shell, &mut command, name, place)?;
    Ok(())
}
