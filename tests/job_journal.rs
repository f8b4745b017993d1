//! Journal and spool on a real file system: torn tails, flipped bits, leftovers, retention.

mod properties;

use std::fs;
use std::path::Path;

use layerd::job::{
    Entry, History, JobState, Journal, MOST_PARTS, MOST_RECORDS, NewJob, Record, ResumeChoice, ResumeError, Spool,
    SpoolError, read_journal,
};
use proptest::prelude::*;
use tempfile::TempDir;

fn accepted() -> Record {
    Record::Accepted { key: 7, layer_count: 9, name: "cube".into() }
}

fn records() -> Vec<Record> {
    vec![
        accepted(),
        Record::Started { layer: 0 },
        Record::Commanded { layer: 0, boot_id: 5 },
        Record::Confirmed { layer: 0 },
        Record::Paused,
        Record::Resumed,
        Record::Commanded { layer: 1, boot_id: 5 },
        Record::InDoubt { layer: 1, why: "its light was cut short after 40 ms".into() },
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
    assert_eq!((history.state, history.next_layer), (JobState::Interrupted, 1));
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
        assert_eq!(fs::metadata(&path).expect("there").len() as usize, ends[kept - 1], "the torn record is cut off");
        assert!(!history.state.is_active());
        journal.append(Record::Paused, 5).expect("goes on");
        let (entries, _) = read_journal(&path).expect("whole again");
        let mut expected = records()[..kept].to_vec();
        expected.push(Record::Paused);
        assert_eq!(texts(&entries), expected);
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
            // Damage in the last record cannot be told from a write that did not end.
            Ok((entries, _)) => {
                assert!(bit / 8 >= last, "byte {}: damage before the last record was not seen", bit / 8);
                assert_eq!(texts(&entries), records()[..records().len() - 1]);
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
    let started = Record::Started { layer: 0 };
    let impossible = [
        vec![started.clone()],
        vec![accepted(), accepted()],
        vec![accepted(), started.clone(), Record::Confirmed { layer: 0 }],
        vec![accepted(), started.clone(), Record::Commanded { layer: 3, boot_id: 1 }],
        vec![accepted(), Record::Ended { state: JobState::Stopped, reason: String::new() }, started],
    ];
    for records in &impossible {
        assert!(History::replay(records).is_err(), "{records:?}");
    }
}

#[test]
fn a_crash_leaves_the_job_interrupted_at_the_layer_commanded() {
    let records = [accepted(), Record::Started { layer: 0 }, Record::Commanded { layer: 0, boot_id: 5 }];
    let history = History::replay(&records).expect("true");
    assert_eq!((history.state, history.next_layer), (JobState::Interrupted, 0));
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

fn receive(spool: &Spool) -> std::path::PathBuf {
    let part = spool.incoming().join("upload");
    fs::write(&part, b"part").expect("write");
    part
}

fn create(spool: &Spool) -> u32 {
    let part = receive(spool);
    let job = NewJob { part: &part, recipe: "r", machine: "m", accepted: accepted(), at_unix_ms: 1 };
    spool.create(job).expect("created").0.id
}

#[test]
fn a_job_is_created_whole_and_its_journal_goes_on() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(&directory.path().join("spool")).expect("opened");
    let part = receive(&spool);
    let job = NewJob { part: &part, recipe: "r", machine: "m", accepted: accepted(), at_unix_ms: 1 };
    let (job, mut journal) = spool.create(job).expect("created");
    assert_eq!((job.id, part.exists()), (1, false));
    assert_eq!(fs::read(job.part()).expect("moved"), b"part");
    assert_eq!(fs::read_to_string(job.recipe()).expect("there"), "r");
    journal.append(Record::Started { layer: 0 }, 2).expect("appended");
    assert_eq!(read_journal(&job.journal()).expect("whole").0.len(), 2);
    assert_eq!(create(&spool), 2);
    assert_eq!(spool.jobs().expect("listed").iter().map(|job| job.id).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn a_missing_part_leaves_no_job_behind() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    let part = spool.incoming().join("none");
    let job = NewJob { part: &part, recipe: "r", machine: "m", accepted: accepted(), at_unix_ms: 1 };
    let error = spool.create(job).expect_err("no part").to_string();
    assert!(error.contains("none"), "{error}");
    assert_eq!(fs::read_dir(directory.path().join("jobs")).expect("listed").count(), 0);
}

#[test]
fn a_spool_has_one_owner_and_opens_clean() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    assert!(matches!(Spool::open(directory.path()), Err(SpoolError::InUse(_))));
    create(&spool);
    receive(&spool);
    fs::create_dir(directory.path().join("jobs/.00000002")).expect("half a job");
    drop(spool);
    let spool = Spool::open(directory.path()).expect("opened again");
    assert_eq!(fs::read_dir(spool.incoming()).expect("listed").count(), 0);
    assert!(!directory.path().join("jobs/.00000002").exists());
    assert_eq!(create(&spool), 2);
}

#[test]
fn a_full_disk_is_told_before_anything_is_written() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    let error = spool.check_space(1 << 60).expect_err("an exbibyte").to_string();
    assert!(error.contains("bytes free"), "{error}");
}

#[test]
fn old_jobs_lose_their_part_then_their_record() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    let count = MOST_RECORDS as u32 + 3;
    for id in 1..=count {
        // Made by hand: a hundred flushed creations would take seconds.
        let job = directory.path().join(format!("jobs/{id:08}"));
        fs::create_dir(&job).expect("created");
        fs::write(job.join("part.layerd"), b"part").expect("written");
    }
    // Job 1 may still be resumed; all others are over.
    let over: Vec<u32> = (2..=count).collect();
    spool.tidy(&over).expect("tidied");
    let left = spool.jobs().expect("listed");
    assert_eq!(left.len(), MOST_RECORDS + 1);
    assert!(left[0].id == 1 && left[0].part().exists(), "what can be resumed stays");
    assert_eq!(left.iter().filter(|job| job.part().exists()).count(), MOST_PARTS + 1);
}
