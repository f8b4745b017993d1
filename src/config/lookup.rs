//! From what an operator types to a configuration file: a path, or a bare name looked up in the usual places.

use std::path::{Path, PathBuf};

/// Which kind of file is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Folder {
    /// Machine files.
    Machines,
    /// Recipe files.
    Recipes,
}

/// A name under which no file was found.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no {kind} named `{name}`; looked for {}; {}", list(looked), remedy(known))]
pub struct NotFound {
    /// What was looked for.
    pub kind: &'static str,
    /// The name.
    pub name: String,
    /// Every place, in the order looked.
    pub looked: Vec<PathBuf>,
    /// Names that would have been found.
    pub known: Vec<String>,
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn remedy(known: &[String]) -> String {
    match known {
        [] => "give the path of a TOML file".into(),
        names => format!("known are {}; or give the path of a TOML file", names.join(", ")),
    }
}

/// The file `name` means: itself where it ends in `.toml` or has a directory, else `NAME.toml` in the folder below
/// `$LAYERD_CONFIG_DIR`, `/etc/layerd` and `config`, the first that exists.
///
/// # Errors
/// [`NotFound`] lists where it looked.
pub fn find(folder: Folder, name: &str) -> Result<PathBuf, NotFound> {
    let (kind, subdirectory) = match folder {
        Folder::Machines => ("machine", "machines"),
        Folder::Recipes => ("recipe", "recipes"),
    };
    let as_path = Path::new(name);
    if name.ends_with(".toml") || as_path.components().count() > 1 {
        return Ok(as_path.into());
    }
    let configured = std::env::var_os("LAYERD_CONFIG_DIR").filter(|directory| !directory.is_empty());
    let roots = configured.map(PathBuf::from).into_iter().chain(["/etc/layerd".into(), "config".into()]);
    let looked: Vec<PathBuf> = roots.map(|root| root.join(subdirectory).join(format!("{name}.toml"))).collect();
    match looked.iter().find(|path| path.is_file()) {
        Some(path) => Ok(path.clone()),
        None => Err(NotFound { kind, name: name.into(), known: known(&looked), looked }),
    }
}

/// More names than this would not be read.
const MOST_KNOWN: usize = 20;

/// The names that lie in the folders looked in.
fn known(looked: &[PathBuf]) -> Vec<String> {
    let folders = looked.iter().filter_map(|path| path.parent()?.read_dir().ok());
    let files = folders.flat_map(|folder| folder.filter_map(|entry| Some(entry.ok()?.path())));
    let is_toml = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "toml");
    let name = |path: PathBuf| Some(path.file_stem()?.to_str()?.to_owned());
    let names: std::collections::BTreeSet<String> = files.filter(is_toml).filter_map(name).collect();
    names.into_iter().take(MOST_KNOWN).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_taken_as_it_is_and_a_missing_name_lists_the_places() {
        assert_eq!(find(Folder::Machines, "there/mine"), Ok("there/mine".into()));
        assert_eq!(find(Folder::Recipes, "mine.toml"), Ok("mine.toml".into()));
        let missing = find(Folder::Recipes, "no-such-recipe").expect_err("no such file");
        assert!(missing.to_string().contains("/etc/layerd/recipes/no-such-recipe.toml"), "{missing}");
        // Tests run in the package's folder, which has `config/recipes`.
        assert!(missing.known.contains(&"default".into()), "{missing}");
    }
}
