//! Cells of tables, in CSV and in Markdown.

use rekindle_base::text::csv_cell;

/// A number with as many decimals as it needs; nothing where there is none.
pub(crate) fn cell(value: Option<impl Into<f64>>, decimals: usize) -> String {
    match value.map(Into::into) {
        Some(value) if value.is_finite() => format!("{value:.decimals$}"),
        _ => String::new(),
    }
}

/// A cell with its unit, or a dash.
pub(crate) fn with_unit(cell: String, unit: &str) -> String {
    if cell.is_empty() {
        "–".to_owned()
    } else {
        cell + unit
    }
}

pub(crate) fn percent(value: Option<f64>) -> Option<f64> {
    value.map(|v| 100.0 * v)
}

/// A text as one field of a CSV file, in quotes only where it needs them.
pub(crate) fn field(text: &str) -> String {
    let cell = csv_cell(text);
    let plain = &cell[1..cell.len() - 1];
    if plain.contains([',', '"', '\n', '\r']) {
        cell
    } else {
        plain.to_owned()
    }
}

/// Bytes as mebibytes.
pub(crate) fn mebibytes(bytes: Option<f64>) -> Option<f64> {
    bytes.map(|b| b / f64::from(1 << 20))
}
