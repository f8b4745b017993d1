//! The journal on a real file system: torn tails, flipped bits, full disks, files that vanish.

mod properties;
mod skip;

use std::fs;
use std::path::Path;

use layerd::job::{
    EndOrder, Entries, Entry, History, JobState, Journal, JournalError, Record, ResumeChoice, ResumeError, Trace,
    read_journal,
};
use proptest::prelude::*;
use tempfile::TempDir;

fn accepted() -> Record {
    Record::Accepted { key: 7, layer_count: 9, name: "cube".into() }
}

fn records() -> Vec<Record> {
    vec![
        accepted(),
        Record::Started { exposure: 0 },
        Record::Commanded { exposure: 0, boot_id: 5 },
        Record::Confirmed { exposure: 0 },
        Record::Paused,
        Record::Resumed,
        Record::Commanded { exposure: 1, boot_id: 5 },
        Record::InDoubt { exposure: 1, why: "its light was cut short after 40 ms".into() },
        Record::Ended { state: JobState::Interrupted, reason: "layer 1 is in doubt".into() },
    ]
}

/// Writes the journal; gives its length after each record.
fn write(path: &Path) -> Vec<usize> {
    let length = || fs::metadata(path).expect("there").len() as usize;
    let mut records = records().into_iter();
    let mut journal = Journal::create(path, records.next().expect("first"), 1000).expect("created");
    let mut ends = vec![length()];
    for (index, record) in records.enumerate() {
        journal.append(record, 1001 + index as u64).expect("appended");
        ends.push(length());
    }
    ends
}

fn texts(entries: &[Entry]) -> Vec<Record> {
    entries.iter().map(|entry| entry.record.clone()).collect()
}

#[test]
fn what_is_written_is_read() {
    let directory = TempDir::new().expect("temp");
    let path = directory.path().join("journal");
    write(&path);
    let (entries, history) = read_journal(&path).expect("whole");
    assert_eq!(texts(&entries), records());
    assert_eq!(entries[3].at_unix_ms, 1003);
    assert_eq!((history.state, history.next_exposure), (JobState::Interrupted, 1));
    let refused = history.start(ResumeChoice::None).expect_err("in doubt").to_string();
    assert!(refused.contains("--in-doubt exposed") && refused.contains("--in-doubt repeat"), "{refused}");
    assert!(history.start(ResumeChoice::Repeat).expect("decided").in_doubt);
    assert!(Journal::create(&path, accepted(), 0).is_err(), "never over another journal");
}

#[test]
fn a_journal_cut_at_any_byte_keeps_every_whole_record_and_can_be_gone_on_with() {
    let directory = TempDir::new().expect("temp");
    let path = directory.path().join("journal");
    let ends = write(&path);
    let whole = fs::read(&path).expect("read");
    for cut in 0..whole.len() {
        fs::write(&path, &whole[..cut]).expect("write");
        let kept = ends.iter().filter(|end| **end <= cut).count();
        if kept == 0 {
            assert!(Journal::open(&path).is_err(), "no job without its acceptance ({cut})");
            continue;
        }
        let (mut journal, history) = Journal::open(&path).expect("a torn tail is no damage");
        assert_eq!(history.dropped, None, "half a record is no damage ({cut})");
        assert_eq!(fs::metadata(&path).expect("there").len() as usize, ends[kept - 1], "the torn record is cut off");
        assert!(!history.state.is_active());
        journal.append(Record::Paused, 5).expect("goes on");
        let (entries, _) = read_journal(&path).expect("whole again");
        let mut expected = records()[..kept].to_vec();
        expected.push(Record::Paused);
        assert_eq!(texts(&entries), expected);
    }
}

/// A journal of many layers: its records are those of layer 0 over and over, which [`Entries`] does not judge.
fn long_journal(path: &Path, layers: usize) {
    let mut journal = Journal::create(path, accepted(), 1).expect("created");
    let first = fs::metadata(path).expect("there").len() as usize;
    journal.append(Record::Commanded { exposure: 0, boot_id: 5 }, 2).expect("appended");
    journal.append(Record::Confirmed { exposure: 0 }, 3).expect("appended");
    let mut bytes = fs::read(path).expect("read");
    let layer = bytes[first..].repeat(layers - 1);
    bytes.extend(layer);
    fs::write(path, bytes).expect("written");
}

