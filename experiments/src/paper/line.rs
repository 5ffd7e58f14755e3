//! The criteria along a line (Fig. P4 and P3): a template of four points and a reference with an outlier.
//!
//! The paper gives the outliers' places, the right shift (+5) and ε², but its points only in the picture. These points have the
//! properties that its text describes: an outlier 0.5 from a point, and a second fit of squared distances far to the right.

use super::item::{Item, Summary, short};
use super::svg::{Axis, Plot, Series, Style};

/// Points that are shifted.
const TEMPLATE: [f64; 4] = [0.0, 1.0, 2.0, 9.0];
/// The shift that lays the template on the reference.
const TRUTH: f64 = 5.0;
const SOFTENINGS: [f64; 4] = [2.0, 4.0, 8.0, 16.0];
const OUTLIERS: [f64; 4] = [4.5, 5.5, 7.5, 11.5];
/// ε² beside the squared distances.
const SOFTENING: f64 = 8.0;
const SHIFT_STEP: f64 = 0.05;
const SHIFT_STEP_COUNT: i32 = 600;

/// Fig. P4: ε² of 2, 4, 8 and 16 with an outlier at 4.5.
pub(crate) fn by_softening() -> Item {
    let reference = reference(OUTLIERS[0]);
    let mut item = item(&["softening", "shift", "nfi"]);
    for softening in SOFTENINGS {
        let curve = curve(|shift| nfi(&reference, shift, softening));
        let name = format!("ε² = {softening}");
        let found = minima(&curve);
        let one = found.len() == 1;
        let claim = match softening {
            2.0 => ("a local minimum besides", !one),
            4.0 => ("smoother than 2", found.len() < minima_at(&reference, 2.0)),
            _ => ("one minimum (\"convex\")", one),
        };
        item.summary.push(Summary::new(
            &name,
            format!("lowest at +5; {}", claim.0),
            said(&curve),
            verdict(claim.1 && is_right(&curve)),
        ));
        item.rows.extend(
            curve
                .iter()
                .map(|[shift, value]| vec![softening.to_string(), format!("{shift:.2}"), format!("{value:.9}")]),
        );
        let part = format!("eps{softening}");
        item.plot(
            part,
            &plot(
                &format!("NFI, {name}, outlier at 4.5"),
                "NFI error",
                vec![(name, curve)],
            ),
        );
    }
    item
}

/// Fig. P3: outliers at 4.5, 5.5, 7.5 and 11.5.
pub(crate) fn by_outlier() -> Item {
    let mut item = item(&["outlier", "shift", "nfi", "squared_of_template", "squared_of_reference"]);
    for outlier in OUTLIERS {
        let reference = reference(outlier);
        let energy = curve(|shift| nfi(&reference, shift, SOFTENING));
        let of_template = curve(|shift| squared(&moved(shift), &reference));
        let of_reference = curve(|shift| squared(&reference, &moved(shift)));
        for ((a, b), c) in energy.iter().zip(&of_template).zip(&of_reference) {
            let values = [a[1], b[1], c[1]].map(|value| format!("{value:.9}"));
            item.rows
                .push([vec![outlier.to_string(), format!("{:.2}", a[0])], values.to_vec()].concat());
        }
        let what = |name: &str| format!("outlier {outlier}, {name}");
        item.summary.push(Summary::new(
            what("NFI"),
            "one minimum, at +5",
            said(&energy),
            verdict(is_right(&energy) && minima(&energy).len() == 1),
        ));
        item.summary.push(Summary::new(
            what("ℓ2, template to reference"),
            "further minima, one far to the right",
            said(&of_template),
            verdict(minima(&of_template).len() > 1),
        ));
        item.summary.push(Summary::new(
            what("ℓ2, reference to template"),
            "-",
            said(&of_reference),
            if is_right(&of_reference) {
                "not drawn aside"
            } else {
                "drawn aside by the outlier"
            },
        ));
        item.plot(
            format!("nfi-{outlier}"),
            &plot(
                &format!("NFI, ε² = {SOFTENING}, outlier at {outlier}"),
                "NFI error",
                vec![("NFI".to_owned(), energy)],
            ),
        );
        item.plot(
            format!("l2-{outlier}"),
            &plot(
                &format!("Nearest points, outlier at {outlier}"),
                "squared distance",
                vec![
                    ("template to reference".to_owned(), of_template),
                    ("reference to template".to_owned(), of_reference),
                ],
            ),
        );
    }
    item
}

