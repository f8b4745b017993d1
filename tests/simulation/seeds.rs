//! Fixed seeds of the search, and what it found before.

use layerd::link::message::MachineCapabilities;

use crate::line::LineFault;
use crate::machine::character::Asked;
use crate::machine::{Character, Incident, Lie};
use crate::parts::{Filling, Kind, Layer};
use crate::plan::{LASER_SEEDS, Plan, Planned, What, Wish};
use crate::search::{Search, plan};
use crate::world::run;

/// Enough to meet every kind of fault, on vats and on laser machines, which each fifth run has. A host with two slow cores needs about a minute.
const SEEDS: u64 = 2_500;

#[test]
fn every_invariant_holds_for_fixed_seeds() {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(4);
    let summary = Search { first: 1, seeds: SEEDS, threads, failures: 5, calm: false }.run();
    assert!(summary.is_good(), "{summary}");
    assert_eq!(summary.seeds, SEEDS);
}

#[test]
fn the_same_seed_gives_the_same_run() {
    for seed in 1..=12 {
        let [one, other] = [(); 2].map(|()| run(&plan(seed, false), true));
        assert_eq!(one.trace, other.trace, "seed {seed}");
        assert_eq!((one.turns, one.virtual_us), (other.turns, other.virtual_us), "seed {seed}");
    }
}

#[test]
fn a_search_in_which_nothing_goes_wrong_fails() {
    let summary = Search { first: 1, seeds: 2, threads: 1, failures: 1, calm: true }.run();
    assert!(summary.failed.is_empty(), "{summary}");
    assert!(!summary.is_good() && summary.to_string().contains("proves nothing"), "{summary}");
}

/// Runs what a search found, made smaller. Returns what happened, line by line.
fn holds(seed: u64, character: Character, events: Vec<(u64, What)>) -> String {
    let events = events.into_iter().map(|(at_us, what)| Planned::at(at_us, what)).collect();
    let report = run(&Plan { seed, kind: Plan::kind(seed), character, confirms_plate: true, events }, true);
    let trace = report.trace.join("\n");
    if let Some(violation) = report.violation {
        panic!("{}: {}\n{trace}", violation.invariant, violation.text);
    }
    trace
}

/// An abort came while the job ended as interrupted because the daemon was ending. It was accepted, and nothing recorded it.
#[test]
fn an_abort_during_a_shutdown_outlives_it() {
    holds(
        4567,
        Character::Honest,
        vec![
            (16_548, What::Order(Wish::Submit { part: 0 })),
            (65_659, What::StandStill { for_us: 53_398_137 }),
            (15_167_112, What::End { down_us: 1_500_000 }),
            (24_733_746, What::Order(Wish::Abort { pick: Some(3) })),
        ],
    );
}

/// The power failed soon after a new spool was made: its directories were not on the disk, and an accepted job was gone.
#[test]
fn a_new_spool_survives_a_power_cut() {
    for seed in 0..8 {
        holds(
            seed,
            Character::Honest,
            vec![
                (170_000, What::Order(Wish::Submit { part: 1 })),
                (3_000_000 + seed * 100_000, What::PowerCut { after_calls: None, down_us: 1_500_000 }),
            ],
        );
    }
}

/// A job found an empty plate on one machine and had no light yet. Then another machine was connected, with a part on its plate.
#[test]
fn an_empty_plate_is_that_of_one_machine() {
    holds(
        3676,
        Character::Honest,
        vec![
            (191_871, What::Order(Wish::Submit { part: 1 })),
            (14_972_176, What::OtherMachine { for_us: 3_815_121 }),
            (16_886_933, What::Order(Wish::Again { pick: 0 })),
            (17_785_466, What::PowerCut { after_calls: None, down_us: 3_000_000 }),
        ],
    );
}

/// An operator confirmed that the plate is empty while the job before still printed; the order arrived when it had ended.
#[test]
fn a_plate_is_not_empty_by_an_order_from_before_a_job_ended() {
    for later_ms in 0..40 {
        holds(
            1_006_489,
            Character::Honest,
            vec![
                (345_584, What::Order(Wish::Submit { part: 1 })),
                (15_496_254, What::Order(Wish::Submit { part: 1 })),
                (17_204_099 + 1_000 * later_ms, What::Order(Wish::Resume { pick: 0 })),
            ],
        );
    }
}

