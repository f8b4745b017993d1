//! What the operator reads about a machine with a bed of powder. `tests/job_powder.rs` tests the remedies.

use crate::link::message::Refusal;

/// The machine was not brought to rest.
pub(in crate::job::cycle) const UNPARKED: &str = "plate and recoater were left as they are";

/// What is done about a part while the disk is slow.
pub(in crate::job::cycle) const SLOW_DISK: &str = "The part waits in the powder, with the laser off";

/// A device that lost its position must not be homed with a part in the powder.
pub(super) const POSITION_LOST: &str = "the device no longer knows where its plate is, and homing would raise the part into the recoater's \
     way. Nothing was moved. If the machine can restore its position without going up, do so and resume; otherwise \
     take the part out and start it again";

/// Why a device refused a layer, and what to do.
pub(in crate::job::cycle) fn remedy_of_upload(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotReady => "it is not ready; look at the device, then resume",
        Refusal::NoSuchLayer => "it does not have the slots that it stated; check its firmware",
        Refusal::SlotBusy => {
            "it says that the slot is being marked, which this job did not ask for; check its firmware"
        }
        Refusal::BadLayer => "it cannot decode the layer; check that the machine file's field_um is the device's",
        Refusal::BadEncoding => "it does not read the encoding, although it stated that it does; check its firmware",
        Refusal::Unknown => UNKNOWN,
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
        Refusal::AlreadyExposed => "it marked that layer before",
        Refusal::BadDuration => "it does not allow marking for so long; check its firmware",
        Refusal::NoSuchLayer => "it does not hold that layer",
        Refusal::SlotBusy | Refusal::Busy => "it is busy with something this job did not ask for; check its firmware",
        Refusal::BadLayer => "a vector of the layer is beyond the laser's power; lower laser_power_w in the recipe",
        Refusal::BadEncoding => "it does not know the encoding; check its firmware",
        Refusal::BadMove => {
            "the depth is outside its travel, or the speed is; check plate_speed_um_s and the part's height"
        }
        Refusal::NotHomed => "it does not know where its plate is; take the part out and start again",
        Refusal::NoSuchVat => "this refusal does not apply to a laser machine; check its firmware",
        Refusal::NotRecoated => "it says that no powder was spread; look at the recoater, then resume",
        Refusal::WrongVector => {
            "it does not agree on how far the layer was marked; look at layer and device, then resume, or abort the job"
        }
        Refusal::CutShort => "it was ended early by an interlock or at the machine; look at the device, then resume",
        Refusal::Unknown => UNKNOWN,
    }
}

const UNKNOWN: &str = "it does not know the request; check that it is an SLM machine of this protocol version";
