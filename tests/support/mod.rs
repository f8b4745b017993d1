//! A bench for whole prints: a simulated device, the daemon and the operator's command, each a process of its own, in a
//! directory of their own.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part of the bench")]

pub(crate) mod part;
#[path = "../skip/mod.rs"]
mod skip;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use layerd::link::message::{Capabilities, Encoding, MachineCapabilities, VatCapabilities, Vats};
use serde_json::Value;
pub(crate) use skip::skipped;

/// Longest any single wait of a test takes; a print that hangs fails instead of stopping the run.
const PATIENCE: Duration = Duration::from_secs(120);

/// Runs `layerctl` in a directory, with the shipped configuration only.
pub(crate) fn layerctl(directory: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_layerctl"))
        .current_dir(directory)
        .args(arguments)
        .env_remove("LAYERD_CONFIG_DIR")
        .output()
        .expect("layerctl runs")
}

/// What a test may vary.
pub(crate) struct Setup {
    /// Pixels a row and rows.
    pub size_px: [u32; 2],
    /// Pixel pitch, micrometres.
    pub pixel_um: f64,
    /// Layer height, micrometres.
    pub layer_height_um: f64,
    /// Exposure of every layer, milliseconds of device time.
    pub exposure_ms: u32,
    /// Speed of the plate, up and down, micrometres a second of device time.
    pub plate_speed_um_s: u32,
    /// Line rate.
    pub baud: u32,
    /// How much faster than real the device's clock runs.
    pub time_scale: u32,
    /// `memory_budget` of the daemon.
    pub memory_budget: &'static str,
    /// Grey edges.
    pub antialias: bool,
    /// Whether a queued job waits for the operator's word that the plate is empty.
    pub confirm_plate: bool,
    /// A laser machine instead of a resin printer.
    pub laser: Option<Laser>,
    /// Further arguments of `layerctl simulate`.
    pub simulate: Vec<String>,
}

/// What a test may vary of a laser machine.
#[derive(Clone, Copy)]
pub(crate) struct Laser {
    /// Speed of marks, millimetres a second.
    pub mark_speed_mm_s: u32,
    /// Buffer of the device, bytes of layer data.
    pub buffer_bytes: u32,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            size_px: [400, 300],
            pixel_um: 50.0,
            layer_height_um: 100.0,
            exposure_ms: 400,
            plate_speed_um_s: 20_000,
            baud: 3_000_000,
            time_scale: 50,
            memory_budget: "64MiB",
            antialias: false,
            confirm_plate: false,
            laser: None,
            simulate: Vec::new(),
        }
    }
}

/// What a device says of itself that fits the bench's default machine file.
pub(crate) fn bench_device() -> Capabilities {
    Capabilities {
        name: "bench".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit, Encoding::Group4],
        max_exposure_ms: 600_000,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 400,
            height_px: 300,
            pixel_nm: [50_000; 2],
            max_position_um: 100_000,
            vats: Vats::ONE,
        }),
    }
}

/// One directory with everything of one print bench; processes end when it is dropped.
pub(crate) struct Bench {
    /// The directory.
    pub dir: tempfile::TempDir,
    setup: Setup,
    device: Option<Child>,
    daemon: Option<Child>,
}

impl Bench {
    /// Writes the configuration and starts device and daemon.
    pub(crate) fn start(setup: Setup) -> Self {
        let mut bench = Self::prepare(setup);
        bench.start_device();
        bench.start_daemon();
        bench
    }

    /// Writes the configuration; starts nothing.
    pub(crate) fn prepare(setup: Setup) -> Self {
        let dir = tempfile::Builder::new().prefix("layerd-test-").tempdir().expect("temporary directory");
        let bench = Self { dir, setup, device: None, daemon: None };
        bench.write_configuration();
        bench
    }

