//! Packs small sources in a directory of its own.

#![allow(dead_code, reason = "each test program uses a part of it")]

use std::fmt::Write as _;
use std::io::Write as _;
use std::num::NonZero;
use std::path::{Path, PathBuf};

use layerd::buildfile::{BodyHeader, BuildFile, JointChoice, Lattice, PackError, PackOptions, PackReport, Strut, pack};
use zip::write::SimpleFileOptions;

/// Names `3D/odd name.model` as the model.
pub(crate) const RELATIONSHIPS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
    <Relationship Target="/3D/odd name.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
    </Relationships>"#;

/// The lattice of what was packed.
pub(crate) fn packed_lattice(report: &PackReport) -> &Lattice {
    report.header.lattices().next().expect("it has one")
}

pub(crate) struct Bench {
    pub(crate) directory: tempfile::TempDir,
    pub(crate) options: PackOptions,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let threads = NonZero::<usize>::MIN.saturating_add(1);
        let options = PackOptions { joint: Some(JointChoice::Union), threads, ..PackOptions::default() };
        Self { directory: tempfile::tempdir().expect("temporary directory"), options }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    pub(crate) fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).expect("can be written");
        path
    }

    pub(crate) fn pack(&self, input: &Path) -> Result<(PackReport, Vec<Strut>), PackError> {
        let output = self.path("out.layerd");
        let report = pack(&[input.to_owned()], &output, &self.options, &mut |_| {})?;
        let file = BuildFile::open(&output).expect("what pack writes is whole");
        let mut struts = Vec::new();
        for (number, body) in file.header().bodies.iter().enumerate() {
            if matches!(body, BodyHeader::Lattice(_)) {
                file.body_chunks(number).for_each(|chunk| file.read_chunk(chunk, &mut struts).expect("is whole"));
            }
        }
        Ok((report, struts))
    }

    pub(crate) fn text(&self, text: &str) -> Result<(PackReport, Vec<Strut>), PackError> {
        self.pack(&self.file("in.txt", text.as_bytes()))
    }

    /// Packs a 3MF file with this model.
    pub(crate) fn model(&self, model: &str) -> Result<(PackReport, Vec<Strut>), PackError> {
        self.package(&[("../../escape.txt", "never read"), ("_rels/.rels", RELATIONSHIPS), (MODEL, model)])
    }

    /// Packs a 3MF file with these parts.
    pub(crate) fn package(&self, parts: &[(&str, &str)]) -> Result<(PackReport, Vec<Strut>), PackError> {
        let parts: Vec<_> = parts.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
        self.package_bytes(&parts)
    }

    /// The same, with parts that may be no text.
    pub(crate) fn package_bytes(&self, parts: &[(&str, &[u8])]) -> Result<(PackReport, Vec<Strut>), PackError> {
        let path = self.path("in.3mf");
        let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).expect("can be created"));
        for (name, bytes) in parts {
            zip.start_file(*name, SimpleFileOptions::default()).expect("can be started");
            zip.write_all(bytes).expect("can be written");
        }
        zip.finish().expect("can be finished");
        self.pack(&path)
    }
}

pub(crate) fn said(result: Result<(PackReport, Vec<Strut>), PackError>) -> String {
    result.expect_err("must be refused").to_string()
}

pub(crate) const HEAD: &str = r#"<?xml version="1.0"?><model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
 xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"
 xmlns:b2="http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07"
 xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
 xmlns:x="http://example.org/unheard-of" "#;

pub(crate) const VERTICES: &str =
    r#"<vertices><vertex x="0" y="0" z="0"/><vertex x="0" y="0" z="10"/><vertex x="8" y="0" z="10"/></vertices>"#;

/// A model of one object: its lattice's attributes, what stands in the lattice, what stands beside it, and the item.
pub(crate) fn model(root: &str, attributes: &str, lattice: &str, beside: &str, build: &str) -> String {
    format!(
        r#"{HEAD}{root}><resources><object id="7" name="Tower"><mesh>{VERTICES}{beside}
        <b:beamlattice radius="1" minlength="0.001" {attributes}>{lattice}</b:beamlattice></mesh></object>
        <object id="8"><components><component objectid="7" transform="0 1 0 -1 0 0 0 0 1 100 0 0"/></components></object>
        </resources><build>{build}</build></model>"#
    )
}

pub(crate) const BEAM: &str = r#"<b:beams><b:beam v1="0" v2="1"/></b:beams>"#;
pub(crate) const ITEM: &str = r#"<item objectid="7"/>"#;

/// The part that [`RELATIONSHIPS`] names.
pub(crate) const MODEL: &str = "3D/odd name.model";

/// A model of one object 7 that holds a lattice of vertical beams at these x, 10 mm high, with a radius of 1 mm.
pub(crate) fn posts(root: &str, at: &[u32], build: &str) -> String {
    let mut vertices = String::new();
    let mut beams = String::new();
    for (number, x) in at.iter().enumerate() {
        write!(vertices, r#"<vertex x="{x}" y="0" z="0"/><vertex x="{x}" y="0" z="10"/>"#).expect("a string grows");
        write!(beams, r#"<b:beam v1="{}" v2="{}"/>"#, 2 * number, 2 * number + 1).expect("a string grows");
    }
    format!(
        r#"{HEAD}{root}><resources><object id="7" name="Posts"><mesh><vertices>{vertices}</vertices>
        <b:beamlattice radius="1" minlength="0.001"><b:beams>{beams}</b:beams></b:beamlattice></mesh></object></resources>
        <build>{build}</build></model>"#
    )
}

/// A model of these objects, and this build.
pub(crate) fn objects(objects: &str, build: &str) -> String {
    let lattice =
        r#"<b:beamlattice radius="1" minlength="0"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>"#;
    let mesh = r#"<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="0" y="0" z="5"/></vertices>LATTICE</mesh>"#;
    let mesh = mesh.replace("LATTICE", lattice);
    format!("{HEAD}><resources>{}</resources><build>{build}</build></model>", objects.replace("MESH", &mesh))
}

/// What packing a model notes, and its struts.
pub(crate) fn notes(bench: &Bench, model: &str) -> (String, Vec<Strut>) {
    let (report, struts) = bench.model(model).unwrap_or_else(|error| panic!("{error}: {model}"));
    (report.notes.join("\n"), struts)
}