/// A job was ordered to end, and the daemon crashed before that was done. Then another job had the machine first: the one to end waited
/// for ever for a confirmation that the plate is empty.
#[test]
fn a_job_that_is_to_end_waits_for_no_empty_plate() {
    holds(
        3_000_429,
        Character::Honest,
        vec![
            (605_523, What::Order(Wish::Submit { part: 2 })),
            (3_033_071, What::Order(Wish::Abort { pick: Some(0) })),
            (3_676_843, What::DiskBroken { per_million: 1_000_000, for_us: 2_387_402 }),
            (6_128_956, What::Order(Wish::Again { pick: 0 })),
            (12_286_469, What::Kill { after_calls: None, down_us: 300_000 }),
        ],
    );
}

/// The journal could not be written, so an abort was forgotten in a crash. Another job had printed meanwhile, and the device named its
/// layer as the last one: the job that came back took its own first layer for unexposed, and exposed it again, on the other's part.
#[test]
fn a_job_does_not_go_on_where_another_has_printed_since() {
    holds(
        8_020_571,
        Character::Honest,
        vec![
            (715_445, What::Order(Wish::Submit { part: 1 })),
            (7_010_819, What::DiskBroken { per_million: 1_000_000, for_us: 2_955_401 }),
            (8_120_876, What::Order(Wish::Abort { pick: Some(0) })),
            (9_968_535, What::Order(Wish::Again { pick: 1 })),
            (13_557_620, What::Kill { after_calls: None, down_us: 300_000 }),
        ],
    );
}

/// A pause was accepted while the job began; the device did not fit, so the job went back into the queue, and the pause was forgotten.
#[test]
fn a_pause_outlives_the_way_back_into_the_queue() {
    let lie = Lie::OtherGeometry { wider_px: 8, higher_um: 0 };
    holds(
        8_066_884,
        Character::Liar { lie, first: 2, count: 2 },
        vec![
            (1_027_083, What::Machine(Incident::PowerCut { off_us: 15_302_311 })),
            (1_139_267, What::Order(Wish::Submit { part: 2 })),
            (2_607_370, What::PowerCut { after_calls: None, down_us: 1_500_000 }),
            (10_165_032, What::DiskSlow { slow_us: 605_409, for_us: 7_708_473 }),
            (14_944_910, What::Order(Wish::Resume { pick: 2 })),
            (14_944_926, What::Order(Wish::Pause { pick: 3 })),
        ],
    );
}

/// The line was down when a job was aborted, so the abort was sent in the first session of the next job. That job's layers were refused,
/// and it failed, before the answer to the abort arrived.
#[test]
fn a_job_begins_after_the_abort_of_the_one_before_is_answered() {
    holds(
        8_138_819,
        Character::Honest,
        vec![
            (422_847, What::Order(Wish::Submit { part: 0 })),
            (468_732, What::DiskBroken { per_million: 1_000_000, for_us: 1_060_410 }),
            (10_370_525, What::Line(LineFault::Unplugged { for_us: 6_307_208 })),
            (12_739_829, What::Line(LineFault::Delay { extra_us: 1_500_000, for_us: 12_878_678 })),
            (
                19_770_831,
                What::Line(LineFault::Noise {
                    loss_per_million: 0,
                    corrupt_per_million: 100_000,
                    duplicate_per_million: 100_000,
                    for_us: 13_129_224,
                }),
            ),
            (21_706_370, What::Order(Wish::Abort { pick: Some(3) })),
        ],
    );
}

/// A file for an upload was made, and then could not be looked at: it was left over.
#[test]
fn a_file_that_was_made_is_not_left_over_when_reading_fails() {
    holds(
        9_022_475,
        Character::Honest,
        vec![
            (404_050, What::Order(Wish::Submit { part: 1 })),
            (2_124_436, What::Kill { after_calls: None, down_us: 50_000 }),
            (
                6_368_802,
                What::Line(LineFault::Noise {
                    loss_per_million: 300_000,
                    corrupt_per_million: 300_000,
                    duplicate_per_million: 0,
                    for_us: 2_893_803,
                }),
            ),
            (9_000_863, What::Order(Wish::Resume { pick: 1 })),
            (11_995_819, What::End { down_us: 300_000 }),
            (12_412_899, What::DiskUnreadable { name: None, per_million: 300_000, for_us: 9_624_339 }),
            (17_893_579, What::Order(Wish::Resume { pick: 1 })),
            (20_704_233, What::Order(Wish::Submit { part: 2 })),
        ],
    );
}

/// The daemon was asked to end while a submission was being stored: it was refused, and the job was there after the next start.
#[test]
fn a_submission_under_way_is_answered_before_the_daemon_ends() {
    holds(
        10_256_090,
        Character::Honest,
        vec![(196_814, What::Order(Wish::Submit { part: 2 })), (206_249, What::End { down_us: 20_000_000 })],
    );
}

