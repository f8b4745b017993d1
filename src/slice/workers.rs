//! Threads that live as long as a slicer: a small layer takes less time than starting one.

use std::sync::{Mutex, PoisonError};

use super::SliceError;

/// The calling thread and some helpers.
pub(super) struct Workers {
    /// `None` where the calling thread works alone.
    helpers: Option<rayon::ThreadPool>,
}

impl Workers {
    /// `threads` in all.
    pub(super) fn new(threads: usize) -> Result<Self, SliceError> {
        if threads == 1 {
            return Ok(Self { helpers: None });
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads - 1).thread_name(|_| "slicing".into()).build();
        Ok(Self { helpers: Some(pool.map_err(|error| SliceError::Threads(error.to_string()))?) })
    }

    /// Calls `work` for each item, whichever thread is free.
    pub(super) fn each<T: Send>(&self, items: impl Iterator<Item = T> + Send, work: impl Fn(T) + Sync) {
        self.run(items, &mut vec![(); self.count()], |(), item| work(item));
    }

    /// How many threads, the calling one included.
    pub(super) fn count(&self) -> usize {
        1 + self.helpers.as_ref().map_or(0, rayon::ThreadPool::current_num_threads)
    }

    /// The same, where each thread has one of `states` to itself.
    pub(super) fn run<T: Send, S: Send>(
        &self,
        items: impl Iterator<Item = T> + Send,
        states: &mut [S],
        work: impl Fn(&mut S, T) + Sync,
    ) {
        let Some((own, others)) = states.split_first_mut() else { return };
        let Some(helpers) = &self.helpers else {
            items.for_each(|item| work(own, item));
            return;
        };
        let items = Mutex::new(items);
        let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
        let work_off = |state: &mut S| {
            while let Some(item) = next() {
                work(state, item);
            }
        };
        helpers.in_place_scope(|scope| {
            let work_off = &work_off;
            for state in others {
                scope.spawn(move |_| work_off(state));
            }
            work_off(own);
        });
    }
}
