//! The namespaces that a 3MF package is written in.

/// What a namespace means here. Elements and attributes are told apart by it, never by the prefix a file happens to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Space {
    /// Relationships of the package.
    Relationships,
    Core,
    Lattice,
    Balls,
    Production,
    Displacement,
    /// An extension that cannot change the shape: materials and properties, and triangle sets.
    Shapeless,
    /// Anything else, and no namespace at all.
    Other,
}

impl Space {
    pub(super) fn of(uri: &str) -> Self {
        match uri {
            "http://schemas.openxmlformats.org/package/2006/relationships" => Self::Relationships,
            "http://schemas.microsoft.com/3dmanufacturing/core/2015/02" => Self::Core,
            "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" => Self::Lattice,
            "http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07" => Self::Balls,
            "http://schemas.microsoft.com/3dmanufacturing/production/2015/06" => Self::Production,
            "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
            | "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07" => Self::Shapeless,
            // Published files name two owners and several years.
            _ if uri.starts_with("http://schemas.microsoft.com/3dmanufacturing/displacement/")
                || uri.starts_with("http://schemas.3mf.io/3dmanufacturing/displacement/") =>
            {
                Self::Displacement
            }
            _ => Self::Other,
        }
    }
}
