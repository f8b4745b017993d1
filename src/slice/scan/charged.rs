//! A list whose memory is charged to the budget as it grows. `contours` collects the crossings of a layer in such lists.

use crate::stream::{BudgetExceeded, Charge, MemoryBudget};

/// A growing list. It keeps its memory when it is cleared, for the next layer.
pub(super) struct Charged<T> {
    items: Vec<T>,
    budget: MemoryBudget,
    charge: Option<Charge>,
}

/// Room of a list that begins to grow.
const FIRST: usize = 1024;

impl<T: Copy> Charged<T> {
    /// An empty list without memory.
    pub(super) fn new(budget: &MemoryBudget) -> Self {
        Self { items: Vec::new(), budget: budget.clone(), charge: None }
    }

    /// Adds an item.
    ///
    /// # Errors
    /// [`BudgetExceeded`] if the list has to grow and the memory is not free.
    pub(super) fn push(&mut self, item: T) -> Result<(), BudgetExceeded> {
        self.make_room(1)?;
        self.items.push(item);
        Ok(())
    }

    /// Adds several items.
    ///
    /// # Errors
    /// As [`Charged::push`].
    pub(super) fn extend(&mut self, items: impl ExactSizeIterator<Item = T>) -> Result<(), BudgetExceeded> {
        self.make_room(items.len())?;
        self.items.extend(items);
        Ok(())
    }

    /// Makes room for this many items in all.
    ///
    /// # Errors
    /// As [`Charged::push`].
    pub(super) fn reserve(&mut self, items: usize) -> Result<(), BudgetExceeded> {
        self.make_room(items.saturating_sub(self.items.len()))
    }

    /// Removes all items.
    pub(super) fn clear(&mut self) {
        self.items.clear();
    }

    fn make_room(&mut self, more: usize) -> Result<(), BudgetExceeded> {
        let (len, room) = (self.items.len(), self.items.capacity());
        if room - len >= more {
            return Ok(());
        }
        // Growing by half keeps the copies few. All lists go through the same sizes, so that a sweep that begins at a layer takes no more
        // for it than one that comes from below. The old memory stays charged until the items are in the new.
        let mut wanted = room.max(FIRST);
        while wanted < len + more {
            wanted += wanted / 2;
        }
        let charge = self.budget.charge("a growing list of contour points", (wanted * size_of::<T>()) as u64)?;
        self.items.reserve_exact(wanted - len);
        self.charge = Some(charge);
        Ok(())
    }
}

impl<T> std::ops::Deref for Charged<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.items
    }
}

impl<T> std::ops::DerefMut for Charged<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items
    }
}
