//! `layerctl raise`. `tests/plate.rs` tests it.

use clap::Args;

use super::client::Client;
use super::{block_on, print, print_json};
use crate::text::mm_text;

/// Lift the plate clear of the resin while no job runs; also while one is interrupted.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl raise
  layerctl device           tells where the plate is, and whether it moves

The plate moves up to the machine's clear_height_um, never down. While a job runs, this is refused: `layerctl pause` or \
`layerctl stop` lifts its plate. While a job is interrupted, it works, and the job can still be resumed. This does not confirm that the plate is empty: a part may still hang there.")]
pub(super) struct RaiseArgs {
    /// Print from_um and to_um as one JSON object.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &RaiseArgs) -> anyhow::Result<()> {
    let raise = block_on(async { Ok(Client::from_environment().raise().await?) })?;
    if args.json {
        return print_json(&raise);
    }
    if let Some(warning) = &raise.warning {
        super::eprint(&format!("warning: {warning}"));
    }
    let [from, to] = [raise.from_um, raise.to_um].map(mm_text);
    if raise.from_um == raise.to_um {
        return print(&format!(
            "the plate is already clear of the resin, {to} above the vat; a part may still hang on it"
        ));
    }
    print(&format!("the plate lifts clear of the resin, from {from} to {to} above the vat"))
}
