//! How long the scanner takes, and which vectors a powder machine marks. `docs/protocol.md`, "Powder machines", has the rules.

use crate::encoding::{LaserParameters, Vector, VectorDecoder};

/// Longest time of one vector or one delay, microseconds: 10 s. Real vectors take milliseconds. When the host is silent, the laser is on
/// until its vector ends: for no longer than this.
pub const MAX_VECTOR_US: u64 = 10_000_000;

/// Why the machine marks no such vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadVector {
    /// Of more power than the laser has.
    #[error("its power is {0} mW, above the laser's greatest")]
    Power(u32),
    /// The laser would be on for too long, or a jump would never end.
    #[error("it would take longer than 10 s")]
    TooSlow,
    /// The layer does not say how vectors of this class are marked.
    #[error("its class has no laser parameters")]
    NoParameters,
}

/// The laser parameters of a vector, if a machine with this greatest power marks it.
///
/// # Errors
/// [`BadVector`] says why it does not.
pub fn usable(decoder: &VectorDecoder, vector: &Vector, max_power_mw: u32) -> Result<LaserParameters, BadVector> {
    let laser = *decoder.parameters(vector.class).ok_or(BadVector::NoParameters)?;
    if laser.power_mw > max_power_mw {
        return Err(BadVector::Power(laser.power_mw));
    }
    // Slow jumps are dark, and the time of the act bounds them.
    let is_slow = mark_us(vector, &laser) > MAX_VECTOR_US
        || u64::from(laser.jump_delay_us.max(laser.mark_delay_us).max(laser.polygon_delay_us)) > MAX_VECTOR_US
        || laser.jump_speed_um_s == 0;
    if is_slow { Err(BadVector::TooSlow) } else { Ok(laser) }
}

/// How long the laser is on for a vector, microseconds.
pub fn mark_us(vector: &Vector, laser: &LaserParameters) -> u64 {
    if vector.from_um == vector.to_um {
        return laser.point_time_us.into();
    }
    way_us(vector.from_um, vector.to_um, laser.mark_speed_um_s)
}

/// How long a jump takes, microseconds.
pub fn jump_us(from_um: [i32; 2], to_um: [i32; 2], laser: &LaserParameters) -> u64 {
    way_us(from_um, to_um, laser.jump_speed_um_s)
}

/// Rounded; saturates at speed 0.
fn way_us(from_um: [i32; 2], to_um: [i32; 2], speed_um_s: u32) -> u64 {
    let [x, y] = [0, 1].map(|axis| u128::from(to_um[axis].abs_diff(from_um[axis])));
    let square = 4_000_000_000_000 * (x * x + y * y);
    let halves = square.checked_div(u128::from(speed_um_s).pow(2)).map_or(u128::MAX, u128::isqrt);
    u64::try_from(halves.div_ceil(2)).unwrap_or(u64::MAX)
}
