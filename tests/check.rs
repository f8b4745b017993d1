//! `layerctl check` and `layerctl slice` as an operator runs them: what they answer, refuse and write.

mod support;

use std::fs;
use std::path::Path;
use std::process::Output;

use layerd::config::{Folder, Machine, Recipe, find};
use layerd::device::encoding::{BEST_VECTORS, best, encode, encode_shortest};
use layerd::layer::{Bitmap, Depth};
use layerd::link::message::Encoding;
use layerd::pipeline::{Placed, Resolution, default_threads};
use layerd::solid::reference::beam_field;
use layerd::solid::{Beam, Cap, ISOVALUE};
use layerd::stream::MemoryBudget;
use serde_json::Value;
use support::{Bench, Setup, layerctl};

/// A strut of the part: ends and radius, millimetres.
type Strut = ([f64; 3], [f64; 3], f64);

const PART: [Strut; 5] = [
    ([0.0, 0.0, 0.0], [4.0, 1.0, 3.0], 0.3),
    ([4.0, 1.0, 3.0], [1.0, 5.0, 2.0], 0.25),
    ([0.0, 0.0, 0.0], [1.0, 5.0, 2.0], 0.3),
    ([1.0, 5.0, 2.0], [1.0, 2.5, 4.0], 0.2),
    ([4.0, 1.0, 3.0], [4.5, 4.5, 1.0], 0.35),
];

/// A directory with a machine of 200 × 160 pixels, a recipe and the part, packed.
fn bench(mirror: &str, pack: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a directory");
    let machine = format!(
        "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 200\nheight_px = 160\npixel_um = [50.0, 60.0]\n\
         build_height_um = 100000.0\nclear_height_um = 30000.0\n{mirror}\n[link]\npath = \"device\"\nbaud = 3000000\n"
    );
    let recipe = "name = \"bench\"\nlayer_height_um = 100.0\nexposure_ms = 400\nbottom_exposure_ms = 400\n\
                  bottom_layers = 0\nlift_height_um = 3000\nlift_speed_um_s = 2000\nretract_speed_um_s = 2000\n";
    let mut text = format!("{} 0.3 0.45 0.0\n", PART.len());
    for (a, b, r) in PART {
        text += &format!("{} {} {} {} {} {} {r}\n", a[0], a[1], a[2], b[0], b[1], b[2]);
    }
    for (name, text) in [("machine.toml", machine.as_str()), ("recipe.toml", recipe), ("part.txt", &text)] {
        fs::write(dir.path().join(name), text).expect("written");
    }
    let packed = layerctl(dir.path(), &[&["pack", "part.txt", "-o", "part.layerd"], pack].concat());
    assert!(packed.status.success(), "{}", stderr(&packed));
    dir
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The one JSON object on standard output.
fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}\n{}", String::from_utf8_lossy(&output.stdout), stderr(output)))
}

const HERE: [&str; 4] = ["--machine", "machine.toml", "--recipe", "recipe.toml"];

fn check(dir: &Path, more: &[&str]) -> Output {
    layerctl(dir, &[&["check", "part.layerd"], &HERE[..], more].concat())
}

fn slice(dir: &Path, more: &[&str]) -> Output {
    layerctl(dir, &[&["slice", "part.layerd"], &HERE[..], more].concat())
}

