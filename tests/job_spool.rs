//! The spool on a real file system: jobs appear whole, leftovers are deleted, old jobs and removed ones make room.

use std::fs;

use layerd::device::Passes;
use layerd::job::{Forgotten, MAX_PARTS, MAX_RECORDS, NewJob, PlateAfter, Record, Spool, SpoolError, read_journal};
use tempfile::TempDir;

fn accepted() -> Record {
    Record::Accepted { key: 7, layer_count: 9, name: "cube".into() }
}

fn receive(spool: &Spool) -> std::path::PathBuf {
    let part = spool.incoming().join("upload");
    fs::write(&part, b"part").expect("write");
    part
}

fn create(spool: &Spool) -> u32 {
    let part = receive(spool);
    let job = NewJob {
        part: &part,
        recipe: "r",
        machine: "m",
        accepted: accepted(),
        passes: &Passes::single(9),
        at_unix_ms: 1,
    };
    spool.create(job).expect("created").0.id
}

#[test]
fn a_job_is_created_whole_and_its_journal_goes_on() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(&directory.path().join("spool")).expect("opened");
    let part = receive(&spool);
    let job = NewJob {
        part: &part,
        recipe: "r",
        machine: "m",
        accepted: accepted(),
        passes: &Passes::single(9),
        at_unix_ms: 1,
    };
    let (job, mut journal) = spool.create(job).expect("created");
    assert_eq!((job.id, part.exists()), (1, false));
    assert_eq!(fs::read(job.part()).expect("moved"), b"part");
    assert_eq!(fs::read_to_string(job.recipe()).expect("there"), "r");
    journal.append(Record::Started { exposure: 0 }, 2).expect("appended");
    assert_eq!(read_journal(&job.journal()).expect("whole").0.len(), 2);
    assert_eq!(create(&spool), 2);
    assert_eq!(spool.jobs().expect("listed").iter().map(|job| job.id).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn a_missing_part_leaves_no_job_behind() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    let part = spool.incoming().join("none");
    let job = NewJob {
        part: &part,
        recipe: "r",
        machine: "m",
        accepted: accepted(),
        passes: &Passes::single(9),
        at_unix_ms: 1,
    };
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
    assert!(error.contains("iB free; 1073741824.0 GiB are needed"), "{error}");
}

#[test]
fn old_jobs_lose_their_part_then_their_record() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    let count = MAX_RECORDS as u32 + 3;
    for id in 1..=count {
        // Made by hand: a hundred flushed creations would take seconds.
        let job = directory.path().join(format!("jobs/{id:08}"));
        fs::create_dir(&job).expect("created");
        fs::write(job.join("part.layerd"), b"part").expect("written");
    }
    // Job 1 may still be resumed; all others are over.
    let over: Vec<_> = (2..=count).map(over).collect();
    assert_eq!(spool.tidy(&over).expect("tidied"), [3, 2], "the oldest two");
    let left = spool.jobs().expect("listed");
    assert_eq!(left.len(), MAX_RECORDS + 1);
    assert!(left[0].id == 1 && left[0].part().exists(), "what can be resumed stays");
    assert_eq!(left.iter().filter(|job| job.part().exists()).count(), MAX_PARTS + 1);
}

fn over(id: u32) -> Forgotten {
    Forgotten { id, key: 0xfeed_0000 + u64::from(id), plate: PlateAfter::Clear }
}

#[test]
fn a_removed_job_frees_its_room_and_leaves_its_number_and_key() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    create(&spool);
    create(&spool);
    fs::write(directory.path().join("jobs/00000002/part.layerd"), vec![1; 1 << 20]).expect("written");
    let freed_bytes = spool.remove(over(2)).expect("removed");
    assert!((1 << 20..2 << 20).contains(&freed_bytes), "{freed_bytes}");
    assert_eq!(spool.jobs().expect("listed").iter().map(|job| job.id).collect::<Vec<_>>(), [1]);
    assert_eq!(create(&spool), 3, "the newest number is not given again");
    let left = Forgotten { plate: PlateAfter::Left, ..over(3) };
    spool.remove(left).expect("removed");
    spool.remove(Forgotten { plate: PlateAfter::Unsaid, ..over(1) }).expect("removed");
    // A removal that a crash cut short is ended at the next opening.
    fs::write(directory.path().join("jobs/00000002-00000000feed0002-clear/journal"), "x").expect("written");
    drop(spool);
    let spool = Spool::open(directory.path()).expect("opened again");
    assert!(!directory.path().join("jobs/00000002-00000000feed0002-clear/journal").exists());
    let unsaid = Forgotten { plate: PlateAfter::Unsaid, ..over(1) };
    assert_eq!(spool.forgotten().expect("listed"), [unsaid, over(2), left]);
    assert_eq!((spool.jobs().expect("listed"), create(&spool)), (Vec::new(), 4));
    assert!(spool.remove(over(9)).is_err(), "no such job");
}

#[test]
fn a_part_that_two_jobs_print_stays_until_both_are_removed() {
    let directory = TempDir::new().expect("temp");
    let spool = Spool::open(directory.path()).expect("opened");
    create(&spool);
    let first = spool.jobs().expect("listed").remove(0);
    fs::write(first.part(), vec![1; 1 << 20]).expect("written");
    let part = spool.part_again(&first).expect("linked");
    assert!(part.starts_with(spool.incoming()), "{part:?}");
    let job = NewJob {
        part: &part,
        recipe: "",
        machine: "",
        accepted: accepted(),
        passes: &Passes::single(9),
        at_unix_ms: 1,
    };
    let (second, _) = spool.create(job).expect("created");
    drop(part);
    assert_eq!(second.part().metadata().expect("a part").len(), 1 << 20);
    let freed_bytes = spool.remove(over(1)).expect("removed");
    assert!(freed_bytes < 1 << 20, "the part is still there, but {freed_bytes} bytes are said to be free");
    assert!(fs::read(second.part()).expect("a part").iter().all(|byte| *byte == 1));
    assert!(spool.remove(over(2)).expect("removed") >= 1 << 20);
    assert!(spool.part_again(&first).expect_err("gone").to_string().contains("cannot link "));
    assert_eq!(fs::read_dir(spool.incoming()).expect("a directory").count(), 0);
    // What a crash leaves between the two steps is deleted.
    create(&spool);
    let again = spool.part_again(&spool.jobs().expect("listed").remove(0)).expect("linked");
    let left = again.to_path_buf();
    // As if the process had been killed.
    std::mem::forget(again);
    let resin = spool.jobs().expect("listed")[0].resin();
    let unfinished = [directory.path().join(".raised.tmp"), resin.with_file_name(".resin.tmp")];
    unfinished.iter().for_each(|path| fs::write(path, "1").expect("written"));
    drop(spool);
    let spool = Spool::open(directory.path()).expect("opened again");
    assert!(unfinished.iter().all(|path| !path.exists()));
    assert!(!left.exists() && spool.jobs().expect("listed")[0].part().exists());
}
