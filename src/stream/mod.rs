//! Computing ahead of the printer, inside the memory budget.
//!
//! Every buffer of the print path is charged to the [`MemoryBudget`]. [`Ahead`] is a thread that computes layers, and the bounded queue
//! of finished layers. A layer that is not ready when the machine needs it is late: the printer waits dark, and the job engine
//! counts it.

mod ahead;
mod budget;

pub use ahead::{Ahead, Finished, Produced, Room, StreamError};
pub use budget::{BudgetExceeded, Charge, MemoryBudget};