    /// A path in the bench's directory.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write_configuration(&self) {
        let Setup {
            size_px,
            pixel_um,
            layer_height_um,
            exposure_ms,
            plate_speed_um_s,
            baud,
            memory_budget,
            antialias,
            confirm_plate,
            time_scale,
            ..
        } = &self.setup;
        let machine = format!(
            "name = \"bench\"\nkind = \"dlp\"\nwidth_px = {}\nheight_px = {}\nconfirm_plate = {confirm_plate}\ntime_scale = {time_scale}.0\npixel_um = [{pixel_um:?}, {pixel_um:?}]\n\
             build_height_um = 200000.0\nclear_height_um = 30000.0\n[link]\npath = \"device\"\nbaud = {baud}\n",
            size_px[0], size_px[1],
        );
        let recipe = format!(
            "name = \"bench\"\nlayer_height_um = {layer_height_um:?}\nexposure_ms = {exposure_ms}\n\
             bottom_exposure_ms = {exposure_ms}\nbottom_layers = 0\nlift_height_um = 3000\n\
             lift_speed_um_s = {plate_speed_um_s}\nretract_speed_um_s = {plate_speed_um_s}\nantialias = {antialias}\n",
        );
        let daemon = format!(
            "socket = \"control.sock\"\nspool = \"spool\"\nmemory_budget = \"{memory_budget}\"\n\
             machine = \"machine.toml\"\nrecipe = \"recipe.toml\"\n",
        );
        let (machine, recipe) = match self.setup.laser {
            None => (machine, recipe),
            Some(laser) => self.laser_configuration(laser),
        };
        fs::write(self.path("machine.toml"), machine).expect("machine.toml");
        fs::write(self.path("recipe.toml"), recipe).expect("recipe.toml");
        fs::write(self.path("layerd.toml"), daemon).expect("layerd.toml");
    }

    /// Machine and recipe of a laser machine.
    fn laser_configuration(&self, laser: Laser) -> (String, String) {
        let Setup { confirm_plate, time_scale, baud, layer_height_um, .. } = &self.setup;
        let machine = format!(
            "name = \"bench\"\nkind = \"slm\"\nfield_um = [12000.0, 12000.0]\nbuild_height_um = 50000.0\nbeam_diameter_um = 60.0\n\
             max_power_w = 200.0\nlayer_height_range_um = [20.0, 200.0]\nrecoat_ms = 4000\nconfirm_plate = {confirm_plate}\n\
             time_scale = {time_scale}.0\n[link]\npath = \"device\"\nbaud = {baud}\n",
        );
        let recipe = format!(
            "name = \"bench\"\nkind = \"slm\"\nlayer_height_um = {layer_height_um:?}\nlaser_power_w = 180.0\n\
             mark_speed_mm_s = {}.0\njump_speed_mm_s = 5000.0\njump_delay_us = 100\nmark_delay_us = 50\npolygon_delay_us = 20\n\
             hatch_strategy = \"zigzag\"\nhatch_spacing_um = 60.0\nplate_speed_um_s = 20000\nwait_after_recoat_ms = 200\n",
            laser.mark_speed_mm_s,
        );
        (machine, recipe)
    }

    /// Starts the simulated device and waits for its line.
    pub(crate) fn start_device(&mut self) {
        let time_scale = self.setup.time_scale.to_string();
        let baud = self.setup.baud.to_string();
        let child = Command::new(env!("CARGO_BIN_EXE_layerctl"))
            .current_dir(self.dir.path())
            .args(["simulate", if self.setup.laser.is_some() { "slm" } else { "dlp" }])
            .args(["--link", "device", "-o", "device-out", "--machine", "machine.toml"])
            .args(self.setup.laser.map_or(vec![], |laser| vec!["--buffer".into(), laser.buffer_bytes.to_string()]))
            .args(["--baud", &baud, "--time-scale", &time_scale])
            .args(&self.setup.simulate)
            .stdin(Stdio::null())
            .stdout(self.log("device.log"))
            .stderr(self.log("device.log"))
            .spawn()
            .expect("layerctl simulate starts");
        self.device = Some(child);
        let link = self.path("device");
        wait_until("the device's line", || link.exists());
    }

    /// Starts the daemon and waits until it answers.
    pub(crate) fn start_daemon(&mut self) {
        self.start_daemon_by(self.daemon_command(&[env!("CARGO_BIN_EXE_layerd")]));
    }

    /// A command that runs the daemon: `program`, its arguments, then those of the daemon. It logs to `daemon.log`.
    pub(crate) fn daemon_command(&self, program: &[&str]) -> Command {
        let mut command = Command::new(program[0]);
        command.current_dir(self.dir.path()).env("RUST_LOG", "info");
        command.args(&program[1..]).args(["--config", "layerd.toml"]);
        command.stdin(Stdio::null()).stdout(self.log("daemon.log")).stderr(self.log("daemon.log"));
        command
    }

    /// Starts the daemon by this command and waits until it answers.
    pub(crate) fn start_daemon_by(&mut self, mut command: Command) {
        self.daemon = Some(command.spawn().expect("layerd starts"));
        wait_until("the daemon", || self.layerctl(&["status", "--json"]).status.success());
    }

    fn log(&self, name: &str) -> fs::File {
        fs::OpenOptions::new().create(true).append(true).open(self.path(name)).expect("log file")
    }

    /// The daemon's process number.
    pub(crate) fn daemon_pid(&self) -> u32 {
        self.daemon.as_ref().expect("the daemon runs").id()
    }

    /// The simulated device's process number.
    pub(crate) fn device_pid(&self) -> u32 {
        self.device.as_ref().expect("the device runs").id()
    }

    /// `kill -9` of the daemon.
    pub(crate) fn kill_daemon(&mut self) {
        let mut daemon = self.daemon.take().expect("the daemon runs");
        daemon.kill().expect("killed");
        daemon.wait().expect("waited");
    }

    /// Starts `part.layerd`, kills the daemon once some layers are done, and waits until the device has noticed.
    pub(crate) fn start_and_kill(&mut self) {
        let id = self.start_job("part.layerd");
        wait_until("some layers", || self.job(id)["layers_done"].as_u64() >= Some(2));
        self.kill_daemon();
        wait_until("the silence", || self.acts().iter().any(|act| act["event"] == "host_silent"));
    }

    /// SIGTERM to the daemon; returns once it has ended, with its exit code.
    pub(crate) fn terminate_daemon(&mut self) -> Option<i32> {
        signal(self.daemon_pid(), "TERM");
        self.wait_daemon()
    }

    /// Returns once the daemon has ended by itself, with its exit code.
    pub(crate) fn wait_daemon(&mut self) -> Option<i32> {
        self.daemon.take().expect("the daemon runs").wait().expect("waited").code()
    }

    /// Returns once the simulated device has ended by itself, with its exit code.
    pub(crate) fn wait_device(&mut self) -> Option<i32> {
        self.device.take().expect("the device runs").wait().expect("waited").code()
    }

    /// `kill -9` of the simulated device, which leaves its link behind.
    pub(crate) fn kill_device_leaving_its_link(&mut self) {
        let mut device = self.device.take().expect("the device runs");
        device.kill().expect("killed");
        device.wait().expect("waited");
    }

    /// `kill -9` of the simulated device, and its line gone.
    pub(crate) fn kill_device(&mut self) {
        self.kill_device_leaving_its_link();
        let _ = fs::remove_file(self.path("device"));
    }

    /// Runs `layerctl` in the bench's directory, against its daemon.
    pub(crate) fn layerctl(&self, arguments: &[&str]) -> Output {
        self.layerctl_command(arguments).output().expect("layerctl runs")
    }

    /// The same, not yet started.
    pub(crate) fn layerctl_command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_layerctl"));
        command.current_dir(self.dir.path()).args(arguments).env("LAYERD_SOCKET", self.path("control.sock"));
        // Times are told in the local time of the reader.
        command.env("TZ", "UTC").stdin(Stdio::null());
        command
    }

    /// Runs `layerctl` and expects success; returns its standard output.
    pub(crate) fn ok(&self, arguments: &[&str]) -> String {
        let output = self.layerctl(arguments);
        assert!(
            output.status.success(),
            "layerctl {arguments:?}: {}\n{}\n--- daemon\n{}",
            output.status,
            String::from_utf8_lossy(&output.stderr),
            fs::read_to_string(self.path("daemon.log")).unwrap_or_default(),
        );
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// The same with `--json`.
    pub(crate) fn json(&self, arguments: &[&str]) -> Value {
        let text = self.ok(&[arguments, &["--json"]].concat());
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("layerctl {arguments:?} --json: {error}: {text}"))
    }

    /// The job with this id as the daemon shows it.
    pub(crate) fn job(&self, id: u64) -> Value {
        let jobs = self.json(&["jobs"]);
        let (list, id) = (jobs["jobs"].as_array().expect("jobs"), id.to_string());
        list.iter().find(|job| job["id"] == id).unwrap_or_else(|| panic!("no job {id} in {jobs}")).clone()
    }

    /// Starts a job; its id.
    pub(crate) fn start_job(&self, file: &str) -> u64 {
        self.ok(&["start", file]).trim().parse().expect("start prints the job's id")
    }

    /// Waits until a job is in one of these states; the job.
    pub(crate) fn wait_for(&self, id: u64, states: &[&str]) -> Value {
        let began = Instant::now();
        loop {
            let job = self.job(id);
            if states.iter().any(|state| job["state"] == *state) {
                return job;
            }
            assert!(
                began.elapsed() < PATIENCE,
                "job {id} did not become {states:?}: {job}\n--- daemon\n{}\n--- device\n{}",
                fs::read_to_string(self.path("daemon.log")).unwrap_or_default(),
                fs::read_to_string(self.path("device.log")).unwrap_or_default(),
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until a print is completed; its number of layers.
    pub(crate) fn printed(&self, id: u64) -> u64 {
        let job = self.wait_for(id, &["completed", "failed", "interrupted"]);
        assert_eq!(job["state"], "completed", "{job}");
        job["layers_total"].as_u64().expect("layers_total")
    }

    /// Kills the daemon twenty times, each time after a pause, and resumes the job, which must not end before that.
    pub(crate) fn kill_and_resume(&mut self, id: u64, pause: impl Fn(u64) -> Duration) {
        // Before its first light, a job goes on by itself.
        wait_until("light", || self.job(id)["layers_done"].as_u64() >= Some(1));
        for kill in 0..20 {
            std::thread::sleep(pause(kill));
            self.kill_daemon();
            self.start_daemon();
            let job = self.job(id);
            assert_ne!(job["state"], "completed", "the print ended before all kills were done");
            assert_eq!(job["state"], "interrupted", "after kill {kill}: {job}");
            self.ok(&["resume", &id.to_string()]);
        }
    }

    /// What the device did, in its order.
    pub(crate) fn acts(&self) -> Vec<Value> {
        let text = fs::read_to_string(self.path("device-out/acts.jsonl")).expect("acts.jsonl");
        text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
    }

    /// The layers exposed, in the device's order.
    pub(crate) fn exposed_layers(&self) -> Vec<u64> {
        let acts = self.acts();
        acts.iter().filter(|act| act["event"] == "exposed").map(|act| act["layer"].as_u64().expect("layer")).collect()
    }

    /// Slices `file` with the bench's machine and recipe and compares every picture with what the device exposed.
    pub(crate) fn assert_pictures_match(&self, file: &str, layers: u64) {
        self.ok(&["slice", file, "--machine", "machine.toml", "--recipe", "recipe.toml", "-o", "sliced"]);
        for layer in 0..layers {
            let name = format!("layer_{layer:06}.png");
            let sliced = image::open(self.path("sliced").join(&name)).expect("sliced picture");
            let exposed = image::open(self.path("device-out").join(&name)).expect("exposed picture");
            assert!(sliced.into_luma8() == exposed.into_luma8(), "{name} differs");
        }
        let more = self.path("sliced").join(format!("layer_{layers:06}.png"));
        assert!(!more.exists(), "slice has more layers than were printed");
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        for child in [self.daemon.take(), self.device.take()].into_iter().flatten() {
            let mut child = child;
            let _ = child.kill();
            let _ = child.wait();
        }
        if std::thread::panicking() {
            for name in ["daemon.log", "device.log"] {
                let text = fs::read_to_string(self.path(name)).unwrap_or_default();
                eprintln!("--- {name}\n{text}");
            }
        }
    }
}

/// A file system of its own, small enough to fill.
pub(crate) struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts 40 MiB; `None` where that takes more rights.
    pub(crate) fn mount(at: &Path) -> Option<Self> {
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=40m", "tmpfs"]).arg(at).output().ok()?;
        mount.status.success().then(|| Self(at.into()))
    }

    /// Leaves no byte free.
    pub(crate) fn fill(&self) {
        let filler = fs::OpenOptions::new().create(true).append(true).open(self.0.join("filler")).expect("filler");
        let mut writer = &filler;
        while std::io::Write::write_all(&mut writer, &[0; 4096]).is_ok() {}
    }

    /// Gives the room back.
    pub(crate) fn empty(&self) {
        fs::remove_file(self.0.join("filler")).expect("removed");
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // Lazily: the daemon may still hold files there when a test fails.
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// Sends a signal by name.
pub(crate) fn signal(pid: u32, name: &str) {
    // The shell's own kill: the program is in a package that a small system lacks.
    let status = Command::new("sh").args(["-c", &format!("kill -{name} {pid}")]).status().expect("sh runs");
    assert!(status.success(), "kill -{name} {pid}");
}

/// Waits for a condition, with patience.
pub(crate) fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < PATIENCE, "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A file of real input, or `None`, saying so, where the collection is absent.
pub(crate) fn real_data(name: &str) -> Option<PathBuf> {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let path = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join(name);
    if !path.exists() {
        skipped(&format!("{} is not there (set LAYERD_DATA)", path.display()));
        return None;
    }
    Some(path.canonicalize().expect("absolute path"))
}
