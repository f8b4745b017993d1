//! Computing ahead of the printer, inside the memory budget.
//!
//! Every large buffer of the print path is charged to the [`MemoryBudget`]. [`Ahead`] is a thread that computes layers, and the
//! bounded queue of finished layers. A layer that is not ready when the machine needs it is late: the printer waits dark, and the
//! job engine counts it.
//!
//! `pipeline` prints with both. By themselves:
//!
//! ```
//! use layerd::stream::{Ahead, MemoryBudget};
//! # tokio::runtime::Runtime::new().unwrap().block_on(async {
//! let budget = MemoryBudget::new(64 << 10);
//! let mut numbers = (0..3_u8).map(|number| (vec![number; 100], 100));
//! let mut ahead = Ahead::start(&budget, 16 << 10, move || Ok(numbers.next())).unwrap();
//! while let Some(finished) = ahead.next().await.unwrap() {
//!     assert_eq!(finished.layer.len(), 100);
//! }
//! drop(ahead);
//! assert_eq!(budget.peak_bytes(), 16 << 10);
//! # });
//! ```

mod ahead;
mod budget;

pub use ahead::{Ahead, Finished, Produced, Room, StreamError};
pub use budget::{BudgetExceeded, Charge, MemoryBudget};
