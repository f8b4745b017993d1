//! Values of attributes: numbers and transforms. Errors name element, attribute and value. `structure` and `lattice` read with them.

use glam::DAffine3;

use super::xml::{Element, quote};

/// A required number.
///
/// # Errors
/// A text that names element and attribute.
pub(super) fn required<T: std::str::FromStr>(element: &Element, name: &str) -> Result<T, String> {
    optional(element, name)?.ok_or_else(|| format!("`{}` without {name}", element.name()))
}

/// An optional number.
///
/// # Errors
/// A text that names element, attribute and value.
pub(super) fn optional<T: std::str::FromStr>(element: &Element, name: &str) -> Result<Option<T>, String> {
    element.get(name).map(|text| number(element, name, text)).transpose()
}

/// An optional finite number.
///
/// # Errors
/// As [`optional`].
pub(super) fn measure(element: &Element, name: &str) -> Result<Option<f64>, String> {
    element.get(name).map(|text| finite(element, name, text)).transpose()
}

/// Parses `text`, the value of an attribute, as a finite number.
///
/// # Errors
/// As [`optional`].
pub(super) fn finite(element: &Element, name: &str, text: &str) -> Result<f64, String> {
    let value: f64 = number(element, name, text)?;
    if !value.is_finite() {
        return Err(format!("{name} = {value} in `{}` is not a finite number", element.name()));
    }
    Ok(value)
}

fn number<T: std::str::FromStr>(element: &Element, name: &str, text: &str) -> Result<T, String> {
    text.trim().parse().map_err(|_| format!("{name} = `{}` in `{}` is not a number", quote(text), element.name()))
}

/// The transform of a component or build item, in millimetres. `unit_mm` is the length of the unit of the model.
///
/// # Errors
/// A text that repeats the value.
pub(super) fn transform(element: &Element, unit_mm: f64) -> Result<DAffine3, String> {
    let Some(text) = element.get("transform") else { return Ok(DAffine3::IDENTITY) };
    let problem = || format!("transform `{}` is not 12 finite numbers", quote(text));
    let mut values = [0.0; 12];
    let mut fields = text.split_ascii_whitespace();
    for value in &mut values {
        let parsed = fields.next().and_then(|field| field.parse().ok());
        *value = parsed.filter(|value: &f64| value.is_finite()).ok_or_else(problem)?;
    }
    if fields.next().is_some() {
        return Err(problem());
    }
    // 3MF multiplies row vectors, so its rows are the images of the axes: the columns of this type.
    let mut transform = DAffine3::from_cols_array(&values);
    transform.translation *= unit_mm;
    Ok(transform)
}
