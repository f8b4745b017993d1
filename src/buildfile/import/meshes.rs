//! Where importers hand over triangles: flat ones go to `surface`, those of surfaces with relief to `relief`. `collect` has one.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::check_regular;
use super::height_map::{Channel, MapUse};
use super::relief::{CollectedRelief, Face, ReliefLane, placed};
use super::rules::Rules;
use super::surface::{CollectedSurface, SurfaceLane};
use crate::buildfile::error::PackError;
use crate::buildfile::model::Bounds;
use crate::buildfile::options::{DisplacementOptions, PackOptions, ReliefOptions};

/// Takes the triangles of all sources.
pub(super) struct Meshes<'a> {
    rules: &'a Rules,
    options: ReliefOptions,
    surface: SurfaceLane<'a>,
    relief: ReliefLane<'a>,
    /// Whether the triangles of the current solid have relief.
    is_relief: bool,
    /// Displacement of all triangles, if the options name a map.
    displacement: Option<u8>,
    /// The maps that were read from files, and their numbers.
    files: Vec<(PathBuf, MapUse, u16)>,
    /// Material libraries that were read.
    libraries: Vec<PathBuf>,
    notes: Vec<String>,
}

impl<'a> Meshes<'a> {
    /// Flat triangles, and those with relief, may take `memory_bytes` each. Flat ones are sorted in `directory` if they do not fit.
    pub(super) fn new(rules: &'a Rules, options: &PackOptions, memory_bytes: u64, directory: &Path) -> Self {
        let relief = ReliefLane::new(rules, &options.relief, memory_bytes);
        Self {
            rules,
            options: options.relief.clone(),
            surface: SurfaceLane::new(rules, memory_bytes, directory),
            relief,
            is_relief: options.relief.applies(),
            displacement: None,
            files: Vec::new(),
            libraries: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// Number of triangles so far, with and without relief.
    pub(super) fn count(&self) -> u64 {
        self.surface.count() + self.relief.count()
    }

    /// A box around all triangles, as they are before they are displaced.
    pub(super) fn bounds(&self) -> Bounds {
        self.surface.bounds().joined(&self.relief.bounds())
    }

    /// Temporary space taken, bytes.
    pub(super) fn spilled_bytes(&self) -> u64 {
        self.surface.spilled_bytes()
    }

    /// Reads the map that the options name.
    ///
    /// # Errors
    /// If it cannot be read.
    pub(super) fn open_map(&mut self) -> Result<(), PackError> {
        let Some(DisplacementOptions { map, tile }) = self.options.map.clone() else { return Ok(()) };
        let number = self.map_of(&map, MapUse::of(Channel::default(), tile))?;
        let range_mm = self.height_range([0.0, 0.0]);
        self.displacement = Some(self.displacement(number, range_mm, &map.display().to_string())?);
        Ok(())
    }

    /// The map that the options name, if they do.
    pub(super) fn map_path(&self) -> Option<&Path> {
        self.options.map.as_ref().map(|options| options.map.as_path())
    }

    /// Keeps the name of a material library that is read.
    pub(super) fn reads_library(&mut self, path: &Path) {
        self.libraries.push(path.into());
    }

    /// The files that were read beside the sources: maps and material libraries.
    pub(super) fn read_files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|(path, ..)| path).chain(&self.libraries).map(PathBuf::as_path)
    }

    /// Whether the maps that a source names apply.
    pub(super) fn takes_maps(&self) -> bool {
        self.options.map.is_none() && self.options.height_mm != Some(0.0)
    }

    /// Begins a file or an object. `has_relief`: its triangles state displacements.
    pub(super) fn begin_solid(&mut self, has_relief: bool) {
        self.is_relief = has_relief || self.options.applies();
    }

    /// Whether texture coordinates and normals of the current solid matter.
    pub(super) fn is_relief(&self) -> bool {
        self.is_relief
    }

    /// Whether surfaces are printed as shells, which may be open.
    pub(super) fn is_shell(&self) -> bool {
        self.options.shell_mm.is_some()
    }

