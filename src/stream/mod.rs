//! Computing ahead of the printer, inside the memory budget.
//!
//! [`MemoryBudget`] is the account that every buffer of the print path is charged to; [`Ahead`] is the thread that computes
//! layers and the bounded queue of finished ones. Neither knows what a layer is. A layer that is not ready when the device
//! wants it is late: the printer waits dark, and the job engine counts it.

mod ahead;
mod budget;

pub use ahead::{Ahead, Finished, Produced, Room, StreamError};
pub use budget::{BudgetExceeded, Charge, MemoryBudget};