#[test]
fn a_long_journal_is_read_entry_by_entry_up_to_what_is_damaged() {
    let directory = TempDir::new().expect("temp");
    let path = directory.path().join("journal");
    long_journal(&path, 20_000);
    let entries: Result<Vec<_>, _> = Entries::open(&path).expect("opened").collect();
    let entries = entries.expect("whole");
    assert_eq!(entries.len(), 40_001);
    assert_eq!(entries[40_000], Entry { at_unix_ms: 3, record: Record::Confirmed { exposure: 0 } });
    let whole = fs::read(&path).expect("read");
    // Half a record at the end is one that is being written.
    fs::write(&path, &whole[..whole.len() - 5]).expect("written");
    assert!(Entries::open(&path).expect("opened").all(|entry| entry.is_ok()));
    assert_eq!(Entries::open(&path).expect("opened").count(), 40_000);
    let (length, middle) = (whole.len(), whole.len() / 2);
    let mut damaged = whole;
    damaged[middle] ^= 0x10;
    fs::write(&path, damaged).expect("written");
    let read: Vec<_> = Entries::open(&path).expect("opened").collect();
    let (last, before) = read.split_last().expect("entries");
    assert!(before.iter().all(Result::is_ok) && before.len() > 19_000 && before.len() < 21_000, "{}", before.len());
    let error = last.as_ref().expect_err("damaged").to_string();
    assert!(error.contains(&format!("record {} at byte ", before.len())), "{error}");
    let at: usize =
        error.split("at byte ").nth(1).and_then(|rest| rest.split(' ').next()?.parse().ok()).expect("a place");
    assert!(at <= middle && middle < at + 100 && at < length, "{error}");
    fs::write(&path, b"something else").expect("written");
    let read: Vec<_> = Entries::open(&path).expect("opened").collect();
    assert!(
        matches!(&read[..], [Err(error)] if error.to_string().contains("does not begin like a journal")),
        "{read:?}"
    );
}

#[test]
fn a_pipe_in_place_of_a_journal_is_refused_and_not_waited_for() {
    let directory = TempDir::new().expect("directory");
    let path = directory.path().join("journal");
    let made = std::process::Command::new("mkfifo").arg(&path).status().expect("mkfifo runs");
    assert!(made.success());
    for error in [read_journal(&path).map(|_| ()), Journal::open(&path).map(|_| ())].map(Result::err) {
        let error = error.expect("no journal");
        assert!(error.may_be_mended() && error.to_string().contains("it is not a regular file"), "{error}");
    }
}

#[test]
fn a_flipped_bit_is_never_read_as_a_record() {
    let directory = TempDir::new().expect("temp");
    let path = directory.path().join("journal");
    let ends = write(&path);
    let whole = fs::read(&path).expect("read");
    let last = ends[ends.len() - 2];
    for bit in 0..whole.len() * 8 {
        let mut bytes = whole.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        fs::write(&path, &bytes).expect("write");
        match read_journal(&path) {
            // Damage in the last record can be a write that did not end. It is told, unless the length says that more was to come.
            Ok((entries, history)) => {
                assert!(bit / 8 >= last, "byte {}: damage before the last record was not seen", bit / 8);
                assert_eq!(texts(&entries), records()[..records().len() - 1]);
                let stated = u32::from_le_bytes(*bytes[last..].first_chunk().expect("a length")) as usize;
                let is_longer = stated > bytes.len() - last - 8 && stated <= 16 << 10;
                assert_eq!(history.dropped.is_none(), is_longer, "bit {bit}: {:?}", history.dropped);
                let place = format!("is damaged and was dropped: record {} at byte {last}", records().len() - 1);
                assert!(history.dropped.is_none_or(|text| text.contains(&place)));
            }
            Err(error) => {
                assert!(bit / 8 < last, "byte {}: {error}", bit / 8);
                let text = error.to_string();
                assert!(text.contains("journal") && text.contains("start the part again"), "{text}");
            }
        }
    }
}

#[test]
fn records_that_contradict_each_other_are_refused() {
    let started = Record::Started { exposure: 0 };
    let impossible = [
        vec![started.clone()],
        vec![accepted(), accepted()],
        vec![accepted(), started.clone(), Record::Confirmed { exposure: 0 }],
        vec![accepted(), started.clone(), Record::Commanded { exposure: 3, boot_id: 1 }],
        vec![accepted(), Record::Ended { state: JobState::Stopped, reason: String::new() }, started],
    ];
    for records in &impossible {
        assert!(History::replay(records).is_err(), "{records:?}");
    }
}