/// A paused job whose device broke the protocol three times was to end, and did not: it had parked already.
#[test]
fn a_paused_job_ends_when_the_device_breaks_the_protocol() {
    let lie = Lie::RepliesNever { of: Asked::State };
    holds(
        114_064,
        Character::Liar { lie, first: 9, count: 3 },
        vec![
            (56_586, What::Order(Wish::Submit { part: 0 })),
            (1_094_272, What::Order(Wish::Pause { pick: 0 })),
            (21_318_733, What::Order(Wish::Pause { pick: 0 })),
        ],
    );
}

/// The spool was moved aside while the daemon ran: the refusal says what to do, and prints go on after that.
#[test]
fn a_spool_that_is_moved_aside_is_told() {
    holds(
        27,
        Character::Honest,
        vec![
            (300_000, What::Order(Wish::Submit { part: 2 })),
            (12_000_000, What::SpoolReplaced { while_down: false }),
            (14_000_000, What::Line(LineFault::Split { for_us: 100_000 })),
        ],
    );
}

/// An abort was answered, the daemon crashed, and the next one could not read the journal at first: nobody carried the abort out.
#[test]
fn a_journal_that_cannot_be_read_at_the_start_is_read_later() {
    holds(
        589,
        Character::Honest,
        vec![
            (58_404, What::Order(Wish::Submit { part: 2 })),
            (7_388_749, What::Order(Wish::Abort { pick: None })),
            (7_420_000, What::DiskUnreadable { name: Some("journal"), per_million: 1_000_000, for_us: 4_000_000 }),
            (7_450_000, What::Kill { after_calls: None, down_us: 300_000 }),
        ],
    );
}

/// The journal of a queued job could not be read at a start. It was resumed later as if its part were on the plate, so nobody was asked
/// whether the plate is empty.
#[test]
fn a_queued_job_whose_journal_was_read_late_waits_for_an_empty_plate() {
    holds(
        590,
        Character::Honest,
        vec![
            (58_404, What::Order(Wish::Submit { part: 2 })),
            (5_000_000, What::Order(Wish::Submit { part: 2 })),
            (16_000_000, What::DiskUnreadable { name: Some("journal"), per_million: 1_000_000, for_us: 4_000_000 }),
            (16_500_000, What::Kill { after_calls: None, down_us: 300_000 }),
        ],
    );
}

/// A new job was in the spool, and then its journal could not be opened: the job was refused, and there after a restart.
#[test]
fn a_job_that_was_refused_is_not_there_after_a_crash() {
    for seed in 0..20 {
        let mut events =
            vec![(100_000, What::DiskUnreadable { name: Some("journal"), per_million: 300_000, for_us: 3_000_000 })];
        events.extend((0..8).map(|count| (200_000 + 300_000 * count, What::Order(Wish::Submit { part: 2 }))));
        events.push((4_000_000, What::Kill { after_calls: None, down_us: 300_000 }));
        holds(seed, Character::Honest, events);
    }
}

/// A stop was carried out and its record could not be written, as the answer said. An abort that had come meanwhile was answered as if
/// the end were on the disk.
#[test]
fn every_order_to_end_a_job_warns_that_its_end_is_not_written() {
    holds(
        11_016_330,
        Character::Honest,
        vec![
            (1_508_436, What::Order(Wish::Submit { part: 0 })),
            (8_531_466, What::DiskUnreadable { name: Some("journal"), per_million: 1_000_000, for_us: 14_063_865 }),
            (11_098_522, What::Order(Wish::Stop { pick: 0 })),
            (11_100_502, What::Order(Wish::Abort { pick: None })),
            (20_821_629, What::End { down_us: 50_000 }),
        ],
    );
}

/// A machine was exchanged while it exposed, and the other one obeyed the abort of its job. After a restart the daemon found the first
/// machine lit, and took the light of a job that was over for commanded.
#[test]
fn light_of_a_job_that_is_over_is_put_off_after_a_restart() {
    holds(
        11_020_604,
        Character::Honest,
        vec![
            (38_223, What::Order(Wish::Submit { part: 2 })),
            (2_688_517, What::OtherMachine { for_us: 2_598_827 }),
            (2_950_044, What::Order(Wish::Abort { pick: None })),
            (6_034_611, What::PowerCut { after_calls: None, down_us: 50_000 }),
        ],
    );
}

/// The spool was moved aside while the journal of a job in it could not be read: the operator who orders the job to end is told.
#[test]
fn a_job_whose_journal_is_gone_with_its_spool_can_be_ended() {
    holds(
        11_036_023,
        Character::Honest,
        vec![
            (1_534_664, What::Order(Wish::Submit { part: 2 })),
            (4_776_049, What::DiskUnreadable { name: Some("journal"), per_million: 1_000_000, for_us: 8_489_048 }),
            (11_305_087, What::Kill { after_calls: None, down_us: 50_000 }),
            (13_806_336, What::SpoolReplaced { while_down: false }),
        ],
    );
}

