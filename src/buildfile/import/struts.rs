//! The struts of a body as they come from the sort. `pack` writes them.

use std::io;

use crate::buildfile::model::Strut;
use crate::buildfile::primitive::{SharedStrut, Sortable};
use crate::buildfile::sort::{self, Sorter};

/// The struts of a body: whole ones, and those that may be of several materials.
#[derive(Default)]
pub(in crate::buildfile) struct Struts {
    pub(in crate::buildfile) whole: Vec<Sorter<Strut>>,
    pub(in crate::buildfile) shared: Vec<Sorter<SharedStrut>>,
}

impl Struts {
    /// All of them in file order. `progress` is as that of [`sort::finish`].
    ///
    /// # Errors
    /// As [`sort::finish`].
    pub(in crate::buildfile) fn sorted(
        self,
        progress: &mut dyn FnMut(u64, u64),
    ) -> io::Result<impl Iterator<Item = io::Result<Strut>> + use<>> {
        let mut whole = sort::finish(self.whole, progress)?.peekable();
        let mut shared = sort::finish(self.shared, progress)?.peekable();
        Ok(std::iter::from_fn(move || {
            let comes_first = match (whole.peek(), shared.peek()) {
                (Some(Ok(whole)), Some(Ok(SharedStrut(shared)))) => {
                    SharedStrut(*whole).key() <= SharedStrut(*shared).key()
                }
                (one, other) => matches!(one, Some(Err(_))) || other.is_none(),
            };
            if comes_first { whole.next() } else { shared.next().map(|strut| strut.map(|SharedStrut(strut)| strut)) }
        }))
    }
}