#[test]
fn a_crash_leaves_the_job_interrupted_at_the_layer_commanded() {
    let records = [accepted(), Record::Started { exposure: 0 }, Record::Commanded { exposure: 0, boot_id: 5 }];
    let history = History::replay(&records).expect("true");
    assert_eq!((history.state, history.next_exposure), (JobState::Interrupted, 0));
    let start = history.start(ResumeChoice::None).expect("the device is asked first");
    assert_eq!(start.unconfirmed.map(|commanded| commanded.boot_id), Some(5));
    let over = [accepted(), Record::Ended { state: JobState::Aborted, reason: String::new() }];
    let refused = History::replay(&over).expect("true").start(ResumeChoice::Repeat);
    assert_eq!(refused, Err(ResumeError::Over(JobState::Aborted)));
}

proptest! {
    #![proptest_config(properties::cases(256))]

    #[test]
    fn garbage_is_an_error_or_a_journal_but_no_panic(garbage in prop::collection::vec(any::<u8>(), 0..200)) {
        let directory = TempDir::new().expect("temp");
        let path = directory.path().join("journal");
        fs::write(&path, [b"layerjnl\x01\0\0\0".as_slice(), &garbage].concat()).expect("write");
        prop_assert!(read_journal(&path).is_err(), "no acceptance in garbage");
    }
}

#[test]
fn an_order_outlives_a_crash_and_an_abort_a_stop() {
    let ordered = |orders: &[EndOrder]| {
        let begun = [accepted(), Record::Started { exposure: 0 }, Record::Commanded { exposure: 0, boot_id: 5 }];
        let records: Vec<_> = begun.into_iter().chain(orders.iter().map(|order| Record::Ordered(*order))).collect();
        History::replay(&records).expect("true")
    };
    use EndOrder::{Abort, Stop};
    assert_eq!(ordered(&[]).ordered, None);
    assert_eq!(ordered(&[Stop]).ordered, Some(Stop));
    assert_eq!(ordered(&[Stop, Abort]).ordered, Some(Abort));
    let history = ordered(&[Abort, Stop]);
    assert_eq!((history.state, history.ordered), (JobState::Interrupted, Some(Abort)));
    assert_eq!(history.start(ResumeChoice::Repeat), Err(ResumeError::Ordered(Abort)));
    assert!(history.start_to_end().is_ok());
}

#[test]
fn what_the_operator_knows_of_a_device_is_kept() {
    let traces = vec![Trace::Lit { job: 9, layer: 4 }, Trace::Held { job: 9, layer: 5 }];
    let clear = |boot_id| Record::PlateClear { boot_id, traces: traces.clone() };
    let history = History::replay(&[accepted(), clear(1), Record::Started { exposure: 0 }, clear(2)]).expect("true");
    assert_eq!((history.plate_clear_on, &history.traces, history.touched()), (Some(2), &traces, false));
}

#[test]
fn a_journal_that_vanishes_is_noticed_at_the_next_record() {
    type Loss = fn(&Path) -> std::io::Result<()>;
    let losses: [Loss; 4] = [
        |job| fs::remove_file(job.join("journal")),
        |job| fs::remove_dir_all(job),
        |job| fs::rename(job, job.with_extension("old")),
        |job| {
            // Another file in its place is not this journal either.
            fs::rename(job.join("journal"), job.join("other"))?;
            fs::copy(job.join("other"), job.join("journal")).map(drop)
        },
    ];
    for (index, lose) in losses.into_iter().enumerate() {
        let directory = TempDir::new().expect("temp");
        let job = directory.path().join("job");
        fs::create_dir(&job).expect("made");
        let path = job.join("journal");
        let mut journal = Journal::create(&path, accepted(), 0).expect("created");
        journal.append(Record::Started { exposure: 0 }, 1).expect("there");
        lose(&job).expect("lost");
        let error = journal.append(Record::Paused, 2).expect_err("lost");
        assert!(matches!(error, JournalError::Vanished { .. }), "loss {index}: {error}");
        assert!(error.to_string().contains("no longer there"), "{error}");
        assert!(journal.append(Record::Paused, 3).is_err(), "nothing more is written");
    }
}

