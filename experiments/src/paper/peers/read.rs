//! The files of `peers.py` and `chain.py`.

use std::collections::BTreeMap;

/// One registration, or one whole reconstruction.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) group: String,
    pub(super) case: String,
    pub(super) method: String,
    pub(super) threads: usize,
    pub(super) repeat: String,
    pub(super) is_right: bool,
    /// In the clouds' unit; infinite where nothing was found.
    pub(super) error: f64,
    pub(super) seconds: f64,
    pub(super) wall_s: String,
}

/// What `peers.py` has written.
pub(super) fn registrations(text: &str) -> Result<Vec<Row>, String> {
    records(text)?.iter().map(registration).collect()
}

/// What `chain.py` has written: every view but the first, which lies at its true place, and each reconstruction as a whole: all
/// its views' time, and the root mean square of their errors.
pub(super) fn reconstructions(name: &str, text: &str) -> Result<Vec<Row>, String> {
    let mut rows = Vec::new();
    let mut wholes: Vec<(Row, f64)> = Vec::new();
    for record in &records(text)? {
        let error = found(number(record, "rms_mm")?);
        let row = Row {
            group: format!("{name}{A_VIEW}"),
            case: cell(record, "view")?.to_owned(),
            method: cell(record, "method")?.to_owned(),
            threads: number(record, "threads")? as usize,
            repeat: cell(record, "repeat")?.to_owned(),
            is_right: cell(record, "merged")? == "1" && error < RIGHT_VIEW_MM,
            error,
            seconds: found(number(record, "seconds")?),
            wall_s: String::new(),
        };
        let key = |row: &Row| (row.method.clone(), row.threads, row.repeat.clone());
        if wholes.last().is_none_or(|(whole, _)| key(whole) != key(&row)) {
            let whole = Row {
                group: format!("{name}{WHOLE}"),
                case: "all".to_owned(),
                error: 0.0,
                seconds: 0.0,
                is_right: true,
                ..row.clone()
            };
            wholes.push((whole, 0.0));
        }
        if let Some((whole, count)) = wholes.last_mut() {
            whole.seconds += row.seconds;
            whole.is_right &= row.is_right;
            if row.case != "0" {
                whole.error += row.error.powi(2);
                *count += 1.0;
            }
        }
        if row.case != "0" {
            rows.push(row);
        }
    }
    rows.extend(wholes.into_iter().map(|(whole, count)| Row {
        error: (whole.error / f64::max(count, 1.0)).sqrt(),
        ..whole
    }));
    Ok(rows)
}

fn registration(record: &BTreeMap<&str, &str>) -> Result<Row, String> {
    let (experiment, level) = (cell(record, "exp")?, cell(record, "level")?);
    let group = if experiment.ends_with(level) {
        experiment.to_owned()
    } else {
        format!("{experiment} {level}")
    };
    Ok(Row {
        group,
        case: cell(record, "case")?.to_owned(),
        method: cell(record, "method")?.to_owned(),
        threads: number(record, "threads")? as usize,
        repeat: cell(record, "repeat")?.to_owned(),
        is_right: cell(record, "success")? == "1",
        error: found(number(record, "rmse")?),
        seconds: found(number(record, "seconds")?),
        wall_s: cell(record, "wall_s")?.to_owned(),
    })
}

/// The cells of each line by the names in the first.
fn records(text: &str) -> Result<Vec<BTreeMap<&str, &str>>, String> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    lines
        .enumerate()
        .map(|(index, line)| {
            let cells: Vec<&str> = line.split(',').collect();
            if cells.len() == names.len() {
                Ok(names.iter().copied().zip(cells).collect())
            } else {
                Err(format!(
                    "line {}: {} cells, not {}",
                    index + 2,
                    cells.len(),
                    names.len()
                ))
            }
        })
        .collect()
}

fn cell<'a>(record: &BTreeMap<&str, &'a str>, name: &str) -> Result<&'a str, String> {
    record.get(name).copied().ok_or_else(|| format!("no column `{name}`"))
}

fn number(record: &BTreeMap<&str, &str>, name: &str) -> Result<f64, String> {
    let text = cell(record, name)?;
    text.parse().map_err(|_| format!("`{name}`: `{text}` is not a number"))
}

/// What was not found is infinitely far off and takes for ever.
fn found(value: f64) -> f64 {
    if value.is_finite() { value } else { f64::INFINITY }
}

/// Ends the name of a group of single views, and that of a group of whole reconstructions.
pub(super) const A_VIEW: &str = ", a view";
pub(super) const WHOLE: &str = ", whole";
/// A view farther off would be merged as a second surface: the voxel of the merged points.
const RIGHT_VIEW_MM: f64 = 0.15;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_another_shape_is_refused() {
        assert!(records("a,b\n1,2,3\n").is_err());
        assert!(registrations("method,threads\nicp,1\n").is_err());
        assert!(
            reconstructions(
                "lpt",
                "method,threads,repeat,view,merged,rms_mm,seconds\nicp,1,0,1,1,?,1\n"
            )
            .is_err()
        );
    }
}
