//! Whole prints through the real processes: simulated device, daemon, command.

#[path = "meshes/box_mesh.rs"]
mod box_mesh;
mod meshes;
mod pack_bench;
mod support;

use std::io::{Read, Write};
use std::time::Duration;

use support::{Bench, Setup, real_data, signal, wait_until};

/// A small lattice of some thirty layers.
const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

#[test]
fn a_print_exposes_every_layer_once_in_order_as_sliced() {
    let bench = Bench::start(Setup::default());
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    assert!(layers >= 25, "{layers}");
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    bench.assert_pictures_match("part.layerd", layers);
    let acts = bench.acts();
    let on = acts.iter().filter(|act| act["event"] == "light_on").count() as u64;
    let off = acts.iter().filter(|act| act["event"] == "light_off").count() as u64;
    assert_eq!((on, off), (layers, layers));
}

#[test]
fn grey_layers_print_as_sliced() {
    let bench = Bench::start(Setup { antialias: true, layer_height_um: 300.0, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
    bench.assert_pictures_match("part.layerd", job["layers_total"].as_u64().expect("layers_total"));
}

#[test]
fn a_hollow_solid_a_lattice_and_a_displaced_solid_print_as_sliced_through_kills() {
    let mut bench = Bench::start(Setup { time_scale: 4, ..Setup::default() });
    std::fs::write(bench.path("ball.stl"), meshes::hollow_ball([4.0, 4.0, 2.0], 2.0, 1.6)).expect("can be written");
    std::fs::write(bench.path("cross.txt"), "2 0.2 0 0\n2.3 4 2 5.7 4 2\n4 2.3 2 4 5.7 2\n").expect("can be written");
    std::fs::write(bench.path("box.obj"), meshes::rough_box([7.0, 3.0, 0.5], [8.5, 5.0, 3.0])).expect("can be written");
    std::fs::write(bench.path("rough.mtl"), "newmtl rough\ndisp -bm 0.4 wavy.png\n").expect("can be written");
    std::fs::write(bench.path("wavy.png"), meshes::wavy_map()).expect("can be written");
    bench.ok(&["pack", "ball.stl", "cross.txt", "box.obj", "--joint", "union", "-o", "part.layerd"]);
    let told = bench.ok(&["info", "part.layerd"]);
    assert!(told.contains("struts        2") && told.contains("triangles     4608"), "{told}");
    assert!(told.contains("surface, displaced") && told.contains("triangles     12"), "{told}");
    let id = bench.start_job("part.layerd");
    bench.kill_and_resume(id, |kill| Duration::from_millis(20 + kill * 7919 % 170));
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    bench.assert_pictures_match("part.layerd", layers);
}

#[test]
fn a_solid_foot_under_a_clipped_lattice_prints_as_sliced() {
    let bench = Bench::start(Setup::default());
    let packed = pack_bench::Bench::new();
    packed.model(&clipped_lattice_on_a_foot()).expect("it is fine");
    std::fs::copy(packed.path("out.layerd"), bench.path("part.layerd")).expect("can be copied");
    let told = bench.ok(&["info", "part.layerd"]);
    for part in ["struts        2", "leaves what lies inside", "body          3 of 3", "z 0.000..3.000"] {
        assert!(told.contains(part), "{told}");
    }
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    bench.assert_pictures_match("part.layerd", layers);
}

/// A 3MF model of a foot of 4 × 4 × 1 mm and of two beams that stand on it, of which a box 3 mm high leaves the inside.
fn clipped_lattice_on_a_foot() -> String {
    let mesh = |high: [u32; 3], beside: &str| {
        let place = |number| box_mesh::corner(number, [0; 3], high);
        let vertices = (0..8).map(place).map(|[x, y, z]| format!(r#"<vertex x="{x}" y="{y}" z="{z}"/>"#));
        let triangle = |[a, b, c]: [usize; 3]| format!(r#"<triangle v1="{a}" v2="{b}" v3="{c}"/>"#);
        let (vertices, triangles) = (vertices.collect::<String>(), box_mesh::box_triangles().map(triangle));
        let triangles = triangles.collect::<String>();
        format!("<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles>{beside}</mesh>")
    };
    // Across, from the corners of the foot to far above it.
    let lattice = r#"<b:beamlattice radius="0.4" minlength="0.001" clippingmode="inside" clippingmesh="1"><b:beams>
        <b:beam v1="0" v2="8"/><b:beam v1="3" v2="8"/></b:beams></b:beamlattice>"#;
    let foot = mesh([4, 4, 1], lattice).replace("</vertices>", r#"<vertex x="2" y="2" z="9"/></vertices>"#);
    format!(
        r#"{}><resources><object id="1">{}</object><object id="2">{foot}</object></resources>
        <build><item objectid="2"/></build></model>"#,
        pack_bench::HEAD,
        mesh([4, 4, 3], "")
    )
}

#[test]
fn kill_at_any_moment_then_resume_exposes_each_layer_exactly_once() {
    let mut bench = Bench::start(Setup { time_scale: 4, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    // Moments spread over the phases of a layer by a multiplicative sequence.
    bench.kill_and_resume(id, |kill| Duration::from_millis(20 + kill * 7919 % 170));
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    bench.assert_pictures_match("part.layerd", layers);
}

#[test]
fn lost_corrupted_and_repeated_frames_and_pulled_cables_do_not_show() {
    let faults =
        ["--fault", "drop=0.01", "--fault", "corrupt=0.01", "--fault", "duplicate=0.01", "--fault", "disconnect=3"];
    let simulate = faults.iter().chain(&["--seed", "7"]).map(ToString::to_string).collect();
    let bench = Bench::start(Setup { simulate, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    bench.assert_pictures_match("part.layerd", layers);
}

#[test]
fn sigterm_ends_dark_and_resumable() {
    let mut bench = Bench::start(Setup::default());
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(5));
    assert_eq!(bench.terminate_daemon(), Some(0));
    let acts = bench.acts();
    let last_light =
        acts.iter().rev().find(|act| act["event"].as_str().is_some_and(|event| event.starts_with("light")));
    assert_eq!(last_light.expect("there was light")["event"], "light_off");
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "interrupted");
    bench.ok(&["resume", &id.to_string()]);
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
}

#[test]
fn pause_lifts_clear_and_resume_goes_on() {
    let bench = Bench::start(Setup::default());
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(3));
    bench.ok(&["pause"]);
    bench.wait_for(id, &["paused"]);
    let acts = bench.acts();
    let position = acts.iter().rev().find_map(|act| act["position_um"].as_i64()).expect("a position");
    assert!(position >= 30_000, "the plate stands at {position} µm, not clear");
    let exposed = bench.exposed_layers().len();
    let device = bench.json(&["device"]);
    let last = serde_json::json!({"job": id.to_string(), "layer": exposed - 1});
    assert_eq!(device["state"]["last_exposed"], last, "{device}");
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(bench.exposed_layers().len(), exposed, "nothing is exposed while paused");
    bench.ok(&["resume"]);
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
    assert_eq!(bench.exposed_layers(), (0..job["layers_total"].as_u64().expect("total")).collect::<Vec<_>>());
}

#[test]
fn stop_ends_after_the_layer_and_the_next_job_prints() {
    let bench = Bench::start(Setup::default());
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    let second = bench.start_job("part.layerd");
    assert_eq!(bench.job(second)["state"], "queued");
    let third = bench.start_job("part.layerd");
    bench.ok(&["abort", &third.to_string()]);
    assert_eq!(bench.job(third)["state"], "aborted");
    wait_until("some layers", || bench.job(first)["layers_done"].as_u64() >= Some(3));
    bench.ok(&["stop"]);
    let job = bench.wait_for(first, &["stopped"]);
    assert!(job["layers_done"].as_u64() < job["layers_total"].as_u64());
    bench.wait_for(second, &["completed"]);
    assert_eq!(bench.job(third)["layers_done"], 0, "what was aborted while it waited is not printed");
}

/// The machine would drive the new job's plate, and the old part, into the vat.
#[test]
fn a_queued_job_begins_only_on_a_word_given_when_it_is_next() {
    let mut bench = Bench::start(Setup { confirm_plate: true, ..Setup::default() });
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    // While it is opened there is nothing to pause.
    bench.wait_for(first, &["printing"]);
    bench.ok(&["pause"]);
    let [second, third] = [(); 2].map(|()| bench.start_job("part.layerd"));
    let refused = |bench: &Bench, id: u64, told: &str| {
        let output = bench.layerctl(&["resume", &id.to_string()]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && text.contains(told), "{text}");
        assert!(bench.ok(&["jobs"]).contains(told), "`jobs` says it, too");
    };
    refused(&bench, second, &format!("waits for the end of job {first}"));
    bench.wait_for(first, &["paused"]);
    bench.ok(&["resume"]);
    bench.wait_for(first, &["completed"]);
    refused(&bench, third, &format!("waits for job {second}, which is before it"));
    let begun = bench.acts().len();
    bench.ok(&["resume", &second.to_string()]);
    wait_until("its first layers", || bench.acts().len() > begun);
    bench.ok(&["pause"]);
    bench.wait_for(second, &["paused"]);
    bench.kill_daemon();
    bench.start_daemon();
    let status = bench.json(&["status"]);
    assert_eq!(status["active"]["state"], "interrupted", "an interrupted job holds the machine: {status}");
    refused(&bench, third, &format!("waits for job {second}, which is interrupted"));
    bench.ok(&["abort", &second.to_string()]);
    wait_until("the third job's turn", || {
        bench.job(third)["reason"].as_str().is_some_and(|reason| reason.contains("waits for an empty plate"))
    });
    let begun = bench.acts().iter().filter(|act| act["event"] == "light_on").count();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(bench.acts().iter().filter(|act| act["event"] == "light_on").count(), begun, "nothing begins by itself");
    bench.ok(&["resume", &third.to_string()]);
    bench.wait_for(third, &["completed"]);
}

/// Whoever asked for it saw the plate before the other job's part hung there.
#[test]
fn a_job_that_arrives_while_another_ends_does_not_begin_by_itself() {
    let bench = Bench::start(Setup { confirm_plate: true, ..Setup::default() });
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    let part = std::fs::read(bench.path("part.layerd")).expect("is there");
    let mut upload = std::os::unix::net::UnixStream::connect(bench.path("control.sock")).expect("the daemon listens");
    let head =
        format!("POST /v1/jobs HTTP/1.1\r\nHost: x\r\nx-layerd-name: late\r\nContent-Length: {}\r\n\r\n", part.len());
    upload.write_all(head.as_bytes()).expect("is taken");
    upload.write_all(&part[..100]).expect("is taken");
    bench.wait_for(first, &["completed"]);
    upload.write_all(&part[100..]).expect("is taken");
    let mut answer = [0; 12];
    upload.read_exact(&mut answer).expect("an answer");
    assert_eq!(&answer, b"HTTP/1.1 201");
    let late = first + 1;
    wait_until("its reason", || {
        bench.job(late)["reason"].as_str().is_some_and(|reason| reason.contains("waits for an empty plate"))
    });
    bench.ok(&["resume", &late.to_string()]);
    bench.wait_for(late, &["completed"]);
}

#[test]
fn a_lost_device_interrupts_and_a_new_one_resumes() {
    let mut bench = Bench::start(Setup::default());
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(3));
    signal(bench.daemon_pid(), "STOP");
    std::thread::sleep(Duration::from_millis(2_500));
    let silent = bench.acts().iter().any(|act| act["event"] == "host_silent");
    signal(bench.daemon_pid(), "CONT");
    assert!(silent, "the device notices a silent host");
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
    assert_eq!(bench.exposed_layers(), (0..job["layers_total"].as_u64().expect("total")).collect::<Vec<_>>());
    bench.kill_device();
}

#[test]
fn a_real_lattice_prints_within_its_memory_budget() {
    let Some(lattice) = real_data("spot_lattice.txt") else { return };
    let setup = Setup { size_px: [1920, 1080], layer_height_um: 500.0, time_scale: 500, ..Setup::default() };
    let bench = Bench::start(setup);
    bench.ok(&["pack", lattice.to_str().expect("UTF-8"), "--rotate", "0,0,90", "-o", "spot.layerd"]);
    let id = bench.start_job("spot.layerd");
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    let status = std::fs::read_to_string(format!("/proc/{}/status", bench.daemon_pid())).expect("/proc");
    let peak_kib: u64 = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix("kB")?.trim().parse().ok())
        .expect("VmHWM");
    eprintln!("peak resident memory of the daemon: {} MiB", peak_kib >> 10);
    assert!(peak_kib < (64 + 24) << 10, "peak resident memory {peak_kib} KiB is above budget + 24 MiB");
    bench.assert_pictures_match("spot.layerd", layers);
}

#[test]
fn the_pyramid_prints_as_sliced() {
    let Some(pyramid) = real_data("pyramid.3mf") else { return };
    let setup =
        Setup { size_px: [900, 900], pixel_um: 200.0, layer_height_um: 1000.0, time_scale: 200, ..Setup::default() };
    let bench = Bench::start(setup);
    bench.ok(&["pack", pyramid.to_str().expect("UTF-8"), "-o", "pyramid.layerd"]);
    bench.ok(&["check", "pyramid.layerd", "--machine", "machine.toml", "--recipe", "recipe.toml"]);
    let id = bench.start_job("pyramid.layerd");
    let layers = bench.printed(id);
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>());
    bench.assert_pictures_match("pyramid.layerd", layers);
}