/// A queued job was told to end while it was being opened, and its journal could not be read: it failed, and the order was answered as if
/// that were on the disk. After a restart the job was in the queue again.
#[test]
fn a_job_that_fails_while_it_is_opened_warns_who_ended_it() {
    for later_ms in [0, 200, 400, 600, 800] {
        holds(
            1,
            Character::Honest,
            vec![
                (100_000, What::DiskSlow { slow_us: 1_000_000, for_us: 9_000_000 }),
                (200_000, What::Order(Wish::Submit { part: 2 })),
                (4_300_000, What::DiskUnreadable { name: Some("journal"), per_million: 1_000_000, for_us: 4_000_000 }),
                (4_400_000 + 1_000 * later_ms, What::Order(Wish::Abort { pick: Some(0) })),
                (8_500_000, What::Kill { after_calls: None, down_us: 300_000 }),
            ],
        );
    }
}

/// A plate was moved by hand while powder was spread. The daemon did not compare where it was, and the layer was marked at another depth.
#[test]
fn a_plate_that_is_moved_while_powder_is_spread_stops_the_print() {
    for later_ms in [0, 800, 1_600, 2_400, 3_200, 4_000] {
        for to_um in [22, 160, 6_891] {
            holds(
                LASER_SEEDS + later_ms,
                Character::Honest,
                vec![
                    (1_000_000, What::Order(Wish::Submit { part: 2 })),
                    (7_000_000 + 1_000 * later_ms, What::Machine(Incident::PlateMovedByHand { to_um })),
                ],
            );
        }
    }
}

/// A paused job was resumed while the disk hung, and its next move waited for the record of that. Somebody pushed the plate meanwhile.
/// Nobody compared its position, and the move drove it back, with its part.
#[test]
fn a_plate_that_is_moved_while_a_move_waits_for_the_disk_stops_the_print() {
    for later_ms in [0, 300, 700, 1_200, 1_800, 2_500] {
        for first in [0, LASER_SEEDS] {
            holds(
                first + later_ms,
                Character::Honest,
                vec![
                    (1_000_000, What::Order(Wish::Submit { part: 2 })),
                    (12_000_000, What::Order(Wish::Pause { pick: 0 })),
                    (24_000_000, What::Order(Wish::Resume { pick: 0 })),
                    (24_000_400, What::DiskHangs { for_us: 4_000_000 }),
                    (25_000_000 + 1_000 * later_ms, What::Machine(Incident::PlateMovedByHand { to_um: 8_125 })),
                ],
            );
        }
    }
}

/// The line was lost while powder was spread. The recoater went on, the order to spread powder was refused in the next session because
/// the machine was busy, and the print was interrupted.
#[test]
fn a_line_lost_while_powder_is_spread_interrupts_no_print() {
    for later_ms in [0, 900, 1_800, 2_700, 3_600, 4_500] {
        let trace = holds(
            LASER_SEEDS + later_ms,
            Character::Honest,
            vec![
                (1_000_000, What::Order(Wish::Submit { part: 2 })),
                (2_500_000 + 1_000 * later_ms, What::Line(LineFault::Unplugged { for_us: 300_000 })),
            ],
        );
        assert!(!trace.contains(" interrupted "), "{trace}");
    }
}

/// The larger layers are longer than the machine's buffer and stream through it; the others fit it, and the last has no vectors.
#[test]
fn some_layers_of_laser_parts_stream() {
    for filling in [Filling::Zigzag, Filling::Chessboard] {
        let kind = Kind::Laser(filling);
        let MachineCapabilities::Powder(powder) = kind.capabilities().machine else { panic!("{filling:?}") };
        let layers: Vec<_> = kind.parts().iter().flat_map(|part| &part.layers).filter_map(Layer::scanned).collect();
        let streaming = layers.iter().filter(|layer| layer.encoded_bytes > powder.buffer_bytes).count();
        let wanted = if filling == Filling::Chessboard { 4 } else { 0 };
        assert!(streaming >= wanted && layers.len() - streaming >= 4, "{filling:?}: {streaming} of {}", layers.len());
        assert!(layers.iter().all(|layer| layer.times.vectors < 1000 && layer.times.mark_ms < 10_000), "{filling:?}");
        assert!(layers.iter().any(|layer| layer.times.vectors == 0), "{filling:?}");
    }
}
