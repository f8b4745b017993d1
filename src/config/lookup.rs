//! Finds a configuration file by path or by name. A name is looked up in the usual directories, then among the files built into
//! the program. `layerctl start --recipe` and `layerctl check --machine` take either.

use std::path::{Path, PathBuf};

use super::{ConfigError, read_text};

/// Which kind of file is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Folder {
    /// Machine files.
    Machines,
    /// Recipe files.
    Recipes,
}

/// The files of `config/`, built in so that their names work without an installation.
const SHIPPED: [(Folder, &str, &str); 9] = [
    (Folder::Machines, "dlp-1080p-50um", include_str!("../../config/machines/dlp-1080p-50um.toml")),
    (Folder::Machines, "lcd-4k-35um", include_str!("../../config/machines/lcd-4k-35um.toml")),
    (Folder::Machines, "sim-dlp", include_str!("../../config/machines/sim-dlp.toml")),
    (Folder::Machines, "sim-slm", include_str!("../../config/machines/sim-slm.toml")),
    (Folder::Machines, "slm-125-400w", include_str!("../../config/machines/slm-125-400w.toml")),
    (Folder::Recipes, "default", include_str!("../../config/recipes/default.toml")),
    (Folder::Recipes, "demo", include_str!("../../config/recipes/demo.toml")),
    (Folder::Recipes, "fine", include_str!("../../config/recipes/fine.toml")),
    (Folder::Recipes, "slm-demo", include_str!("../../config/recipes/slm-demo.toml")),
];

/// A configuration file, read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigText {
    /// Where it came from, for error messages.
    pub path: PathBuf,
    /// Its content.
    pub text: String,
}

/// Why there is no file.
#[derive(Debug, thiserror::Error)]
pub enum FindError {
    /// Nothing has that name.
    #[error(transparent)]
    NotFound(#[from] NotFound),
    /// The file cannot be read.
    #[error(transparent)]
    Unreadable(#[from] ConfigError),
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
    /// Names that exist.
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

/// Finds the file `name`. If it ends in `.toml` or has a directory, it is a path. Else it is the first `NAME.toml` in the folder below
/// `$LAYERD_CONFIG_DIR`, `/etc/layerd` and `config`, or the built-in file of that name.
///
/// # Errors
/// [`FindError::NotFound`] lists the places that were searched; [`FindError::Unreadable`] holds the system's error.
pub fn find(folder: Folder, name: &str) -> Result<ConfigText, FindError> {
    let read = |path: PathBuf| Ok(ConfigText { text: read_text(&path)?, path });
    let kind = match folder {
        Folder::Machines => "machine",
        Folder::Recipes => "recipe",
    };
    let as_path = Path::new(name);
    if name.ends_with(".toml") || as_path.components().count() > 1 {
        return read(as_path.into());
    }
    let looked: Vec<PathBuf> = folders(folder).map(|folder| folder.join(format!("{name}.toml"))).collect();
    // If it is no regular file, reading it says so.
    if let Some(path) = looked.iter().find(|path| path.exists()) {
        return read(path.clone());
    }
    match SHIPPED.iter().find(|(of, called, _)| (*of, *called) == (folder, name)) {
        Some((_, _, text)) => {
            Ok(ConfigText { path: format!("{name}.toml (built in)").into(), text: (*text).to_owned() })
        }
        None => Err(NotFound {
            kind,
            name: name.into(),
            known: names(folder).into_iter().take(MAX_NAMES).collect(),
            looked,
        }
        .into()),
    }
}

/// An error lists no more names than this: more would not be read.
const MAX_NAMES: usize = 20;

/// All names that [`find`] knows, in alphabetical order.
pub fn names(folder: Folder) -> Vec<String> {
    let files = folders(folder).filter_map(|folder| folder.read_dir().ok());
    let files = files.flat_map(|folder| folder.filter_map(|entry| Some(entry.ok()?.path())));
    let is_toml = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "toml");
    let name = |path: PathBuf| Some(path.file_stem()?.to_str()?.to_owned());
    let shipped = SHIPPED.iter().filter(|(of, ..)| *of == folder).map(|(_, called, _)| (*called).to_owned());
    let names: std::collections::BTreeSet<String> = files.filter(is_toml).filter_map(name).chain(shipped).collect();
    names.into_iter().collect()
}

/// The folders that names are looked up in, in this order.
fn folders(folder: Folder) -> impl Iterator<Item = PathBuf> {
    let configured = std::env::var_os("LAYERD_CONFIG_DIR").filter(|directory| !directory.is_empty());
    let roots = configured.map(PathBuf::from).into_iter().chain(["/etc/layerd".into(), "config".into()]);
    let subdirectory = match folder {
        Folder::Machines => "machines",
        Folder::Recipes => "recipes",
    };
    roots.map(move |root| root.join(subdirectory))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_taken_as_it_is_and_a_missing_name_lists_the_places() {
        let unreadable = find(Folder::Machines, "there/mine").expect_err("no such file").to_string();
        assert!(unreadable.contains("cannot read there/mine"), "{unreadable}");
        let found = find(Folder::Recipes, "config/recipes/fine.toml").expect("shipped");
        assert_eq!(found.path, Path::new("config/recipes/fine.toml"));
        let missing = find(Folder::Recipes, "no-such-recipe").expect_err("no such file").to_string();
        assert!(missing.contains("/etc/layerd/recipes/no-such-recipe.toml"), "{missing}");
        assert!(missing.contains("known are default, demo, fine"), "{missing}");
    }

    #[test]
    fn every_file_built_in_is_valid() {
        for (folder, name, text) in SHIPPED {
            let path = Path::new(name);
            match folder {
                Folder::Machines => drop(crate::config::Machine::parse(path, text).expect(name)),
                Folder::Recipes => drop(crate::config::Recipe::parse(path, text).expect(name)),
            }
        }
    }
}
