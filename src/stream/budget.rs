//! The memory budget: every large buffer of the print path is charged here before it is allocated. `pipeline/memory.rs` counts what a
//! part needs.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::text::size_text;

/// A shared account of bytes with a limit. Clones share the account.
#[derive(Clone, Debug)]
pub struct MemoryBudget {
    account: Arc<Account>,
}

#[derive(Debug)]
struct Account {
    limit_bytes: u64,
    used_bytes: AtomicU64,
    peak_bytes: AtomicU64,
}

/// A buffer that does not fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{what} takes {}, but only {} of the memory budget of {} are free",
    size_text(*need_bytes), size_text(*free_bytes), size_text(*limit_bytes)
)]
pub struct BudgetExceeded {
    /// What the memory was for.
    pub what: &'static str,
    /// Bytes asked for.
    pub need_bytes: u64,
    /// Bytes that were free.
    pub free_bytes: u64,
    /// The limit.
    pub limit_bytes: u64,
}

/// Bytes taken from a budget. Dropping it returns them.
#[derive(Debug)]
pub struct Charge {
    account: Arc<Account>,
    bytes: u64,
}

impl MemoryBudget {
    /// A budget of `limit_bytes`, nothing used.
    pub fn new(limit_bytes: u64) -> Self {
        let account = Account { limit_bytes, used_bytes: AtomicU64::new(0), peak_bytes: AtomicU64::new(0) };
        Self { account: Arc::new(account) }
    }

    /// Takes `bytes` for `what`.
    ///
    /// # Errors
    /// [`BudgetExceeded`] if they are not free; then nothing is taken.
    pub fn charge(&self, what: &'static str, bytes: u64) -> Result<Charge, BudgetExceeded> {
        let account = &self.account;
        let taken = account.used_bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |used| {
            used.checked_add(bytes).filter(|sum| *sum <= account.limit_bytes)
        });
        match taken {
            Ok(before) => {
                account.peak_bytes.fetch_max(before + bytes, Ordering::Relaxed);
                Ok(Charge { account: Arc::clone(account), bytes })
            }
            Err(used) => Err(BudgetExceeded {
                what,
                need_bytes: bytes,
                free_bytes: account.limit_bytes - used,
                limit_bytes: account.limit_bytes,
            }),
        }
    }

    /// The limit in bytes.
    pub fn limit_bytes(&self) -> u64 {
        self.account.limit_bytes
    }

    /// Bytes charged now.
    pub fn used_bytes(&self) -> u64 {
        self.account.used_bytes.load(Ordering::Relaxed)
    }

    /// The most bytes charged at once since this was asked last.
    pub fn take_peak_bytes(&self) -> u64 {
        self.account.peak_bytes.swap(self.used_bytes(), Ordering::Relaxed)
    }

    /// The most bytes ever charged at once, or since [`MemoryBudget::take_peak_bytes`].
    pub fn peak_bytes(&self) -> u64 {
        self.account.peak_bytes.load(Ordering::Relaxed)
    }
}

impl Charge {
    /// Gives back what is above `bytes`.
    pub fn reduce_to(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.account.used_bytes.fetch_sub(less, Ordering::Relaxed);
        self.bytes -= less;
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        self.account.used_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_charge_is_given_back_and_the_peak_is_kept() {
        let budget = MemoryBudget::new(100);
        let first = budget.charge("first", 60).expect("fits");
        let refused = budget.charge("second", 41).expect_err("60 + 41 > 100");
        assert_eq!(refused, BudgetExceeded { what: "second", need_bytes: 41, free_bytes: 40, limit_bytes: 100 });
        assert!(budget.charge("second", u64::MAX).is_err(), "an overflowing request is refused");
        let mut second = budget.charge("second", 40).expect("fits exactly");
        drop(first);
        assert_eq!((budget.used_bytes(), budget.peak_bytes()), (40, 100));
        assert_eq!((budget.take_peak_bytes(), budget.peak_bytes()), (100, 40), "counted anew");
        second.reduce_to(50);
        assert_eq!(budget.used_bytes(), 40, "it has less already");
        second.reduce_to(15);
        assert_eq!(budget.used_bytes(), 15);
        drop(second);
        assert_eq!(budget.used_bytes(), 0);
    }
}