    /// Reads a map from a file, once, and returns its number.
    ///
    /// # Errors
    /// If it cannot be read, or is no PNG.
    pub(super) fn map_of(&mut self, path: &Path, usage: MapUse) -> Result<u16, PackError> {
        let known = |(other, as_usage, _): &&(PathBuf, MapUse, u16)| other == path && *as_usage == usage;
        if let Some((.., number)) = self.files.iter().find(known) {
            return Ok(*number);
        }
        check_regular(path)?;
        let read = std::fs::File::open(path).map_err(|source| PackError::Read { path: path.into(), source })?;
        let number = self.map(std::io::BufReader::new(read), usage, &path.display().to_string())?;
        self.files.push((path.into(), usage, number));
        Ok(number)
    }

    /// Adds a map that `place` names, and returns its number.
    ///
    /// # Errors
    /// If it is no PNG, too large, has colours and must not, or there are too many maps.
    pub(super) fn map(
        &mut self,
        png: impl std::io::BufRead + std::io::Seek,
        usage: MapUse,
        place: &str,
    ) -> Result<u16, PackError> {
        let (number, is_coloured) = self.relief.map(png, usage, place)?;
        if is_coloured {
            self.notes.push(format!("{place} has colours; its {} channel is taken for heights", usage.channel.name()));
        }
        Ok(number)
    }

    /// Displacements where a map is 0 and 1, millimetres: those that a source states, unless the options say otherwise.
    pub(super) fn height_range(&self, [low_mm, high_mm]: [f64; 2]) -> [f64; 2] {
        let height_mm = self.options.height_mm.unwrap_or(high_mm - low_mm);
        let offset_mm = self.options.offset_mm.unwrap_or(low_mm);
        [offset_mm, offset_mm + height_mm]
    }

    /// Adds a displacement along normals, from where a map is 0 to where it is 1, millimetres; returns its number for [`Face`].
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn displacement(&mut self, map: u16, [low_mm, high_mm]: [f64; 2], place: &str) -> Result<u8, PackError> {
        let (displacement, _) = placed(map, high_mm - low_mm, low_mm, DMat3::IDENTITY);
        self.relief.displacement(displacement, &|| place.to_owned())
    }

    /// Adds a displacement that acts before `transform` and the options do, by height and offset in millimetres. Returns its number, and what
    /// directions become.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn placed_displacement(
        &mut self,
        map: u16,
        [height_mm, offset_mm]: [f64; 2],
        transform: DMat3,
        place: &dyn Fn() -> String,
    ) -> Result<(u8, DMat3), PackError> {
        let (displacement, turn) = placed(map, height_mm, offset_mm, self.rules.map() * transform);
        Ok((self.relief.displacement(displacement, place)?, turn))
    }

    /// A length of a source as the options scale it: by the mean of their factors.
    pub(super) fn scaled(&self, length: f64) -> f64 {
        length * self.rules.stretch().mean()
    }

    /// A normal of a source, as a direction of a [`Face`].
    pub(super) fn normal(&self, normal: DVec3) -> DVec3 {
        self.rules.normal(normal)
    }

    /// Adds a triangle; `place` names it in errors.
    ///
    /// # Errors
    /// If a number is out of range, something is missing, memory does not suffice, or the temporary file cannot be written.
    pub(super) fn face(&mut self, face: &Face, place: &dyn Fn() -> String) -> Result<(), PackError> {
        if !self.is_relief {
            return self.surface.triangle(face.corners, place);
        }
        self.relief.face(&Face { displacement: self.displacement.or(face.displacement), ..*face }, place)
    }

    /// Ends a file or an object, which `place` names, whose triangles enclose a solid.
    ///
    /// # Errors
    /// If they do not enclose anything: the surface is open, or inside out.
    pub(super) fn end_solid(&mut self, place: &str) -> Result<(), PackError> {
        if std::mem::replace(&mut self.is_relief, self.options.applies()) {
            self.relief.end_solid(place)
        } else {
            self.surface.end_solid(place)
        }
    }

    /// All triangles. Adds notes for the operator.
    ///
    /// # Errors
    /// If a displaced triangle reaches too far.
    pub(super) fn finish(
        mut self,
        notes: &mut Vec<String>,
    ) -> Result<(Option<CollectedSurface>, Option<CollectedRelief>), PackError> {
        notes.append(&mut self.notes);
        let has_height =
            self.options.height_mm.is_some_and(|height_mm| height_mm != 0.0) || self.options.offset_mm.is_some();
        if has_height && !self.relief.is_displaced() {
            notes.push(
                "--height and --offset change nothing: nothing names a height map, and there is no --displacement"
                    .into(),
            );
        }
        Ok((self.surface.finish(notes), self.relief.finish(notes)?))
    }
}
