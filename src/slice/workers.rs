//! The threads of a slicer. They live as long as the slicer, because starting a thread takes longer than drawing a small layer.
//! `slicer` owns them.

use std::sync::{Mutex, PoisonError};

use super::SliceError;

/// The calling thread and some helpers.
pub(super) struct Workers {
    /// `None` if the calling thread works alone.
    helpers: Option<rayon::ThreadPool>,
}

impl Workers {
    /// `threads` threads in total, at least 1.
    pub(super) fn new(threads: usize) -> Result<Self, SliceError> {
        if threads == 1 {
            return Ok(Self { helpers: None });
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads - 1).thread_name(|_| "slicing".into()).build();
        Ok(Self { helpers: Some(pool.map_err(|error| SliceError::Threads(error.to_string()))?) })
    }

    /// Calls `work` for each item. Each free thread takes the next item.
    pub(super) fn each<T: Send>(&self, items: impl Iterator<Item = T> + Send, work: impl Fn(T) + Sync) {
        self.run(items, &mut vec![(); self.count()], |(), item| work(item));
    }

    /// Number of threads, including the calling one.
    pub(super) fn count(&self) -> usize {
        1 + self.helpers.as_ref().map_or(0, rayon::ThreadPool::current_num_threads)
    }

    /// As [`Workers::each`], with one of `states` for each thread.
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