fn item(columns: &[&'static str]) -> Item {
    Item::new(
        columns,
        format!(
            "The paper's points are only in its picture. Here the template is {TEMPLATE:?}, the reference the same points shifted by +5 and the outlier: chosen to have what the text describes."
        ),
    )
}

fn reference(outlier: f64) -> Vec<f64> {
    moved(TRUTH).into_iter().chain([outlier]).collect()
}

fn moved(shift: f64) -> Vec<f64> {
    TEMPLATE.iter().map(|x| x + shift).collect()
}

/// The criterion of eq. 5.
fn nfi(reference: &[f64], shift: f64, softening: f64) -> f64 {
    let of = |x: f64| reference.iter().map(|y| 1.0 / ((y - x).abs() + softening)).sum::<f64>();
    -moved(shift).into_iter().map(of).sum::<f64>()
}

/// The squared distances of `from` to the nearest of `to` (eq. 2 and 3).
fn squared(from: &[f64], to: &[f64]) -> f64 {
    let nearest = |x: &f64| to.iter().map(|y| (y - x).powi(2)).fold(f64::INFINITY, f64::min);
    from.iter().map(nearest).sum()
}

fn curve(value: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
    (0..=SHIFT_STEP_COUNT)
        .map(|step| TRUTH + SHIFT_STEP * f64::from(step - SHIFT_STEP_COUNT / 2))
        .map(|shift| [shift, value(shift)])
        .collect()
}

/// The points that are lower than both neighbours, the lowest first.
fn minima(curve: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let is_low = |three: &&[[f64; 2]]| three[1][1] < three[0][1] - ROUNDING && three[1][1] <= three[2][1];
    let mut found: Vec<[f64; 2]> = curve.windows(3).filter(is_low).map(|three| three[1]).collect();
    found.sort_by(|a, b| a[1].total_cmp(&b[1]));
    found
}

fn minima_at(reference: &[f64], softening: f64) -> usize {
    minima(&curve(|shift| nfi(reference, shift, softening))).len()
}

fn is_right(curve: &[[f64; 2]]) -> bool {
    minima(curve)
        .first()
        .is_some_and(|lowest| (lowest[0] - TRUTH).abs() < SHIFT_STEP)
}

fn said(curve: &[[f64; 2]]) -> String {
    let found = minima(curve);
    let places: Vec<String> = found
        .iter()
        .map(|[shift, _]| format!("{:+}", short(*shift).parse().unwrap_or(*shift)))
        .collect();
    match places.as_slice() {
        [] => "no minimum".to_owned(),
        [only] => format!("one minimum, at {only}"),
        [lowest, others @ ..] => format!("lowest at {lowest}; further minima at {}", others.join(", ")),
    }
}

fn verdict(holds: bool) -> &'static str {
    if holds { "as the paper says" } else { "not so" }
}

fn plot(title: &str, y: &str, curves: Vec<(String, Vec<[f64; 2]>)>) -> Plot {
    Plot {
        title: title.to_owned(),
        x: Axis::linear("shift d of the template"),
        y: Axis::linear(y),
        series: curves
            .into_iter()
            .map(|(name, points)| Series::new(&name, Style::Line, points))
            .collect(),
        map: None,
    }
}

/// Differences below this are none.
const ROUNDING: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_criterion_is_lowest_at_the_right_shift_and_smooth_from_eight_on() {
        for outlier in OUTLIERS {
            for softening in SOFTENINGS {
                let reference = reference(outlier);
                let curve = curve(|shift| nfi(&reference, shift, softening));
                assert!(is_right(&curve), "{outlier} {softening}: {}", said(&curve));
                assert!(minima(&curve).len() == 1 || softening < 8.0, "{outlier} {softening}");
            }
        }
        assert!(minima_at(&reference(4.5), 2.0) > minima_at(&reference(4.5), 4.0));
    }

    #[test]
    fn squared_distances_of_a_reference_with_an_outlier_are_lowest_elsewhere() {
        // The outlier is nearest to the template's last point, 2.5 too far right, and pulls it over.
        let reference = reference(11.5);
        let curve = curve(|shift| squared(&reference, &moved(shift)));
        assert!(minima(&curve)[0][0] < 4.5, "{}", said(&curve));
        assert!(!is_right(&curve));
    }
}
