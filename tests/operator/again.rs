//! `layerctl start --again`: the part of a job that is over, printed once more.

use std::fs;
use std::os::unix::fs::MetadataExt;

use super::support::{Bench, Setup, SmallDisk, skipped, wait_until};
use super::{PART, slowly};

/// Why `layerctl` refuses.
fn refused(bench: &Bench, arguments: &[&str]) -> String {
    let output = bench.layerctl(arguments);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {told}");
    assert!(output.stdout.is_empty(), "{output:?}");
    told
}

#[test]
fn a_part_is_printed_again_and_outlives_the_job_that_brought_it() {
    let bench = Bench::start(Setup::default());
    bench.ok(&PART);
    let first = bench.start_job("part.layerd");
    bench.wait_for(first, &["completed"]);
    fs::remove_file(bench.path("part.layerd")).expect("the source is not needed any more");
    let output = bench.layerctl(&["start", "--again", "1", "--wait"]);
    assert!(output.status.success() && output.stdout == b"2\n", "{output:?}");
    let [one, two] = [1, 2].map(|job| bench.path(&format!("spool/jobs/0000000{job}/part.layerd")));
    let inode = |path| fs::metadata(path).expect("a part").ino();
    assert_eq!(inode(&one), inode(&two), "the part is there once");
    let [old, new] = [1, 2].map(|id| bench.job(id));
    for key in ["name", "recipe", "layers_total", "state"] {
        assert_eq!(new[key], old[key], "{key}");
    }
    assert_eq!(bench.exposed_layers().len(), 48, "each layer of both");
    let freed = bench.json(&["remove", "1"])["freed_bytes"].as_u64().expect("bytes");
    let kept = fs::metadata(&two).expect("a part").blocks() * 512;
    assert!(!one.exists() && kept > 0, "{freed} freed, {kept} kept");
    bench.ok(&["start", "--again", "2", "--wait"]);
    assert_eq!(bench.job(3)["state"], "completed");
    assert!(refused(&bench, &["start", "--again", "1"]).contains("there is no job `1`"));
    assert_eq!(fs::read_dir(bench.path("spool/incoming")).expect("a directory").count(), 0, "nothing is left there");
}

#[test]
fn another_recipe_can_be_named_and_every_check_of_a_new_job_applies() {
    let bench = Bench::start(Setup { confirm_plate: true, ..slowly() });
    bench.ok(&PART);
    let first = bench.start_job("part.layerd");
    bench.wait_for(first, &["printing"]);
    let told = refused(&bench, &["start", "--again", "1"]);
    assert!(told.contains("job 1 is printing; only the part of a job that is over can be printed again"), "{told}");
    bench.ok(&["abort"]);
    bench.wait_for(first, &["aborted"]);
    wait_until("the device is back", || bench.json(&["status"])["link"]["state"] == "connected");
    let recipe = fs::read_to_string(bench.path("recipe.toml")).expect("a recipe");
    let coarse =
        recipe.replace("\"bench\"", "\"coarse\"").replace("layer_height_um = 100.0", "layer_height_um = 200.0");
    fs::write(bench.path("coarse.toml"), coarse).expect("written");
    let output = bench.layerctl(&["start", "--again", "1", "--recipe", "./coarse.toml"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && output.stdout == b"2\n", "{output:?}");
    assert!(
        told.contains("job 2 begins at once: the plate is taken to be empty (the last job, 1, was aborted)"),
        "{told}"
    );
    bench.wait_for(2, &["printing"]);
    let job = bench.job(2);
    assert_eq!((&job["recipe"], &job["layers_total"]), (&"coarse".into(), &12.into()), "{job}");
    // Queued behind another: the plate must be confirmed, as for any job.
    let output = bench.layerctl(&["start", "--again", "1"]);
    assert_eq!(String::from_utf8_lossy(&output.stderr), "job 3 waits for the end of job 2\n", "{output:?}");
    bench.ok(&["stop", "2"]);
    bench.wait_for(2, &["stopped"]);
    wait_until("the question for the plate", || {
        bench.job(3)["reason"].as_str().is_some_and(|reason| reason.contains("empty plate"))
    });
    let job = bench.job(3);
    assert_eq!((&job["recipe"], &job["layers_total"]), (&"bench".into(), &24.into()), "the first job's recipe: {job}");
    // 422 as for a file: the device cannot expose that long.
    let long = recipe.replace("exposure_ms = 1000", "exposure_ms = 700000");
    fs::write(bench.path("long.toml"), long).expect("written");
    let told = refused(&bench, &["start", "--again", "1", "--recipe", "./long.toml"]);
    assert!(told.contains("700000") || told.contains("exposure"), "{told}");
    let told = refused(&bench, &["start", "--again", "1", "--recipe", "nonesuch"]);
    assert!(told.contains("nonesuch"), "{told}");
}

#[test]
fn a_part_that_is_gone_or_damaged_is_told_as_that() {
    let bench = Bench::start(Setup::default());
    bench.ok(&PART);
    let first = bench.start_job("part.layerd");
    bench.wait_for(first, &["completed"]);
    let part = bench.path("spool/jobs/00000001/part.layerd");
    let mut bytes = fs::read(&part).expect("a part");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    fs::write(&part, bytes).expect("damaged");
    let told = refused(&bench, &["start", "--again", "1"]);
    assert!(
        told.contains("the spool's copy of the part is damaged (chunk 0 of 1") && told.contains("original file"),
        "{told}"
    );
    fs::remove_file(&part).expect("as retention does");
    let told = refused(&bench, &["start", "--again", "1"]);
    assert!(told.contains("the part of job 1 is no longer in the spool") && told.contains("newest 10 jobs"), "{told}");
    assert!(told.contains("layerctl start FILE"), "{told}");
    assert_eq!(bench.json(&["jobs"])["jobs"].as_array().expect("jobs").len(), 1);
    assert_eq!(fs::read_dir(bench.path("spool/incoming")).expect("a directory").count(), 0, "nothing is left there");
}

#[test]
fn a_full_spool_takes_no_job_again_and_says_what_to_do() {
    let mut bench = Bench::prepare(Setup::default());
    fs::create_dir(bench.path("spool")).expect("made");
    let Some(disk) = SmallDisk::mount(&bench.path("spool")) else { return skipped("no right to mount a file system") };
    bench.start_device();
    bench.start_daemon();
    bench.ok(&PART);
    let first = bench.start_job("part.layerd");
    bench.wait_for(first, &["completed"]);
    disk.fill();
    let told = refused(&bench, &["start", "--again", "1"]);
    assert!(told.contains("layerctl remove JOB") && told.contains("free"), "{told}");
    disk.empty();
    bench.ok(&["start", "--again", "1", "--wait"]);
}