#[test]
fn a_journal_that_was_cut_or_extended_is_noticed_at_the_next_record() {
    for by_bytes in [i64::MIN, -1, 1] {
        let directory = TempDir::new().expect("temp");
        let path = directory.path().join("journal");
        let mut journal = Journal::create(&path, accepted(), 0).expect("created");
        journal.append(Record::Started { exposure: 0 }, 1).expect("there");
        let written = fs::metadata(&path).expect("there").len();
        let found = written.saturating_add_signed(by_bytes);
        fs::OpenOptions::new().write(true).open(&path).and_then(|file| file.set_len(found)).expect("changed");
        let error = journal.append(Record::Paused, 2).expect_err("altered");
        let is_altered = matches!(error, JournalError::Altered { found_bytes, .. } if found_bytes == found);
        assert!(is_altered && error.to_string().contains(&format!("{written} were written")), "{error}");
        assert!(journal.append(Record::Paused, 3).is_err(), "nothing more is written");
        assert_eq!(fs::metadata(&path).expect("there").len(), found, "what is left stays as it is");
    }
}

/// A file system of its own, small enough to fill; `None`, saying so, where that takes more rights.
struct SmallDisk(TempDir);

impl SmallDisk {
    fn mount() -> Option<Self> {
        let directory = TempDir::new().expect("temp");
        let mut mount = std::process::Command::new("mount");
        let mounted = mount.args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"]).arg(directory.path()).output();
        if !mounted.is_ok_and(|output| output.status.success()) {
            skip::skipped("mounting a small disk takes root");
            return None;
        }
        Some(Self(directory))
    }

    fn fill(&self) {
        let mut filler = fs::File::create(self.0.path().join("filler")).expect("filler");
        while std::io::Write::write_all(&mut filler, &[0; 4096]).is_ok() {}
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_takes_no_new_layer_but_every_end() {
    let Some(disk) = SmallDisk::mount() else { return };
    let path = disk.0.path().join("journal");
    let accepted = Record::Accepted { key: 7, layer_count: 10_000, name: "tower".into() };
    let mut journal = Journal::create(&path, accepted, 0).expect("created");
    assert!(journal.is_reserved());
    journal.append(Record::Started { exposure: 0 }, 1).expect("room");
    disk.fill();
    // What is set aside at once beyond the reserve is used up first.
    let mut layer = 0;
    let refused = loop {
        if let Err(error) = journal.append(Record::Commanded { exposure: layer, boot_id: 1 }, 2) {
            break error.to_string();
        }
        journal.append(Record::Confirmed { exposure: layer }, 3).expect("its light has fallen");
        layer += 1;
        assert!(layer < 10_000, "the disk is full");
    };
    assert!(refused.contains("No space left") && refused.contains("layerctl remove"), "{refused}");
    // A new try, and a job that ends resumable on the full disk once more, do not use up the room of the last end.
    drop(journal);
    let reason = "x".repeat(1000);
    for _ in 0..50 {
        let (mut journal, _) = Journal::open(&path).expect("readable");
        assert!(journal.append(Record::Started { exposure: 0 }, 4).is_err());
        let _ = journal.append(Record::Ended { state: JobState::Interrupted, reason: reason.clone() }, 5);
    }
    let (mut journal, _) = Journal::open(&path).expect("readable");
    journal.append(Record::Ordered(EndOrder::Abort), 6).expect("room");
    journal.append(Record::LightOff, 7).expect("room");
    journal.append(Record::Parked, 8).expect("room");
    journal.append(Record::Ended { state: JobState::Aborted, reason }, 9).expect("room");
    let (_, history) = read_journal(&path).expect("whole");
    assert_eq!((history.state, history.parked), (JobState::Aborted, true));
    // The room is given back.
    let used_bytes = std::os::unix::fs::MetadataExt::blocks(&fs::metadata(&path).expect("there")) * 512;
    let length_bytes = fs::metadata(&path).expect("there").len();
    assert!(used_bytes < length_bytes + 8192, "{used_bytes} bytes for {length_bytes}");
}

#[test]
fn a_record_torn_on_a_full_disk_leaves_room_for_the_end() {
    let Some(disk) = SmallDisk::mount() else { return };
    let path = disk.0.path().join("journal");
    let mut journal = Journal::create(&path, accepted(), 0).expect("created");
    journal.append(Record::Started { exposure: 0 }, 1).expect("room");
    drop(journal);
    // As after a crash in the middle of a record.
    let mut file = fs::OpenOptions::new().append(true).open(&path).expect("open");
    std::io::Write::write_all(&mut file, &[9; 20]).expect("written");
    disk.fill();
    let (mut journal, _) = Journal::open(&path).expect("the torn record is cut off");
    journal.append(Record::Ended { state: JobState::Stopped, reason: "x".repeat(4000) }, 9).expect("room");
    assert_eq!(read_journal(&path).expect("whole").1.state, JobState::Stopped);
}
