//! Computing ahead of the printer, inside the memory budget.

mod budget;

pub use budget::{BudgetExceeded, Charge, MemoryBudget};