#[test]
fn a_part_that_fits_is_said_to_fit_and_the_memory_named_is_just_enough() {
    let dir = bench("", &[]);
    let fits = check(dir.path(), &["--json"]);
    let found = json(&fits);
    assert!(fits.status.success(), "{}", stderr(&fits));
    assert_eq!((&found["fits"], &found["late_layers"]), (&Value::from(true), &Value::from(Vec::<u32>::new())));
    // From the lowest solid point to the bounds' upper end, in layers of 0.1 mm.
    let info = json(&layerctl(dir.path(), &["info", "part.layerd", "--json"]));
    let [bottom_mm, top_mm] = [&info["bottom_mm"], &info["bounds_max_mm"][2]].map(|z| z.as_f64().expect("a number"));
    assert!((-0.3..0.0).contains(&bottom_mm) && top_mm == 4.2, "{info}");
    assert_eq!(found["layer_count"], ((top_mm - bottom_mm) / 0.1).ceil() as u64);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    assert_eq!(found["threads"], cores.min(256));

    assert_eq!(found["problems"], Value::from(Vec::<u32>::new()), "neither thin struts nor missing lifts");
    // What is left of the budget is for layers computed ahead.
    let [max_bytes, needed_bytes] =
        ["memory_max_bytes", "memory_needed_bytes"].map(|figure| found[figure].as_u64().expect("a number"));
    assert!(needed_bytes < max_bytes && max_bytes <= 64 << 20, "{found}");
    let told = check(dir.path(), &[]);
    let told = String::from_utf8_lossy(&told.stdout).into_owned();
    assert!(
        told.contains("needs at least ") && told.contains(" of the budget of 64.0 MiB, and takes up to "),
        "{told}"
    );

    // With less, fewer threads; with less than one thread needs, none.
    let short = check(dir.path(), &["--json", "--budget", "1MiB"]);
    let need_bytes = json(&short)["memory_needed_bytes"].as_u64().expect("a number");
    let fits = check(dir.path(), &["--json", "--budget", &need_bytes.to_string()]);
    assert_eq!((fits.status.code(), &json(&fits)["threads"]), (Some(0), &1.into()));
    assert_eq!(json(&fits)["memory_max_bytes"], need_bytes, "nothing is left");
    let short = check(dir.path(), &["--json", "--budget", &(need_bytes - 1).to_string()]);
    assert_eq!((short.status.code(), &json(&short)["fits"]), (Some(1), &Value::from(false)));
    assert_eq!(json(&short)["memory_max_bytes"], Value::Null);
    // What the daemon takes at all.
    let advised_bytes = need_bytes.max(layerd::config::MIN_BUDGET_BYTES);
    let remedy = format!("memory_budget = \"{}MiB\"", advised_bytes.div_ceil(1 << 20));
    assert!(stderr(&short).contains(&remedy), "{}", stderr(&short));
}

#[test]
fn the_daemon_needs_what_check_says() {
    // Pictures of 8 MB: far above the least budget a daemon takes.
    let setup = |memory_budget| Setup {
        size_px: [3840, 2160],
        pixel_um: 20.0,
        antialias: true,
        memory_budget,
        ..Setup::default()
    };
    let bench = Bench::prepare(setup("64MiB"));
    bench.ok(&["generate", "bcc", "--struts", "200", "--box", "5,5,5", "--radius", "0.2", "-o", "part.layerd"]);
    let short =
        ["check", "part.layerd", "--machine", "machine.toml", "--recipe", "recipe.toml", "--budget", "8MiB", "--json"];
    let found = json(&bench.layerctl(&short));
    let need_mib = found["memory_needed_bytes"].as_u64().expect("a number").div_ceil(1 << 20);
    for (mib, enough) in [(need_mib, true), (need_mib - 1, false)] {
        let budget: &'static str = format!("{mib}MiB").leak();
        let mut daemon = Bench::prepare(setup(budget));
        daemon.start_daemon();
        fs::copy(bench.path("part.layerd"), daemon.path("part.layerd")).expect("copied");
        let started = daemon.layerctl(&["start", "part.layerd"]);
        assert_eq!(started.status.success(), enough, "{mib} MiB: {}", stderr(&started));
        assert!(enough || stderr(&started).contains(&format!("{need_mib}MiB")), "{}", stderr(&started));
    }
}

