//! `.sl1` archives, read back by a zip reader and an image library: by the rules of the printer, PrusaSlicer and UVtools.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use layerd::layer::export::{Sl1Print, Sl1Writer};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};

fn print(layer_count: u32) -> Sl1Print {
    Sl1Print {
        name: "Teddy (2)".into(),
        machine: "Original Prusa SL1S".into(),
        recipe: "fine".into(),
        raster: Raster {
            width_px: 1620,
            height_px: 2560,
            pixel_um: [50.0, 50.0],
            build_height_um: 150_000.0,
            mirror: Mirror { x: true, y: false },
        },
        layer_height_um: 35.5,
        exposure_ms: 2150,
        first_exposure_ms: 25_000,
        fade_layers: 10,
        layer_count,
        print_time_s: 3601.4,
    }
}

/// The entries of an archive in their order.
fn entries(path: &Path) -> Vec<(String, Vec<u8>)> {
    let mut zip = zip::ZipArchive::new(std::fs::File::open(path).expect("the file")).expect("a zip");
    let count = zip.len();
    let read = |index: usize| {
        let mut file = zip.by_index(index).expect("an entry");
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).expect("its bytes");
        (file.name().expect("a name").into_owned(), bytes)
    };
    (0..count).map(read).collect()
}

fn ini(bytes: &[u8]) -> BTreeMap<String, String> {
    let lines = std::str::from_utf8(bytes).expect("text").lines();
    let pairs = lines.map(|line| line.split_once(" = ").expect("key and value"));
    pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).collect()
}

#[test]
fn an_archive_has_both_settings_and_a_picture_for_each_layer() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("teddy.sl1s");
    let mut writer = Sl1Writer::create(&path, &print(12)).expect("begun");
    let mut bitmap = Bitmap::new(1620, 2560, Depth::Grey);
    for layer in 0..12 {
        bitmap.data_mut()[layer * 1000 + 7] = 100 + layer as u8;
        writer.layer(&bitmap).expect("written");
    }
    assert!(!path.exists(), "a file appears whole");
    writer.finish().expect("ended");
    assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);

    let entries = entries(&path);
    let config = ini(&entries[0].1);
    assert_eq!(entries[0].0, "config.ini");
    let is = |key: &str, value: &str| assert_eq!(config[key], value, "{key}");
    is("printerModel", "SL1S");
    is("jobDir", "Teddy__2_");
    is("layerHeight", "0.0355");
    is("expTime", "2.15");
    is("expTimeFirst", "25");
    is("numFade", "10");
    is("printTime", "3601");
    let number = |key: &str| config[key].parse::<u32>().expect("a number");
    assert_eq!(number("numSlow") + number("numFast"), 12);

    assert_eq!(entries[1].0, "prusaslicer.ini");
    let profile = ini(&entries[1].1);
    let is = |key: &str, value: &str| assert_eq!(profile[key], value, "{key}");
    is("display_orientation", "landscape");
    is("display_pixels_x", "1620");
    is("display_pixels_y", "2560");
    is("display_width", "81");
    is("display_height", "128");
    is("display_mirror_x", "1");
    is("display_mirror_y", "1");
    is("printer_model", "SL1S");
    is("printer_technology", "SLA");
    let height = |key: &str| profile[key].parse::<f64>().expect("a number");
    assert!(height("initial_layer_height") <= height("layer_height"));

    let mut names: Vec<_> = entries[2..].iter().map(|(name, _)| name.clone()).collect();
    assert_eq!(names[0], "Teddy__2_00000.png");
    assert!(names.iter().all(|name| name.starts_with(&config["jobDir"])));
    let in_order = names.clone();
    names.sort();
    assert_eq!(names, in_order, "readers sort by name");
    let mut expected = Bitmap::new(1620, 2560, Depth::Grey);
    for (layer, (_, png)) in entries[2..].iter().enumerate() {
        expected.data_mut()[layer * 1000 + 7] = 100 + layer as u8;
        let image = image::load_from_memory_with_format(png, image::ImageFormat::Png).expect("a PNG");
        assert_eq!(image.color(), image::ColorType::L8, "8-bit grey");
        let image = image.into_luma8();
        assert_eq!((image.width(), image.height()), (1620, 2560));
        assert!(image.as_raw() == expected.data(), "layer {layer}");
    }
}

#[test]
fn names_that_readers_would_mistake_are_changed() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("part.sl1");
    let job_dir = |name: &str, machine: &str| {
        let raster = Raster { width_px: 2560, height_px: 1600, ..print(0).raster };
        let print = Sl1Print { name: name.into(), machine: machine.into(), raster, ..print(0) };
        Sl1Writer::create(&path, &print).and_then(Sl1Writer::finish).expect("written");
        let config = ini(&entries(&path)[0].1);
        (config["jobDir"].clone(), config["printerModel"].clone())
    };
    assert_eq!(job_dir("12e3", "LCD 4K, 35 µm"), ("part-12e3".into(), "LCD_4K__35__m".into()));
    assert_eq!(job_dir("my Thumbnails", "x").0, "part-my_thumbs");
    assert_eq!(job_dir("../a\n[b] = \"c\"", "x").0, "part-.._a__b_____c_");
}

#[test]
fn a_wrong_number_of_layers_leaves_no_file() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("part.sl1");
    let mut writer = Sl1Writer::create(&path, &print(1)).expect("begun");
    let bitmap = Bitmap::new(1620, 2560, Depth::Bit);
    writer.layer(&bitmap).expect("written");
    assert!(writer.layer(&bitmap).is_err());
    let short = Sl1Writer::create(&path, &print(1)).expect("begun");
    assert!(short.finish().is_err());
    let error = Sl1Writer::create(&path, &print(100_001)).expect_err("too many").to_string();
    assert_eq!(error, "an .sl1 has at most 100000 layers, and here are 100001");
    drop(writer);
    assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 0);
}
