//! Parts of several materials, from the source to their masks.

mod control;
mod elliptic;
mod halftone;
#[path = "../pack_bench/mod.rs"]
mod pack_bench;
#[path = "../slice_part/mod.rs"]
mod slice_part;
mod sources;

#[path = "../properties/mod.rs"]
mod properties;
mod regions;