/// A chessboard of single pixels is shorter as it is than in Group 4, so a print sends it raw. So does the estimate.
#[test]
fn check_computes_all_layers_of_a_laser_and_names_the_budget_that_the_largest_needs() {
    let dir = tempfile::tempdir().expect("a directory");
    let lattice =
        ["generate", "bcc", "--struts", "5000", "--box", "22,22,0.7", "--radius", "0.12", "-o", "part.layerd"];
    assert!(layerctl(dir.path(), &lattice).status.success());
    // High layers, so that there are few.
    let shipped = find(Folder::Recipes, "slm-demo").expect("it is shipped").text;
    let recipe = shipped.replace("layer_height_um = 30.0", "layer_height_um = 100.0");
    fs::write(dir.path().join("recipe.toml"), &recipe).expect("written");
    let laser = ["--machine", "sim-slm", "--recipe", "recipe.toml", "--json", "--budget"];
    let check =
        |budget: u64| layerctl(dir.path(), &[&["check", "part.layerd"], &laser[..], &[&budget.to_string()]].concat());
    let roomy = check(1 << 30);
    let found = json(&roomy);
    assert!(roomy.status.success(), "{}", stderr(&roomy));
    let figure = |found: &Value, name: &str| found[name].as_u64().unwrap_or_else(|| panic!("no {name} in {found}"));
    let need_bytes = figure(&found, "largest_layer_budget_bytes");
    assert!(need_bytes > figure(&found, "memory_needed_bytes"), "the layers are what needs most: {found}");
    assert_eq!((&found["unfit_layers"], figure(&found, "unmarked_parts")), (&Value::from(Vec::<u32>::new()), 0));

    // That budget is enough for a print; it is not by two mebibytes less, of which one is kept because threads vary.
    let machine = find(Folder::Machines, "sim-slm").expect("it is shipped");
    let machine = Machine::parse(&machine.path, &machine.text).expect("a machine");
    let recipe = Recipe::parse(Path::new("recipe.toml"), &recipe).expect("a recipe");
    let print = |limit_bytes: u64| -> Result<(), String> {
        let placed = Placed::open(&dir.path().join("part.layerd"), &Resolution::of(&machine, &recipe));
        let placed = placed.map_err(|error| error.to_string())?;
        let memory = placed.memory(default_threads(), limit_bytes);
        let budget = MemoryBudget::new(limit_bytes);
        // As the queue that a print has.
        let _queue = budget.charge("the queue", memory.queue_bytes(limit_bytes)).map_err(|error| error.to_string())?;
        let part = placed.fit(default_threads(), limit_bytes).map_err(|error| error.to_string())?;
        let mut layers = part.encoded_layers(0, BEST_VECTORS, &budget).map_err(|error| error.to_string())?;
        layers.try_for_each(|layer| layer.map(|_| ()).map_err(|error| error.to_string()))
    };
    assert_eq!(print(need_bytes), Ok(()));
    let too_small = print(need_bytes - (2 << 20)).expect_err("it does not fit");
    let largest = figure(&found, "largest_layer");
    assert!(too_small.contains("too complex") && too_small.contains("are free"), "{too_small}");

    let short = check(need_bytes - (1 << 20));
    let told = stderr(&short);
    assert_eq!(short.status.code(), Some(1), "{told}");
    let remedy = format!("memory_budget = \"{}MiB\"", need_bytes.div_ceil(1 << 20));
    assert!(told.contains(&format!("layer {largest} needs")) && told.contains(&remedy), "{told}");
    let unfit: Vec<[u64; 2]> = serde_json::from_value(json(&short)["unfit_layers"].clone()).expect("ranges");
    assert!(unfit.iter().any(|[first, last]| (*first..=*last).contains(&largest)), "{unfit:?}");
}

#[test]
fn check_measures_the_bytes_that_a_print_sends() {
    let dir = bench("", &[]);
    let machine = "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 32\nheight_px = 32\npixel_um = [100.0, 100.0]\n\
                   build_height_um = 9000.0\nclear_height_um = 9000.0\n[link]\npath = \"device\"\nbaud = 3000000\n";
    fs::write(dir.path().join("machine.toml"), machine).expect("written");
    let squares = (2..30).flat_map(|row| (2..30).map(move |column| (row, column)));
    let struts: Vec<_> = squares.filter(|(row, column)| (row + column) % 2 == 0).collect();
    let mut text = format!("{} 0.3 0.45 0.0\n", struts.len());
    for (row, column) in struts {
        let [x, y] = [column, row].map(|pixel| f64::from(pixel) / 10.0);
        text += &format!("{x} {y} 0 {x} {y} 0.5 0.02\n");
    }
    fs::write(dir.path().join("part.txt"), text).expect("written");
    let packed = layerctl(dir.path(), &["pack", "part.txt", "--blend", "union", "-o", "part.layerd"]);
    assert!(packed.status.success(), "{}", stderr(&packed));
    assert!(slice(dir.path(), &["-o", "layers"]).status.success());

    let found = json(&check(dir.path(), &["--json"]));
    let layer_count = found["layer_count"].as_u64().expect("a number");
    assert_eq!(found["sampled_layers"], layer_count, "every layer of so low a part");
    let mut lengths = Vec::new();
    for layer in 0..layer_count {
        let picture =
            image::open(dir.path().join(format!("layers/layer_{layer:06}.png"))).expect("a picture").into_luma8();
        let mut bitmap = Bitmap::new(32, 32, Depth::Bit);
        for (x, y, _) in picture.enumerate_pixels().filter(|(.., pixel)| pixel.0[0] > 0) {
            bitmap.data_mut()[(y * 4 + x / 8) as usize] |= 0x80 >> (x % 8);
        }
        let (mut group4, mut sent) = (Vec::new(), Vec::new());
        encode(&bitmap, Encoding::Group4, &mut group4).expect("bits");
        encode_shortest(&bitmap, best(Depth::Bit), &mut sent).expect("bits");
        assert!(layer > 2 || (group4.len() > 128 && sent.len() == 128), "layer {layer}: {} bytes", group4.len());
        lengths.push(sent.len() as u64);
    }
    assert_eq!(found["encoded_bytes_max"].as_u64(), lengths.iter().copied().max());
    assert_eq!(found["encoded_bytes_mean"], lengths.iter().sum::<u64>() / layer_count);
}

