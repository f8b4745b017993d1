//! Whatever a host sends, light is bounded and nothing is exposed twice.

use layerd::link::message::{HostMessage, Request, Urgent, VatRequest};
use proptest::prelude::*;

use crate::device_common::{Bench, capabilities, id};
use crate::properties;

#[derive(Clone, Debug)]
enum Step {
    Message(HostMessage),
    Urgent(Urgent),
    Advance(u64),
    Silence,
    Hello,
    Reset,
}

fn step() -> impl Strategy<Value = Step> {
    let layer = 0u32..6;
    let request = prop_oneof![
        4 => (layer, prop_oneof![Just(0u32), 1u32..3000, Just(400_000)])
            .prop_map(|(layer, duration_ms)| Request::Vat(VatRequest::Expose { id: id(layer), duration_ms, light_pwm: 200 })),
        1 => Just(Request::Vat(VatRequest::Home)),
        1 => (-5i32..70_000, 0u32..30_000).prop_map(|(position_um, speed_um_s)| Request::Vat(VatRequest::Move { position_um, speed_um_s })),
        1 => Just(Request::State),
    ];
    let urgent = prop_oneof![Just(Urgent::Abort), Just(Urgent::LightOff), Just(Urgent::Hold), Just(Urgent::Release)];
    prop_oneof![
        6 => request.prop_map(|request| Step::Message(HostMessage::Request { number: 0, request })),
        2 => prop::collection::vec(any::<u8>(), 0..40).prop_map(|bytes| Step::Message(HostMessage::LayerData(bytes))),
        1 => urgent.prop_map(Step::Urgent),
        4 => (0u64..4_000_000).prop_map(Step::Advance),
        1 => Just(Step::Silence),
        3 => Just(Step::Hello),
        1 => Just(Step::Reset),
    ]
}

proptest! {
    #![proptest_config(properties::cases(300))]

    /// Whatever a host does: light on and off alternate, never for longer than the device's maximum, and of one job the
    /// layers exposed only ascend.
    #[test]
    fn light_is_bounded_and_nothing_is_exposed_twice(steps in prop::collection::vec((step(), 0u32..6), 1..60)) {
        let mut bench = Bench::new();
        for (step, layer) in steps {
            if bench.core.state().slots.contains(&None) {
                bench.try_upload(id(layer));
            }
            match step {
                Step::Message(message) => bench.message(message),
                Step::Urgent(urgent) => {
                    let light_on = bench.urgent(urgent);
                    prop_assert!(!(light_on && matches!(urgent, Urgent::Abort | Urgent::LightOff)));
                }
                Step::Advance(us) => bench.advance(us),
                Step::Silence => bench.silence(),
                Step::Hello => { bench.hello(); }
                Step::Reset => bench.reset(77),
            }
        }
        bench.advance(10_000_000_000);
        prop_assert!(!bench.core.state().light_on);
        let (mut lit_since, mut last) = (None, None);
        for record in &bench.records {
            match record.event {
                "light_on" => {
                    prop_assert_eq!(lit_since, None);
                    lit_since = Some(record.t_ms);
                }
                "light_off" => {
                    let since = lit_since.take();
                    prop_assert!(since.is_some_and(|since| record.t_ms - since <= u64::from(capabilities().max_exposure_ms)));
                }
                "moved" => prop_assert_eq!(lit_since, None),
                "exposed" => {
                    prop_assert!(record.layer > last, "{:?} after {:?}", record.layer, last);
                    last = record.layer;
                }
                _ => {}
            }
        }
        prop_assert_eq!(lit_since, None);
    }
}
