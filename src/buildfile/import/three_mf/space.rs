//! The XML namespaces of a 3MF package. `xml` resolves every element and attribute to one of them.

/// A namespace. Elements and attributes are identified by namespace, never by the prefix that a file uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Space {
    /// Relationships of the package.
    Relationships,
    Core,
    Lattice,
    Balls,
    Production,
    Displacement,
    /// Materials and properties.
    Material,
    /// An extension that cannot change the shape: triangle sets.
    Shapeless,
    /// Any other namespace, or none.
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
            "http://schemas.microsoft.com/3dmanufacturing/material/2015/02" => Self::Material,
            "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07" => Self::Shapeless,
            // Published files use several owners and dates.
            _ if uri.contains("/displacement/") => Self::Displacement,
            _ => Self::Other,
        }
    }
}