/// A lone strut's end prints shorter than its bounds: the part stands on where its field reaches the isovalue.
#[test]
fn a_convolution_stands_on_its_lowest_solid_point() {
    let dir = bench("", &[]);
    fs::write(dir.path().join("part.txt"), "1 0.9\n2 2 0 2 2 6\n").expect("written");
    for blend in ["convolution", "union"] {
        assert!(layerctl(dir.path(), &["pack", "part.txt", "--blend", blend, "-o", "part.layerd"]).status.success());
        let checked = check(dir.path(), &["--json"]);
        assert!(checked.status.success(), "{blend}: {}", stderr(&checked));
        assert_eq!(json(&checked)["dark_bottom_layers"], 0, "{blend}");
    }
}

#[test]
fn thin_struts_and_a_recipe_without_a_lift_are_warned_of() {
    let dir = bench("", &[]);
    // 40 µm thick, less than a pixel of 60 µm and a layer of 100 µm.
    fs::write(dir.path().join("part.txt"), "2 0.4\n0 0 0 0 0 2\n0 0 1.9 3 0 1.9 0.02\n").expect("written");
    assert!(layerctl(dir.path(), &["pack", "part.txt", "--blend", "union", "-o", "part.layerd"]).status.success());
    let recipe = fs::read_to_string(dir.path().join("recipe.toml")).expect("a recipe");
    fs::write(dir.path().join("recipe.toml"), recipe.replace("lift_height_um = 3000", "lift_height_um = 0"))
        .expect("flat");
    let checked = check(dir.path(), &["--json"]);
    let found = json(&checked);
    assert_eq!((checked.status.code(), &found["fits"]), (Some(0), &Value::from(true)), "{found}");
    let told = check(dir.path(), &[]);
    let text = String::from_utf8_lossy(&told.stdout).into_owned();
    assert_eq!(told.status.code(), Some(0), "{text}");
    let problems: Vec<&str> = found["problems"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    for words in [
        "the thinnest strut is 40.0 µm thick, 0.67 pixels",
        "a layer 100 µm: flat struts thinner than a layer may be missing",
        "lift_height_um = 0 does not peel",
    ] {
        assert!(problems.iter().any(|problem| problem.contains(words)), "`{words}` is not in {found}");
        assert!(text.lines().any(|line| line.starts_with("note ") && line.contains(words)), "`{words}`: {text}");
    }
    assert!(text.contains("verdict         fits, but read the notes; "), "{text}");
}

/// A ball on a spike of 2 µm that no pixel shows.
const ON_A_SPIKE: &str = "2 0.001\n0 0 0 0 0 2\n0 0 2 0 0 2.1 0.5\n";

#[test]
fn a_part_that_begins_dark_is_refused() {
    let dir = bench("", &[]);
    fs::write(dir.path().join("part.txt"), ON_A_SPIKE).expect("written");
    assert!(layerctl(dir.path(), &["pack", "part.txt", "--blend", "union", "-o", "part.layerd"]).status.success());
    let refused = check(dir.path(), &["--json"]);
    let found = json(&refused);
    assert_eq!((refused.status.code(), &found["fits"]), (Some(1), &Value::from(false)), "{found}");
    // From 1 µm below 0 to 1.5 mm, in layers of 0.1 mm.
    assert_eq!(found["dark_bottom_layers"], 15);
    let problem = found["problems"][0].as_str().expect("a problem");
    assert!(problem.contains("the lowest 15 layers are dark") && problem.contains("--rotate"), "{problem}");
    assert!(stderr(&refused).contains(problem), "{}", stderr(&refused));
    let told = check(dir.path(), &[]);
    assert!(String::from_utf8_lossy(&told.stdout).contains("would not hold to the plate"), "{told:?}");
    // Too short for its support: nothing of it is solid.
    fs::write(dir.path().join("part.txt"), "1 0.9\n2 2 0 2 2 0.05\n").expect("written");
    assert!(layerctl(dir.path(), &["pack", "part.txt", "-o", "part.layerd"]).status.success());
    let refused = check(dir.path(), &[]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("all layers are dark"), "{}", stderr(&refused));
}

#[test]
fn the_daemon_prints_onto_nothing_neither_when_asked_nor_when_the_jobs_turn_comes() {
    let bench = Bench::start(Setup { time_scale: 100, ..Setup::default() });
    fs::write(bench.path("spike.txt"), ON_A_SPIKE).expect("written");
    bench.ok(&["pack", "spike.txt", "--blend", "union", "-o", "spike.layerd"]);
    let refused = bench.layerctl(&["start", "spike.layerd"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("the lowest 15 layers are dark"), "{}", stderr(&refused));
    // Behind another job there is no memory to look at it at once.
    bench.ok(&["generate", "bcc", "--struts", "40", "--box", "4,4,4", "--radius", "0.3", "-o", "good.layerd"]);
    let good = bench.start_job("good.layerd");
    let loose = bench.start_job("spike.layerd");
    assert_eq!(bench.wait_for(good, &["completed", "failed", "interrupted"])["state"], "completed");
    let job = bench.wait_for(loose, &["completed", "failed", "interrupted"]);
    assert_eq!((&job["state"], &job["layers_done"]), (&"failed".into(), &0.into()), "{job}");
    assert!(job["reason"].as_str().is_some_and(|why| why.contains("the lowest 15 layers are dark")), "{job}");
    let layers = bench.job(good)["layers_total"].as_u64().expect("layers_total");
    assert_eq!(bench.exposed_layers(), (0..layers).collect::<Vec<_>>(), "not a layer of the second");
}

#[test]
fn pictures_of_an_earlier_slice_are_told_and_its_manifest_goes_first() {
    let dir = bench("", &[]);
    assert!(slice(dir.path(), &["--layers", "10..20", "-o", "layers"]).status.success());
    let again = slice(dir.path(), &["--layers", "12..15", "-o", "layers"]);
    assert!(again.status.success() && stderr(&again).contains("7 more pictures of layers"), "{}", stderr(&again));
    let layers = dir.path().join("layers");
    // A directory where a picture should be ends it on the way.
    fs::remove_file(layers.join("layer_000011.png")).expect("is there");
    fs::create_dir(layers.join("layer_000011.png")).expect("made");
    assert_eq!(slice(dir.path(), &["--layers", "10..20", "-o", "layers"]).status.code(), Some(1));
    assert!(!layers.join("manifest.json").exists(), "it would describe other pictures");
}

#[test]
fn names_in_files_do_not_reach_the_terminal_as_commands() {
    let dir = bench("", &[]);
    fs::copy(dir.path().join("part.txt"), dir.path().join("\u{1b}[31m\nred.txt")).expect("copied");
    assert!(layerctl(dir.path(), &["pack", "\u{1b}[31m\nred.txt", "-o", "part.layerd"]).status.success());
    let told = layerctl(dir.path(), &["info", "part.layerd"]).stdout;
    assert!(!told.contains(&0x1b) && String::from_utf8_lossy(&told).contains("[31m red.txt"), "{told:?}");
    let told = layerctl(dir.path(), &["info", "\u{1b}[2J.layerd"]).stderr;
    assert!(!told.contains(&0x1b) && !told.is_empty(), "{told:?}");
}

#[test]
fn a_part_that_does_not_fit_the_machine_is_told_as_json_too() {
    let dir = bench("", &["--scale", "3"]);
    let output = check(dir.path(), &["--json"]);
    let found = json(&output);
    assert_eq!((output.status.code(), &found["fits"]), (Some(1), &Value::from(false)));
    let problem = found["problems"][0].as_str().expect("a problem");
    assert!(problem.contains("--scale") && stderr(&output).contains(problem), "{problem}\n{}", stderr(&output));
    let sliced = slice(dir.path(), &["-o", "layers"]);
    assert_eq!(sliced.status.code(), Some(1));
    assert!(stderr(&sliced).contains(problem) && !dir.path().join("layers").exists(), "{}", stderr(&sliced));
}

#[test]
fn what_is_wrong_is_named_with_a_remedy() {
    let dir = bench("", &[]);
    fs::write(dir.path().join("a-file"), "in the way").expect("written");
    let recipes = concat!(env!("CARGO_MANIFEST_DIR"), "/config/recipes/default.toml");
    fs::create_dir_all(dir.path().join("config/recipes")).expect("made");
    fs::copy(recipes, dir.path().join("config/recipes/default.toml")).expect("copied");
    let cases: [(&[&str], i32, &[&str]); 9] = [
        (
            &["slice", "part.layerd", "-m", "nowhere", "-o", "x"],
            1,
            &["no machine named `nowhere`", "/etc/layerd/machines"],
        ),
        (
            &["slice", "part.layerd", "-m", "machine.toml", "-r", "thin", "-o", "x"],
            1,
            &["no recipe named `thin`", "known are default"],
        ),
        (&["check", "part.layerd", "-m", "gone.toml"], 1, &["cannot read gone.toml", "No such file"]),
        (&["check", "gone.layerd", "-m", "machine.toml"], 1, &["gone.layerd", "No such file"]),
        (&["check", "part.txt", "-m", "machine.toml"], 1, &["part.txt", "pack"]),
        (&["slice", "part.layerd", "-m", "machine.toml", "--layers", "80..100", "-o", "x"], 1, &["80..100", "0..90"]),
        (
            &["slice", "part.layerd", "-m", "machine.toml", "--layers", "7..3", "-o", "x"],
            2,
            &["7..3", "holds no layer"],
        ),
        (&["slice", "part.layerd", "-m", "machine.toml", "-o", "a-file"], 1, &["a-file is a file", "directory"]),
        (
            &["slice", "part.layerd", "-m", "machine.toml", "--threads", "0", "-o", "x"],
            2,
            &["--threads", "0 is not in 1..=256"],
        ),
    ];
    for (arguments, code, words) in cases {
        let output = layerctl(dir.path(), arguments);
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {told}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
        for word in words {
            assert!(told.contains(word), "{arguments:?}: `{word}` is missing in: {told}");
        }
    }
}

/// The field of the part at `p`, millimetres, in plain `f64`.
fn field(support_mm: f64, p: [f64; 3]) -> f64 {
    let beam = |(a, b, radius): Strut| Beam { a, b, radius_a: radius, radius_b: radius, caps: [Cap::Sphere; 2] };
    PART.iter().map(|strut| beam_field(&beam(*strut), support_mm, p)).sum()
}

#[test]
fn pixels_agree_with_the_mathematics_that_the_manifest_describes() {
    for (mirror, pack) in [
        ("", &[][..]),
        ("mirror = { x = true, y = false }", &[]),
        ("mirror = { x = true, y = true }", &["--at", "3.1,5.2"]),
    ] {
        let dir = bench(mirror, pack);
        let sliced = slice(dir.path(), &["--layers", "10..30", "-o", "layers"]);
        assert!(sliced.status.success(), "{}", stderr(&sliced));
        let read = fs::read(dir.path().join("layers/manifest.json")).expect("a manifest");
        let manifest: Value = serde_json::from_slice(&read).expect("JSON");
        let number = |value: &Value| value.as_f64().expect("a number");
        assert_eq!((&manifest["width_px"], &manifest["height_px"]), (&200.into(), &160.into()));
        let sign = |axis: &str| if manifest["mirror"][axis] == true { -1.0 } else { 1.0 };
        let step_mm = [0, 1].map(|axis| number(&manifest["pixel_um"][axis]) / 1000.0);
        let step_mm = [step_mm[0] * sign("x"), step_mm[1] * sign("y")];
        let (isovalue, support_mm) = (number(&manifest["isovalue"]), number(&manifest["bodies"][0]["support_mm"]));
        assert_eq!(manifest["layers"].as_array().map(Vec::len), Some(20));
        let mut seen = [0; 2];
        for layer in manifest["layers"].as_array().expect("layers") {
            let file = layer["file"].as_str().expect("a name");
            let picture = image::open(dir.path().join("layers").join(file)).expect("a picture").into_luma8();
            for (x, y, pixel) in picture.enumerate_pixels() {
                let p = [
                    number(&manifest["origin_mm"][0]) + f64::from(x) * step_mm[0],
                    number(&manifest["origin_mm"][1]) + f64::from(y) * step_mm[1],
                    number(&layer["z_mm"]),
                ];
                let field = field(support_mm, p) * isovalue / ISOVALUE;
                let undecided = (field - isovalue).abs() < 1e-5 * isovalue;
                let lit = pixel.0[0] == 255;
                assert!(undecided || lit == (field >= isovalue), "{file} {x} {y}: {field}, {mirror} {pack:?}");
                seen[usize::from(lit)] += 1;
            }
        }
        assert!(seen[1] > 5000 && seen[0] > 5000, "{seen:?}");
    }
}

#[test]
fn a_real_lattice_is_the_same_on_any_number_of_threads_and_from_any_layer() {
    let Some(text) = support::real_data("spot_lattice.txt") else { return };
    let dir = tempfile::tempdir().expect("a directory");
    let ok = |arguments: &[&str]| {
        let output = layerctl(dir.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    };
    let machine = "name = \"4K\"\nkind = \"dlp\"\nwidth_px = 3840\nheight_px = 2160\npixel_um = [20.0, 20.0]\n\
                   build_height_um = 100000.0\nclear_height_um = 30000.0\n[link]\npath = \"device\"\nbaud = 3000000\n";
    fs::write(dir.path().join("4k.toml"), machine).expect("written");
    let recipe = concat!(env!("CARGO_MANIFEST_DIR"), "/config/recipes/fine.toml");
    ok(&["pack", text.to_str().expect("UTF-8"), "--rotate", "0,0,90", "-o", "spot.layerd"]);
    let slice = ["slice", "spot.layerd", "-m", "4k.toml", "-r", recipe];
    ok(&[&slice[..], &["--threads", "1", "--layers", "1498..1502", "-o", "one"]].concat());
    ok(&[&slice[..], &["--threads", "3", "--layers", "1501..1502", "-o", "three"]].concat());
    let picture = |folder: &str| fs::read(dir.path().join(folder).join("layer_001501.png")).expect("a picture");
    assert!(picture("one") == picture("three"));
    let pixels = image::open(dir.path().join("one/layer_001501.png")).expect("a PNG").into_luma8();
    let lit = pixels.pixels().filter(|pixel| pixel.0[0] > 0).count();
    assert!(lit > 100_000, "{lit} pixels are lit");
}

#[test]
fn a_turn_is_proposed_only_where_the_part_then_fits() {
    // The machine takes 38.4 × 21.6 × 100 mm.
    let cases = [
        ([20.0, 30.0, 10.0], Some("0,0,90")),
        ([30.0, 60.0, 10.0], Some("90,0,0")),
        ([60.0, 20.0, 10.0], Some("0,90,0")),
        ([20.0, 60.0, 30.0], Some("90,0,90")),
        ([60.0, 30.0, 20.0], Some("90,90,0")),
        ([120.0, 30.0, 30.0], None),
    ];
    let dir = tempfile::tempdir().expect("a directory");
    for (size, turn) in cases {
        let [x, y, z] = size.map(|edge: f64| edge - 1.0);
        let text = format!("3 0.5\n0 0 0 {x} 0 0\n0 0 0 0 {y} 0\n0 0 0 0 0 {z}\n");
        fs::write(dir.path().join("axes.txt"), text).expect("written");
        let pack = |rotate: &str| {
            let output = layerctl(
                dir.path(),
                &["pack", "axes.txt", "--blend", "union", "--rotate", rotate, "-o", "axes.layerd"],
            );
            assert!(output.status.success(), "{}", stderr(&output));
            layerctl(dir.path(), &["check", "axes.layerd", "-m", "sim-dlp"])
        };
        let refused = pack("0,0,0");
        let told = stderr(&refused);
        assert_eq!(refused.status.code(), Some(1), "{told}");
        match turn {
            Some(turn) => {
                assert!(told.contains(&format!("pack it with `--rotate {turn}`")), "{size:?}: {told}");
                let turned = pack(turn);
                assert!(turned.status.success(), "{size:?} turned by {turn}: {}", stderr(&turned));
            }
            None => assert!(told.contains("--scale") && !told.contains("--rotate"), "{size:?}: {told}"),
        }
    }
}
