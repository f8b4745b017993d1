//! What the operator reads about a machine with a vat. `tests/device_driver.rs` tests the remedies.

use crate::link::message::Refusal;

/// The part may still be in the resin.
pub(in crate::job::cycle) const UNPARKED: &str = "the plate was not lifted";

/// What is done about a part in the resin while the disk is slow.
pub(in crate::job::cycle) const SLOW_DISK: &str = "For a pause or an end the plate is lifted nevertheless";

/// A device that lost its position must not be homed with a part on the plate.
pub(super) const POSITION_LOST: &str = "the device no longer knows where its plate is, and homing would drive the part into the vat's \
     bottom. Nothing was moved. If the machine can restore its position without going down, do so and resume; otherwise \
     take the part off and start it again";

/// Why a device refused a layer, and what to do.
pub(in crate::job::cycle) fn remedy_of_upload(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotReady => "it is not ready; look at the device, then resume",
        Refusal::NoSuchLayer => "it does not have the slots that it stated; check its firmware",
        Refusal::SlotBusy => {
            "it says that the slot is being exposed, which this job did not ask for; check its firmware"
        }
        Refusal::BadLayer => {
            "it cannot decode the layer; check that the machine file's width_px and height_px are the device's"
        }
        Refusal::BadEncoding => {
            "it does not read the encoding, although it stated that it does; check its firmware, or change `antialias` in the \
             recipe"
        }
        Refusal::Unknown => "it does not know the request; check that it is a DLP machine of this protocol version",
        Refusal::NotRecoated
        | Refusal::WrongVector
        | Refusal::NoSuchVat
        | Refusal::AlreadyExposed
        | Refusal::BadDuration
        | Refusal::BadMove
        | Refusal::NotHomed
        | Refusal::Busy
        | Refusal::CutShort => "this refusal does not apply to a layer; check its firmware",
    }
}

/// Why a device refused an act, and what to do.
pub(in crate::job::cycle) fn remedy_of_act(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotReady => "it is not ready; look at the device, then resume",
        Refusal::AlreadyExposed => "it exposed that layer before",
        Refusal::BadDuration => {
            "the exposure is longer than it allows; lower exposure_ms and bottom_exposure_ms in the recipe"
        }
        Refusal::NoSuchLayer => "it does not hold that layer",
        Refusal::SlotBusy | Refusal::Busy => "it is busy with something this job did not ask for; check its firmware",
        Refusal::BadLayer => "the layer did not arrive whole; check the line",
        Refusal::BadEncoding => "it does not know the encoding; check its firmware",
        Refusal::BadMove => {
            "the position is outside its travel, or the speed is; check lift_speed_um_s, retract_speed_um_s and the part's height"
        }
        Refusal::NotHomed => "it does not know where its plate is; take the part off and start again",
        Refusal::CutShort => "it was ended early by an interlock or at the machine; look at the device, then resume",
        Refusal::NoSuchVat => "it says that no such vat is in place; look at its vats, then resume",
        Refusal::NotRecoated | Refusal::WrongVector => {
            "this refusal does not apply to a DLP machine; check its firmware"
        }
        Refusal::Unknown => "it does not know the request; check that it is a DLP machine of this protocol version",
    }
}
