//! `layerctl manual`: man pages and shell completions, made of the definitions that read the command line.
//! `packaging/build-deb` calls it.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, Command, CommandFactory};
use clap_complete::Shell;

/// Where to write.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  layerctl manual /tmp/layerd       fills man/ and completions/{bash,zsh,fish}/ below it

The Debian package installs them. By hand: man pages belong into /usr/local/share/man/man1 (layerd.8 into man8), completions into \
/usr/local/share/bash-completion/completions, /usr/local/share/zsh/site-functions and /usr/share/fish/vendor_completions.d.")]
pub(super) struct ManualArgs {
    /// Directory, made where it is missing.
    #[arg(value_name = "DIR")]
    directory: PathBuf,
}

/// Carries the command out.
///
/// # Errors
/// Where a file cannot be written.
pub(super) fn run(args: &ManualArgs) -> anyhow::Result<()> {
    let directory = &args.directory;
    write(directory).with_context(|| format!("cannot write man pages and completions into {}", directory.display()))?;
    super::print(&format!("man pages and completions are in {}", directory.display()))
}

fn write(directory: &Path) -> anyhow::Result<()> {
    let man = directory.join("man");
    std::fs::create_dir_all(&man)?;
    clap_mangen::generate_to(super::command(), &man)?;
    // A daemon stands in section 8.
    let page = clap_mangen::Man::new(crate::daemon::Arguments::command()).section("8");
    page.render(&mut File::create(man.join("layerd.8"))?)?;
    for (shell, name) in [(Shell::Bash, "bash"), (Shell::Zsh, "zsh"), (Shell::Fish, "fish")] {
        let place = directory.join("completions").join(name);
        std::fs::create_dir_all(&place)?;
        complete(shell, super::command(), &place)?;
        complete(shell, crate::daemon::Arguments::command(), &place)?;
    }
    Ok(())
}

fn complete(shell: Shell, mut command: Command, place: &Path) -> anyhow::Result<()> {
    let name = command.get_name().to_owned();
    clap_complete::generate_to(shell, &mut command, name, place)?;
    Ok(())
}
